"""`jaxisp recipe`: a recipe for training data out of fitted cameras."""

from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, print_json, say


def add_commands(commands: Any) -> None:
    command = add_command(commands, "recipe", run, "make a recipe for training data out of fitted cameras")
    command.add_argument(
        "cameras",
        nargs="+",
        metavar="CAMERA.toml",
        help="cameras written by jaxisp fit; demosaicker, median and order come from the first",
    )
    command.add_argument("-o", "--out", required=True, metavar="OUT.toml", help="the recipe to write")
    command.add_argument(
        "--spread", type=_factor, default=1.25, metavar="F",
        help="widen the range that the cameras span by this factor (default 1.25)",
    )  # fmt: skip
    command.add_argument(
        "--noise-spread", type=_factor, default=4.0, metavar="F",
        help="the same for the noise variance, which varies with ISO (default 4)",
    )  # fmt: skip


def _factor(text: str) -> float:
    value = float(text)
    if not 1 <= value <= 1000:
        raise ArgumentTypeError(f"{text} is not from 1 to 1000")
    return value


def run(arguments: Namespace) -> int:
    from jaxisp.fit import prior_from_cameras
    from jaxisp.io.files import check_output, real_paths

    check_output(arguments.out, real_paths(arguments.cameras))
    recipe = prior_from_cameras(
        arguments.cameras,
        spread=arguments.spread,
        noise_spread=arguments.noise_spread,
        name=Path(arguments.out).stem,
    )
    recipe.save(arguments.out)
    if arguments.json:
        print_json({"recipe": arguments.out, "cameras": arguments.cameras})
    else:
        say(f"{arguments.out}: {recipe.description}")
    return 0
