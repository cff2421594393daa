"""`jaxisp recipe`: a recipe for training data out of fitted cameras, or another with calibrated noise."""

from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, print_json, say
from jaxisp.errors import InputError


def add_commands(commands: Any) -> None:
    command = add_command(
        commands, "recipe", run, "make a recipe out of fitted cameras, or one with calibrated noise"
    )
    command.add_argument(
        "cameras",
        nargs="+",
        metavar="CAMERA.toml",
        help="cameras written by jaxisp fit; demosaicker, median and order come from the first; with --noise "
        "also one recipe, a name or a TOML file",
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
    command.add_argument(
        "--noise", metavar="NOISE.toml", help="noise from jaxisp calibrate in the place of the recipe's own"
    )
    command.add_argument(
        "--iso", type=float, metavar="N", help="which ISO number of NOISE.toml (needed where it has several)"
    )


def _factor(text: str) -> float:
    value = float(text)
    if not 1 <= value <= 1000:
        raise ArgumentTypeError(f"{text} is not from 1 to 1000")
    return value


def run(arguments: Namespace) -> int:
    from jaxisp.io.files import filled_file

    noise = [arguments.noise] if arguments.noise else []
    if arguments.iso is not None and not noise:
        raise InputError("--iso needs --noise NOISE.toml")
    with filled_file(arguments.out, [*arguments.cameras, *noise]):
        recipe = _recipe(arguments)
        if noise:
            from jaxisp.calibrate import Calibrated, with_noise

            recipe = with_noise(recipe, Calibrated.load(arguments.noise).at(arguments.iso))
        recipe.save(arguments.out)
    if arguments.json:
        print_json({"recipe": arguments.out, "cameras": arguments.cameras, "noise": arguments.noise})
    else:
        say(f"{arguments.out}: {recipe.description}")
    return 0


def _recipe(arguments: Namespace) -> Any:
    """Out of the cameras; with calibrated noise one recipe for photographs may stand in their place."""
    from jaxisp.fit import prior_from_cameras
    from jaxisp.recipes import find_recipe

    if arguments.noise and len(arguments.cameras) == 1:
        found = find_recipe(arguments.cameras[0])
        if found.chain.domain_in.name != "mosaic":
            return found
    return prior_from_cameras(
        arguments.cameras,
        spread=arguments.spread,
        noise_spread=arguments.noise_spread,
        name=Path(arguments.out).stem,
    )
