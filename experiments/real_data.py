"""Run the main jobs on real files and write what they gave, as JSON and Markdown.

    python -m experiments.real_data DATA --out docs/results

DATA is a folder with raw/*.dng, imx296/static.f00.dng, iphone7/ (a RAW+JPEG pair) and clean/kodak/.
Nothing but figures is written. `--pictures DIR` also writes the renderings side by side, to be looked at.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import rawpy

from jaxisp.camera import develop
from jaxisp.fit import fit_dataset
from jaxisp.fit.report import write_report
from jaxisp.generate import degrade_files
from jaxisp.io import output_folder, read_raw, write_png
from jaxisp.recipes import find_recipe


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    raws = [*sorted((arguments.data / "raw").glob("*.dng")), arguments.data / "imx296" / "static.f00.dng"]
    results = {
        "develop": [against_libraw(path, arguments.pictures) for path in raws],
        "fit": fit(arguments.data / "iphone7", arguments.pictures),
        "degrade": degrade(arguments.data / "clean" / "kodak"),
        "versions": {
            "jax": jax.__version__,
            "numpy": np.__version__,
            "libraw": ".".join(map(str, rawpy.libraw_version)),
        },
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "real-data.json").write_text(json.dumps(results, indent=1) + "\n")
    (arguments.out / "real-data.md").write_text(markdown(results))
    print(markdown(results))


def against_libraw(path: Path, pictures: Path | None) -> dict[str, Any]:
    """PSNR to LibRaw's own rendering of the same file: as they are, and after matching each channel's level.

    LibRaw renders with the same demosaicking (AHD), as-shot white balance, sRGB and its own automatic
    brightening, which differs from our exposure: so both are also compared at equal channel means.
    """
    clock = time.perf_counter()
    ours = develop(read_raw(path))
    seconds = time.perf_counter() - clock
    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(
            use_camera_wb=True,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
            gamma=(2.4, 12.92),
            output_color=rawpy.ColorSpace.sRGB,
        ).astype(np.float32) / 255  # fmt: skip
    h, w = (min(a, b) for a, b in zip(ours.shape[:2], theirs.shape[:2]))
    ours, theirs = centre(ours, h, w), centre(theirs, h, w)
    if pictures:
        output_folder(pictures)
        write_png(pictures / f"{path.stem}.png", np.concatenate([ours, theirs], 1))
    matched = np.clip(match_levels(ours, theirs), 0, 1)
    return {
        "file": path.name,
        "size": [w, h],
        "psnr": decibels(ours, theirs),
        "psnr_levels_matched": decibels(matched, theirs),
        "seconds": round(seconds, 1),
    }


def centre(image: np.ndarray, h: int, w: int) -> np.ndarray:
    y, x = (image.shape[0] - h) // 2, (image.shape[1] - w) // 2
    return image[y : y + h, x : x + w]


def match_levels(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Each channel's linear-light gain that brings its mean to the reference's."""
    linear, wanted = (((a + 0.055) / 1.055) ** 2.4 for a in (image, reference))
    gain = wanted.mean((0, 1)) / linear.mean((0, 1))
    return 1.055 * (gain * linear) ** (1 / 2.4) - 0.055


def decibels(a: np.ndarray, b: np.ndarray, border: int = 8) -> float:
    inside = (slice(border, -border), slice(border, -border))
    return round(float(-10 * np.log10(np.mean((a[inside] - b[inside]) ** 2))), 2)


def fit(folder: Path, pictures: Path | None) -> dict[str, Any]:
    result = fit_dataset(folder)
    if pictures:
        write_report(result, pictures)
    return result.as_dict()


def degrade(folder: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as out:
        return degrade_files([folder], out, find_recipe("phone")).as_dict()


def markdown(results: dict[str, Any]) -> str:
    rows = [
        f"| {d['file']} | {d['size'][0]} x {d['size'][1]} | {d['psnr']} | {d['psnr_levels_matched']} "
        f"| {d['seconds']} |"
        for d in results["develop"]
    ]
    fitted, degraded = results["fit"], results["degrade"]
    pairs = [
        f"| {p['name']} | {p['psnr']:.2f} / {p['ssim']:.4f} "
        f"| {p['held_out_psnr']:.2f} / {p['held_out_ssim']:.4f} "
        f"| {p['shift_px'][0]:+.2f}, {p['shift_px'][1]:+.2f} |"
        for p in fitted["pairs"]
    ]
    return "\n".join(
        [
            "# Real data",
            "",
            "Made by `python -m experiments.real_data DATA`.",
            "",
            "## `jaxisp develop` against LibRaw's rendering of the same file",
            "",
            "| file | size | PSNR [dB] | at equal channel levels [dB] | seconds |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
            "## `jaxisp fit` on the iPhone 7 pair",
            "",
            "| pair | fitted tiles, dB / SSIM | held-out tiles, dB / SSIM | shift RAW to JPEG, y, x [px] |",
            "| --- | --- | --- | --- |",
            *pairs,
            "",
            f"{fitted['held_out']['how'].capitalize()}. {fitted['seconds']:.0f} s, compilation included.",
            "",
            "## `jaxisp degrade --recipe phone` on ten Kodak photographs (768x512)",
            "",
            f"{degraded['images']} images in {degraded['seconds']:.1f} s, compilation included, "
            f"{len(degraded['failed'])} failed.",
            "",
        ]
    )


if __name__ == "__main__":
    main()
