"""The iPhone 7 pair of Jaroensri et al. 2019."""

from functools import partial
from pathlib import Path
from typing import Any

from experiments.fit_phones.common import Cases, Run, noise_table
from jaxisp.fit import fit_dataset


def runs(data: Path | None) -> dict[str, Run]:
    return {"pair": partial(fitted, data / "iphone7")} if data else {}


def fitted(folder: Path) -> dict[str, Any]:
    return fit_dataset(folder).as_dict()


def page(cases: Cases) -> list[str]:
    result = cases["pair"]
    (pair,) = result["pairs"]
    lines = [
        "## The iPhone 7 pair",
        "",
        f"Held out {pair['held_out_psnr']:.2f} dB / SSIM {pair['held_out_ssim']:.4f} (fitted tiles "
        f"{pair['psnr']:.2f} / {pair['ssim']:.4f}) in {result['seconds']:.0f} s, compilation included. "
        f"Chosen: {result['design']}. With the shift of "
        f"{pair['shift_px'][0]:+.2f}, {pair['shift_px'][1]:+.2f} px rounded to whole pixels, which no "
        f"interpolation smooths, {pair['held_out_psnr_whole_shift']:.2f} dB.",
        "",
    ]
    edge = pair["noise"].get("edge_detail_ratio", float("nan"))
    return [*lines, *noise_table(pair["noise"]), "", f"Detail at strong edges, render over JPEG: {edge:.3f}."]
