"""`jaxisp evaluate`: PSNR and SSIM of a trained run on clean+noisy pairs."""

import functools
from argparse import Namespace
from typing import Any

from jaxisp.cli.common import (
    add_command,
    positive,
    print_json,
    print_table,
    progress,
    report_failures,
    say,
    warn,
)
from jaxisp.cli.denoise import add_network_options


def add_commands(commands: Any) -> None:
    command = add_command(commands, "evaluate", run, "PSNR and SSIM of a trained run on clean+noisy pairs")
    command.add_argument("dataset", metavar="DATASET", help="a folder of clean+noisy pairs")
    command.add_argument(
        "--run", dest="folder", required=True, metavar="RUN", help="a folder written by jaxisp train"
    )
    command.add_argument(
        "--light", choices=("linear", "encoded"), default="linear",
        help="compare in linear light, as in the paper (default), or in encoded sRGB",
    )  # fmt: skip
    command.add_argument(
        "--crop", type=positive, metavar="N", help="use the middle N x N px of each picture (default all)"
    )
    add_network_options(command)


def run(arguments: Namespace) -> int:
    from jaxisp.train import evaluate_dataset, load_denoiser

    denoiser, config = load_denoiser(arguments.folder, arguments.checkpoint)
    denoise = functools.partial(denoiser, tile=arguments.tile)
    with progress("evaluating") as tick:
        result = evaluate_dataset(
            denoise, arguments.dataset, light=arguments.light, crop=arguments.crop, tick=tick
        )
    failed = result["failed"]
    for pair in result["pairs"]:
        if not pair["aligned"]:
            told = "the position of the clean picture is unclear; it was not aligned"
            warn(f"{pair['name']}: {told}")
    if arguments.json:
        reasons = [{"file": name, "reason": reason} for name, reason in failed]
        print_json({**result, "model": config.model, "failed": reasons})
        return report_failures(failed)
    rows = [*result["pairs"], {"name": "mean", **result["mean"]}]
    print_table(
        ("pair", "PSNR in", "SSIM in", "PSNR", "SSIM"),
        [
            (r["name"], f"{r['psnr_in']:.2f}", f"{r['ssim_in']:.4f}", f"{r['psnr']:.2f}", f"{r['ssim']:.4f}")
            for r in rows
        ],
    )
    say(f"{result['light']} light; {result['aligned']}; {result['normalised']}")
    return report_failures(failed)
