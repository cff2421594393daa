"""`jaxisp denoise`: apply a trained run."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, progress, report_failures, say


def add_commands(commands: Any) -> None:
    command = add_command(commands, "denoise", run, "denoise pictures with a trained run")
    command.add_argument("inputs", nargs="+", metavar="IN", help="pictures, or folders of them")
    command.add_argument(
        "--run", dest="folder", required=True, metavar="RUN", help="a folder written by jaxisp train"
    )
    command.add_argument(
        "-o", "--out", required=True, metavar="DIR", help="output folder, STEM.png for each picture"
    )
    add_network_options(command)


def add_network_options(command: Any) -> None:
    command.add_argument(
        "--checkpoint",
        choices=("best", "last"),
        default="best",
        help="best by validation (default) or last",
    )
    command.add_argument("--tile", type=positive, metavar="N", help="side of the tiles in px (default 256)")


def run(arguments: Namespace) -> int:
    from jaxisp.train import denoise_files, load_denoiser

    denoiser, config = load_denoiser(arguments.folder, arguments.checkpoint)
    with progress("denoising") as tick:
        result = denoise_files(denoiser, arguments.inputs, arguments.out, tile=arguments.tile, tick=tick)
    failed = result["failed"]
    if arguments.json:
        reasons = [{"file": name, "reason": reason} for name, reason in failed]
        print_json({**result, "model": config.model, "failed": reasons})
    else:
        say(f"{result['images']} pictures in {result['seconds']:.1f} s -> {arguments.out}")
    return report_failures(failed)
