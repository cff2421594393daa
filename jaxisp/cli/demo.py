"""`jaxisp demo`: the main job on data that comes with the package."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, progress, say


def add_commands(commands: Any) -> None:
    command = add_command(
        commands,
        "demo",
        run,
        "pairs, fit, degrade, train, diagnose, on data that comes with the package",
        draws=True,
    )
    command.add_argument("--out", default="demo", metavar="DIR", help="output folder (default ./demo)")


def run(arguments: Namespace) -> int:
    from jaxisp.demo import run_demo

    with progress("demo") as tick:
        result = run_demo(arguments.out, seed=arguments.seed, tick=tick)
    if arguments.json:
        print_json(result)
    else:
        say(f"{result['report']}: open it in a browser ({result['seconds']:.0f} s)")
    return 0
