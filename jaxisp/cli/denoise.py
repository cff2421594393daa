"""`jaxisp denoise`: apply the network that comes with the package, or a trained run."""

from argparse import ArgumentTypeError, Namespace
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, progress, report_failures, say


def add_commands(commands: Any) -> None:
    command = add_command(commands, "denoise", run, "denoise pictures")
    command.add_argument("inputs", nargs="+", metavar="IN", help="pictures, or folders of them")
    command.add_argument(
        "--run", dest="folder", metavar="RUN",
        help="a folder written by jaxisp train (default: the network that comes with jaxisp)",
    )  # fmt: skip
    command.add_argument(
        "-o", "--out", required=True, metavar="OUT",
        help="output folder, STEM.png for each picture; or, for one picture, a file that ends in .png",
    )  # fmt: skip
    command.add_argument(
        "--strength", type=_strength, default=1.0, metavar="S",
        help="below 1 the share of its noise that is taken off; above 1 how much louder it is taken to be",
    )  # fmt: skip
    add_network_options(command)


def _strength(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 4:
        raise ArgumentTypeError(f"{text} is not from 0 to 4")
    return value


def add_network_options(command: Any) -> None:
    command.add_argument(
        "--checkpoint",
        choices=("best", "last"),
        default="best",
        help="of a run: best by validation (default) or last",
    )
    command.add_argument("--tile", type=positive, metavar="N", help="side of the tiles in px (default 256)")


def run(arguments: Namespace) -> int:
    from jaxisp.io import filled_folder
    from jaxisp.models.apply import denoise_files

    denoiser, model = find_denoiser(arguments)
    out = Path(arguments.out)
    folder = out.parent if out.suffix.lower() == ".png" and not out.is_dir() else out
    with filled_folder(folder, keep=False), progress("denoising") as tick:
        result = denoise_files(
            denoiser,
            arguments.inputs,
            arguments.out,
            tile=arguments.tile,
            strength=arguments.strength,
            tick=tick,
        )
    failed = result["failed"]
    if arguments.json:
        reasons = [{"file": name, "reason": reason} for name, reason in failed]
        print_json({**result, "model": model, "failed": reasons})
    elif result["images"]:
        say(f"{result['images']} pictures in {result['seconds']:.1f} s -> {arguments.out}")
    return report_failures(failed)


def find_denoiser(arguments: Namespace) -> tuple[Any, str]:
    """The denoiser of the run that is named, or that of the package; and the name of its network."""
    if arguments.folder:
        from jaxisp.train import load_denoiser

        denoiser, config = load_denoiser(arguments.folder, arguments.checkpoint)
        return denoiser, config.model
    from jaxisp.models.apply import shipped_denoiser

    denoiser, about = shipped_denoiser()
    return denoiser, about["model"]
