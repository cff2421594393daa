"""Fit cameras whose answer is known in one way or another, and write what came of it as JSON and Markdown.

    python -m experiments.fit_phones DATA [--only iphone7,recovery,phones,libraw] [--out docs/results]

DATA is a folder with iphone7/ (a RAW+JPEG pair) and raw/*.dng; without it those parts are left out.
Parts that are not run keep what the JSON file holds of them. Nothing but figures is written.
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
from jaxisp.fit import FitResult, fit_dataset, model
from jaxisp.fit.curvature import Identified
from jaxisp.fit.render import compressed
from jaxisp.fit.sharing import canonical
from jaxisp.io import open_dataset, output_folder, read_raw, write_dng, write_jpeg, write_png
from jaxisp.params import specs
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, Phone, scene, scene_names, shoot, write_pairs
from jaxisp.stages.balance import ColorMatrix, Saturation
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.optics import Exposure, Vignetting
from jaxisp.stages.tone import Gamma, SCurve, ZoneCurve

SEED = 7
SIZE = 208
WINDOWS = ((0.1, 0.2, 0.7), (0.9, 0.8, 0.7))
PARTS = ("iphone7", "recovery", "phones", "libraw")
DESIGNS = {
    "a": model.Design("demosaic_malvar"),
    "b": model.Design("demosaic_bilinear", median="cross"),
    "c": model.Design("demosaic_hibbard"),
}
LIBRAW = ("LINEAR", "VNG", "PPG", "AHD", "DCB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default=",".join(PARTS), help="parts by commas")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    path = output_folder(arguments.out) / "fit-phones.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    runs = {
        "iphone7": lambda: iphone7(arguments.data),
        "recovery": recovery,
        "phones": phones,
        "libraw": lambda: libraw(arguments.data),
    }
    for part in arguments.only.split(","):
        if part != "iphone7" or arguments.data:
            results[part] = runs[part]()
            results["versions"] = {
                "jax": jax.__version__,
                "numpy": np.__version__,
                "rawpy": rawpy.__version__,
            }
            path.write_text(json.dumps(results, indent=1) + "\n")
    path.with_suffix(".md").write_text(markdown(results))
    print(markdown(results))


def iphone7(data: Path) -> dict[str, Any]:
    return fit_dataset(data / "iphone7").as_dict()


def framed(size: int = SIZE) -> dict[str, np.ndarray]:
    """Eight scenes: two windows of each photograph."""
    return {
        f"{name}{i}": scene(name, size, window)
        for name in scene_names()
        for i, window in enumerate(WINDOWS)
    }  # fmt: skip


def recovery() -> list[dict[str, Any]]:
    """Pairs made by cameras of the fitter's kind with known parameters, on RAWs of the reference phones."""
    return [recover(name, PHONES[name]) for name in DESIGNS]


def known_camera(phone: Phone, design: model.Design) -> Recipe:
    """A camera with the phone's colour, saturation and sharpening, and a tone and denoising of its own."""
    rng = np.random.default_rng((SEED, ord(phone.model[0])))
    params = canonical(
        model.start()
        | {
            "vignetting": Vignetting(),
            "exposure": Exposure(exposure_ev=np.float32(-np.log2(min(phone.exposure, 1.0)))),
            "color_matrix": ColorMatrix(matrix=np.linalg.inv(phone.srgb_to_camera).astype(np.float32)),
            "bilateral": Bilateral(
                luma_sigma_space=rng.uniform(1.2, 2.2),
                luma_sigma_range=rng.uniform(0.015, 0.04),
                chroma_sigma_space=rng.uniform(1.5, 3.0),
                chroma_sigma_range=rng.uniform(0.03, 0.1),
                guide_gamma=1.0,
            ),
            "median": Median(strength=0.7),
            "gamma_compression": Gamma(gamma=rng.uniform(0.9, 1.15)),
            "s_curve": SCurve(strength=rng.uniform(0.1, 0.5), midpoint=rng.uniform(0.35, 0.6)),
            "zone_curve": ZoneCurve(offsets=np.zeros(model.ZONES)),
            "saturation": Saturation(amount=phone.saturation + 0.1),
            "unsharp_mask": UnsharpMask(amount=phone.sharpening, sigma=phone.sharpening_sigma, threshold=0.0),
        }
    )
    chain = model.camera(phone.cfa, design)
    own = {k: v for k, v in params.items() if k in chain.init()}
    return Recipe(chain, chain.init() | own, meta={"from_file": ["mosaic_white_balance"]})


def recover(name: str, phone: Phone) -> dict[str, Any]:
    truth = known_camera(phone, DESIGNS[name])
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for index, (title, picture) in enumerate(framed().items()):
            mosaic, _, header = shoot(picture, phone, (SEED, index))
            header["orientation"] = 1
            write_dng(folder / f"{title}.dng", mosaic, **header)
            done = develop(read_raw(folder / f"{title}.dng"), truth)
            write_jpeg(folder / f"{title}.jpg", done, quality=phone.quality, subsampling=phone.subsampling)
        result = fit_dataset(folder)
        best = [of_the_truth(pair, truth) for pair in open_dataset(folder).pairs]
    ours = [p.held_out_psnr for p in result.pairs]
    # a stage that the true camera lacks has no true value
    checked = [compare(p, truth) for p in result.identified if p.name.split(".")[0] in truth.prior]
    sure = [c for c in checked if c["identified"]]
    return {
        "phone": name,
        "truth": DESIGNS[name].text,
        "found": result.design,
        "held_out_psnr": float(np.mean(ours)),
        "held_out_psnr_of_truth": float(np.mean(best)),
        "worst_difference_db": float(np.min(np.subtract(ours, best))),
        "identified": len(sure),
        "identified_within_5_percent": sum(c["error"] <= 0.05 for c in sure),
        "outside": [c for c in sure if c["error"] > 0.05],
        "unidentified": [c["name"] for c in checked if not c["identified"]],
        "parameters": checked,
        "seconds": result.seconds,
    }


def of_the_truth(pair: Any, truth: Recipe) -> float:
    """Held-out PSNR of the true camera, encoder included, as the fit measures its own."""
    loaded = pair.load()
    done = compressed(develop(loaded.raw, truth), loaded.jpeg)
    y, x = np.indices(done.shape[:2])
    held_out = (y // 64 + x // 64) % 2 == 1
    held_out[:8] = held_out[-8:] = held_out[:, :8] = held_out[:, -8:] = False
    return float(-10 * np.log10(np.mean((done - loaded.picture)[held_out] ** 2)))


def compare(found: Identified, truth: Recipe) -> dict[str, Any]:
    """A fitted number against the true one, relative as the standard error is."""
    path, _, index = found.name.partition("[")
    stage, field = path.split(".")
    wanted = np.asarray(getattr(truth.prior[stage], field), float)
    value = wanted[tuple(map(int, index[:-1].split(", ")))] if index else float(wanted)
    log = specs(type(truth.prior[stage]))[field].scale == "log"
    error = (
        abs(np.log(found.value / value)) if log else abs(found.value - value) / max(np.abs(wanted).max(), 0.1)
    )
    return {
        "name": found.name,
        "true": float(value),
        "fitted": found.value,
        "error": float(error),
        "standard_error": found.error,
        "identified": found.known,
    }


def phones() -> list[dict[str, Any]]:
    """The reference phones' own JPEGs: their code and formulas are not the fitter's."""
    rows = []
    for name, phone in PHONES.items():
        with tempfile.TemporaryDirectory() as folder:
            write_pairs(folder, phone, framed(), SEED)
            rows.append({"phone": name, **short(fit_dataset(folder))})
    return rows


def libraw(data: Path | None) -> list[dict[str, Any]]:
    """Pairs developed by LibRaw with settings that are drawn, not told."""
    rng = np.random.default_rng(SEED)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        sources = sorted((data / "raw").glob("*.dng")) if data else []
        for name, phone in PHONES.items():
            mosaic, _, header = shoot(scene(scene_names()["abc".index(name)], 288), phone, SEED)
            header["orientation"] = 1
            path = Path(temporary) / f"phone_{name}.dng"
            write_dng(path, mosaic, **header)
            sources.append(path)
        for path in sources:
            rows.append(against_libraw(path, rng, Path(temporary) / f"fit_{path.stem}"))
    return rows


def against_libraw(path: Path, rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    gamma = [(2.222, 4.5), (2.4, 12.92), (1.8, 6.0)][rng.integers(3)]
    settings = {
        "demosaic_algorithm": LIBRAW[rng.integers(len(LIBRAW))],
        "gamma": gamma,
        "bright": float(rng.uniform(0.8, 1.5)),
        "median_filter_passes": int(rng.integers(0, 3)),
        "noise_thr": float(rng.choice([0, 100, 300])),
    }
    output_folder(folder)
    (folder / path.name).write_bytes(path.read_bytes())
    algorithm = getattr(rawpy.DemosaicAlgorithm, settings["demosaic_algorithm"])
    with rawpy.imread(str(path)) as raw:
        developed = raw.postprocess(
            **{**settings, "demosaic_algorithm": algorithm},
            use_camera_wb=True,
            no_auto_bright=True,
            output_color=rawpy.ColorSpace.sRGB,
            user_flip=0,
        )
    write_png(folder / f"{path.stem}.png", developed.astype(np.float32) / 255)
    return {"file": path.name, "settings": settings, **short(fit_dataset(folder))}


def short(result: FitResult) -> dict[str, Any]:
    return {
        "held_out_psnr": float(np.mean([p.held_out_psnr for p in result.pairs])),
        "held_out_ssim": float(np.mean([p.held_out_ssim for p in result.pairs])),
        "worst": float(np.min([p.held_out_psnr for p in result.pairs])),
        "design": result.design,
        "flags": [f for p in result.pairs for f in p.flags],
        "unidentified": result.unidentified,
        "seconds": round(result.seconds, 1),
    }


def markdown(results: dict[str, Any]) -> str:
    lines = [
        "# Fitted phones",
        "",
        f"Made by `python -m experiments.fit_phones DATA`, seed {SEED}. Held out: a checkerboard of 64x64 "
        "tiles, half fitted, half reported; no pixel of a reported tile is in any loss, but the filters of a "
        "fitted tile look up to 16 px into its neighbours' RAW, and the alignment starts from the whole "
        "picture.",
        "",
    ]
    for part, write in {
        "iphone7": _iphone7,
        "recovery": _recovery,
        "phones": _phones,
        "libraw": _libraw,
    }.items():
        if part in results:
            lines += [*write(results[part]), ""]
    return "\n".join(lines)


def _iphone7(result: dict[str, Any]) -> list[str]:
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
        "| held-out flat regions | std, render / JPEG | lag-1 autocorrelation, render - JPEG |",
        "| --- | --- | --- |",
    ]
    for kind in ("luma", "chroma"):
        noise = pair["noise"][kind]
        lines.append(f"| {kind} | {noise['std_ratio']:.3f} | {noise['lag1_difference']:+.3f} |")
        for row in noise["by_level"]:
            ratio, grain = row["std"][0] / row["std"][1], row["lag1"][0] - row["lag1"][1]
            lines.append(f"| {kind}, level {row['level']:.2f} | {ratio:.3f} | {grain:+.3f} |")
    edge = pair["noise"].get("edge_detail_ratio", float("nan"))
    return [*lines, "", f"Detail at strong edges, render over JPEG: {edge:.3f}."]


def _recovery(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "## Known parameters, eight pairs each",
        "",
        "RAWs of the reference phones, JPEGs by a camera of the fitter's own kind with known parameters. A "
        "parameter counts as identified where its standard error is at most 2.5 %.",
        "",
        "| phone | design, true / found | held out [dB] | of the truth [dB] | identified, within 5 % | s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        lines.append(
            f"| {r['phone']} | {r['truth']} / {r['found']} | {r['held_out_psnr']:.2f} "
            f"| {r['held_out_psnr_of_truth']:.2f} | {r['identified_within_5_percent']} of {r['identified']} "
            f"| {r['seconds']:.0f} |"
        )
    for r in rows:
        outside = ", ".join(f"{c['name']} ({100 * c['error']:.0f} %)" for c in r["outside"]) or "none"
        lines += ["", f"Phone {r['phone']}: identified but outside 5 %: {outside}. "
                  f"Not identified: {', '.join(r['unidentified']) or 'none'}."]  # fmt: skip
    return lines


def _phones(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "## The reference phones' own JPEGs, eight pairs each",
        "",
        "| phone | held out [dB / SSIM] | worst pair [dB] | chosen | s |",
        "| --- | --- | --- | --- | --- |",
    ]
    return lines + [
        f"| {r['phone']} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['worst']:.2f} "
        f"| {r['design']} | {r['seconds']:.0f} |"
        for r in rows
    ]


def _libraw(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "## LibRaw with settings the fitter is not told",
        "",
        "| file | LibRaw's settings | held out [dB / SSIM] | chosen | s |",
        "| --- | --- | --- | --- | --- |",
    ]
    for r in rows:
        s = r["settings"]
        text = (
            f"{s['demosaic_algorithm']}, gamma {s['gamma'][0]:g} / {s['gamma'][1]:g}, "
            f"bright {s['bright']:.2f}, "
            f"{s['median_filter_passes']} medians, noise threshold {s['noise_thr']:g}"
        )
        lines.append(
            f"| {r['file']} | {text} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['design']} "
            f"| {r['seconds']:.0f} |"
        )
    return lines


if __name__ == "__main__":
    started = time.perf_counter()
    main()
    print(f"{time.perf_counter() - started:.0f} s")
