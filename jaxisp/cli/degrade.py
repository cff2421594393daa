"""`jaxisp degrade`: noisy training images out of clean ones."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, progress, report_failures


def add_commands(commands: Any) -> None:
    command = add_command(commands, "degrade", run, "make noisy training images out of clean ones")
    command.add_argument("inputs", nargs="+", metavar="IN", help="clean images, or folders of them")
    command.add_argument("-o", "--out", required=True, metavar="DIR", help="a data set is written here")
    command.add_argument(
        "--recipe", required=True, metavar="RECIPE", help="a name (jaxisp recipes) or a TOML file"
    )
    command.add_argument(
        "--count", type=positive, default=1, metavar="N", help="versions of each image (default 1)"
    )
    command.add_argument(
        "--start", type=int, default=0, metavar="I", help="index of the first sample (default 0)"
    )


def run(arguments: Namespace) -> int:
    from jaxisp.generate import degrade_files
    from jaxisp.recipes import find_recipe

    with progress("degrading") as tick:
        done = degrade_files(
            arguments.inputs,
            arguments.out,
            find_recipe(arguments.recipe),
            count=arguments.count,
            seed=arguments.seed,
            start=arguments.start,
            tick=tick,
        )
    result = done.as_dict()
    if arguments.json:
        print_json(result)
    else:
        rate = f"{done.seconds:.1f} s ({done.images_per_second:.1f} a second)"
        print(f"{done.images} images in {rate} -> {arguments.out}")
    return report_failures(done.failed)
