"""`jaxisp evaluate`: PSNR and SSIM of a trained run and of classical denoisers on clean+noisy pairs."""

import functools
from argparse import Namespace
from collections.abc import Mapping
from typing import Any

from jaxisp.cli.common import (
    add_command,
    names,
    positive,
    print_json,
    print_table,
    progress,
    report_failures,
    say,
    warn,
)
from jaxisp.cli.denoise import add_network_options, find_denoiser
from jaxisp.errors import InputError


def add_commands(commands: Any) -> None:
    command = add_command(commands, "evaluate", run, "PSNR and SSIM of denoisers on clean+noisy pairs")
    command.add_argument("dataset", metavar="DATASET", help="a folder of clean+noisy pairs")
    command.add_argument("--run", dest="folder", metavar="RUN", help="a folder written by jaxisp train")
    command.add_argument("--shipped", action="store_true", help="measure the network that comes with jaxisp")
    command.add_argument(
        "--methods", type=names, default=[], metavar="NAME[=STRENGTH],...",
        help="classical denoisers: gaussian, tv, nlm, wavelet, bm3d, ffdnet; as strong as the noise asks for",
    )  # fmt: skip
    command.add_argument(
        "--light", choices=("linear", "encoded"), default="linear",
        help="compare in linear light, as in the paper (default), or in encoded sRGB",
    )  # fmt: skip
    command.add_argument(
        "--align", choices=("channels", "whole"), default="channels",
        help="align each channel of the clean picture where they differ (default), or only the whole",
    )  # fmt: skip
    command.add_argument(
        "--crop", type=positive, metavar="N", help="use the middle N x N px of each picture (default all)"
    )
    add_network_options(command)


def run(arguments: Namespace) -> int:
    from jaxisp.train import evaluate_dataset

    methods = _methods(arguments)
    denoise, model = None, None
    if _network(arguments):
        denoiser, model = find_denoiser(arguments)
        denoise = functools.partial(denoiser, tile=arguments.tile)
    with progress("evaluating") as tick:
        result = evaluate_dataset(
            denoise, arguments.dataset, methods=methods, light=arguments.light, crop=arguments.crop,
            align=arguments.align, tick=tick,
        )  # fmt: skip
    failed = result["failed"]
    for pair in result["pairs"]:
        if not pair["aligned"]:
            told = "the position of the clean picture is unclear; it was not aligned"
            warn(f"{pair['name']}: {told}")
    if arguments.json:
        reasons = [{"file": name, "reason": reason} for name, reason in failed]
        print_json({**result, "model": model, "failed": reasons})
        return report_failures(failed)
    if model:
        rows = [*result["pairs"], {"name": "mean", **result["mean"]}]
        heads = ("PSNR in", "SSIM in", "PSNR", "SSIM", "fixed in", "fixed")
        keys = ("psnr_in", "ssim_in", "psnr", "ssim", "psnr_fixed_in", "psnr_fixed")
        print_table(("pair", *heads), [(r["name"], *_cells(r, keys)) for r in rows])
    if methods:
        print_table(
            ("mean of", "strength", "PSNR", "SSIM", "PSNR fixed", "SSIM fixed"), _of_methods(result, model)
        )
    say(f"{result['light']} light; {result['aligned']}; {result['normalised']}; fixed: {result['fixed']}")
    return report_failures(failed)


def _network(arguments: Namespace) -> bool:
    if arguments.folder and arguments.shipped:
        raise InputError("--run and --shipped name two networks; give one")
    return bool(arguments.folder or arguments.shipped)


def _methods(arguments: Namespace) -> list[Any]:
    """The classical denoisers that can run; of others it is said what is to be installed."""
    from jaxisp.train.classical import parse_methods

    if not arguments.methods:
        if _network(arguments):
            return []
        raise InputError("nothing to measure: give --run RUN, --shipped, --methods NAME,... or several")
    asked = parse_methods(arguments.methods)
    missing = {m.name: package for m in asked if (package := m.missing())}
    if len(missing) == len(asked) and not _network(arguments):
        raise InputError(f"{', '.join(missing)}: not installed: pip install {' '.join(missing.values())}")
    for name, package in missing.items():
        warn(f"{name}: left out, as it is not installed: pip install {package}")
    return [m for m in asked if m.name not in missing]


def _of_methods(result: Mapping[str, Any], model: str | None) -> list[tuple[str, ...]]:
    keys = ("psnr", "ssim", "psnr_fixed", "ssim_fixed")
    noisy = [f"{key}_in" for key in keys]
    rows = [("noisy input", "", *_cells(result["mean"], noisy))]
    if model:
        rows.append((model, "", *_cells(result["mean"], keys)))
    for method in result["methods"]:
        strength = method["strength"]
        shown = f"{strength:.2f} px" if method["unit"] == "px" else f"{255 * strength:.1f} / 255"
        rows.append((method["name"], shown, *_cells(method["mean"], keys)))
    return rows


def _cells(row: Mapping[str, float], keys: Any) -> list[str]:
    return [f"{row[key]:.2f}" if key.startswith("psnr") else f"{row[key]:.4f}" for key in keys]
