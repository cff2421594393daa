"""Fit cameras whose answer is known in one way or another, and write what came of it as JSON and Markdown.

    python -m experiments.fit_phones DATA [--only iphone7,recovery:a,libraw] [--out docs/results]

DATA is a folder with iphone7/ (a RAW+JPEG pair) and raw/*.dng; without it those parts are left out. A part is
run as a whole, or case by case (`recovery:a`). What is not run keeps what the JSON file holds of it. Nothing
but figures is written.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import rawpy
from PIL import Image
from scipy import ndimage

from jaxisp.camera import develop
from jaxisp.fit import FitResult, fit_dataset, model
from jaxisp.fit.curvature import Identified
from jaxisp.fit.lens import Lens
from jaxisp.fit.sharing import FIXED_NAMES, canonical
from jaxisp.io import open_dataset, output_folder, read_raw, write_dng, write_jpeg, write_png
from jaxisp.params import specs
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, Phone, scene, scene_names, shoot, write_pairs
from jaxisp.samples import phone as samples_phone
from jaxisp.stages.balance import ColorMatrix, Saturation
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.optics import Exposure, Vignetting
from jaxisp.stages.tone import Gamma, SCurve, ZoneCurve

Run = Callable[[], dict[str, Any]]
Cases = dict[str, dict[str, Any]]

SEED = 7
SIZE = 208
WINDOWS = ((0.1, 0.2, 0.7), (0.9, 0.8, 0.7))
DESIGNS = {
    "a": model.Design("demosaic_malvar"),
    "b": model.Design("demosaic_bilinear", median="cross"),
    "c": model.Design("demosaic_hibbard"),
}
MEASURE = """
import resource, sys
from jaxisp.fit import fit_dataset
found = fit_dataset(sys.argv[1])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(found.seconds, found.as_dict()["held_out"]["psnr"], peak)
"""
LIBRAW = ("LINEAR", "VNG", "PPG", "AHD", "DCB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default="", help="parts, or part:case, by commas; all unless given")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    path = output_folder(arguments.out) / "fit-phones.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    for part, case, run in chosen(parts(arguments.data), arguments.only):
        results.setdefault(part, {})[case] = run()
        results["versions"] = {"jax": jax.__version__, "numpy": np.__version__, "rawpy": rawpy.__version__}
        path.write_text(json.dumps(results, indent=1) + "\n")
    path.with_suffix(".md").write_text(markdown(results))
    print(markdown(results))


def parts(data: Path | None) -> dict[str, dict[str, Run]]:
    """By part, what makes the figures of each case."""
    raws = sorted((data / "raw").glob("*.dng")) if data else []
    return {
        "iphone7": {"pair": lambda: fit_dataset(data / "iphone7").as_dict()} if data else {},
        "recovery": {name: partial(recover, name, PHONES[name]) for name in DESIGNS},
        "phones": {name: partial(own_jpegs, phone) for name, phone in PHONES.items()},
        "libraw": {path.stem: partial(against_libraw, path, i) for i, path in enumerate(raws)}
        | {f"phone_{name}": partial(libraw_on_phone, name, 100 + i) for i, name in enumerate(PHONES)},
        "lens": {"a": corrects_its_lens},
        "intensity": {
            "free": partial(by_intensity, ()),
            "fixed": partial(by_intensity, ("bilateral.guide_gamma",)),
        },
        "large": {"ten": large},
    }


def chosen(known: dict[str, dict[str, Run]], only: str) -> Iterator[tuple[str, str, Run]]:
    for wanted in only.split(",") if only else known:
        part, _, case = wanted.partition(":")
        for name, run in known[part].items():
            if case in ("", name):
                yield part, name, run


def framed(size: int = SIZE) -> dict[str, np.ndarray]:
    """Eight scenes: two windows of each photograph."""
    return {
        f"{name}{i}": scene(name, size, window)
        for name in scene_names()
        for i, window in enumerate(WINDOWS)
    }  # fmt: skip


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
    """Pairs made by a camera of the fitter's kind with known parameters, on RAWs of a reference phone."""
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
        own, best = (
            [developed(pair, c) for pair in open_dataset(folder).pairs] for c in (result.camera, truth)
        )
    # a stage that the true camera lacks has no true value
    checked = [compare(p, truth) for p in result.identified if p.name.split(".")[0] in truth.prior]
    sure = [c for c in checked if c["identified"]]
    return {
        "phone": name,
        "truth": DESIGNS[name].text,
        "found": result.design,
        "held_out_psnr": float(np.mean([p.held_out_psnr for p in result.pairs])),
        "developed_psnr": float(np.mean(own)),
        "developed_psnr_of_truth": float(np.mean(best)),
        "worst_difference_db": float(np.min(np.subtract(own, best))),
        "identified": len(sure),
        "identified_within_5_percent": sum(c["error"] <= 0.05 for c in sure),
        "outside": [c for c in sure if c["error"] > 0.05],
        "unidentified": [c["name"] for c in checked if not c["identified"]],
        "parameters": checked,
        "seconds": result.seconds,
    }


def developed(pair: Any, camera: Recipe) -> float:
    """Held-out PSNR of a camera's rendering before the encoder: what the JPEG lost is what the truth is off.

    With the encoder the true camera gives the file back bit for bit, and no figure is near that.
    """
    loaded = pair.load()
    if "jpeg_tables" in camera.prior:
        plain = {k: v for k, v in camera.prior.items() if k != "jpeg_tables"}
        camera = Recipe(camera.chain.without("jpeg_tables"), plain, meta=camera.meta)
    done = develop(loaded.raw, camera)
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


def own_jpegs(phone: Phone) -> dict[str, Any]:
    """A reference phone's own JPEGs: its code and formulas are not the fitter's."""
    with tempfile.TemporaryDirectory() as folder:
        write_pairs(folder, phone, framed(), SEED)
        return short(fit_dataset(folder))


def libraw_on_phone(name: str, seed: int) -> dict[str, Any]:
    mosaic, _, header = shoot(scene(scene_names()["abc".index(name)], 288), PHONES[name], SEED)
    header["orientation"] = 1
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / f"phone_{name}.dng"
        write_dng(path, mosaic, **header)
        return against_libraw(path, seed)


def against_libraw(path: Path, seed: int) -> dict[str, Any]:
    """A pair developed by LibRaw with settings that are drawn, not told."""
    rng = np.random.default_rng((SEED, seed))
    gamma = [(2.222, 4.5), (2.4, 12.92), (1.8, 6.0)][rng.integers(3)]
    settings: dict[str, Any] = {
        "demosaic_algorithm": LIBRAW[rng.integers(len(LIBRAW))],
        "gamma": gamma,
        "bright": float(rng.uniform(0.8, 1.5)),
        "median_filter_passes": int(rng.integers(0, 3)),
        "noise_thr": float(rng.choice([0, 100, 300])),
    }
    algorithm = getattr(rawpy.DemosaicAlgorithm, settings["demosaic_algorithm"])
    with rawpy.imread(str(path)) as raw:
        developed = raw.postprocess(
            **{**settings, "demosaic_algorithm": algorithm},
            use_camera_wb=True,
            no_auto_bright=True,
            output_color=rawpy.ColorSpace.sRGB,
            user_flip=0,
        )
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / path.name).write_bytes(path.read_bytes())
        write_png(folder / f"{path.stem}.png", developed.astype(np.float32) / 255)
        return {"settings": settings, **short(fit_dataset(folder))}


LENS = Lens(3.0 / 361, 0.0, 1 / (1 + 1.0 / 361), 1 / (1 - 0.8 / 361))


@contextmanager
def changed(table: dict[str, Any], name: str, function: Any) -> Iterator[None]:
    """One of the reference phone's own steps put in another's place."""
    before, table[name] = table[name], function
    try:
        yield
    finally:
        table[name] = before


def corrects_its_lens() -> dict[str, Any]:
    """Phone a, with a step that bends its demosaicked picture, by SciPy's splines: 512x512."""
    plain = samples_phone._DEMOSAICKERS["gradient"]

    def bends(raw: np.ndarray, filters: np.ndarray) -> np.ndarray:
        image = plain(raw, filters)
        half = (np.asarray(raw.shape) - 1) / 2
        y, x = (np.indices(raw.shape) - half[:, None, None]).astype(float)
        y, x = LENS.bent(y, x, float((half**2).sum()))
        scales = (LENS.red, 1.0, LENS.blue)
        places = [[y / s + half[0], x / s + half[1]] for s in scales]
        return np.stack(
            [ndimage.map_coordinates(image[..., c], places[c], mode="nearest") for c in range(3)], -1
        )

    with tempfile.TemporaryDirectory() as folder, changed(samples_phone._DEMOSAICKERS, "gradient", bends):
        write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", 512)}, SEED)
        result = fit_dataset(folder)
    return {"true_px": LENS.in_the_corner(2 * 255.5**2), "found_px": result.lens_px, **short(result)}


def by_intensity(fixed: tuple[str, ...]) -> dict[str, Any]:
    """A noisy phone a that smooths its shadows far less than its lights."""
    phone = dataclasses.replace(PHONES["a"], iso=1600, luma_strength=0.05)

    def smooths(luma: np.ndarray, strength: float) -> np.ndarray:
        low, high = (samples_phone._bilateral(luma, s * strength) for s in (0.25, 2.0))
        share = np.clip(samples_phone._gaussian(luma, 4.0), 0, 1)
        return (1 - share) * low + share * high

    with tempfile.TemporaryDirectory() as folder, changed(samples_phone._LUMA_FILTERS, "bilateral", smooths):
        write_pairs(folder, phone, {"coffee": scene("coffee", 384)}, SEED)
        result = fit_dataset(folder, fixed=(*FIXED_NAMES, *fixed))
    gamma = float(result.camera.prior["bilateral"].guide_gamma)
    return {"guide_gamma": gamma, "noise": result.pairs[0].noise, **short(result)}


def large(count: int = 10, size: tuple[int, int] = (3000, 4000)) -> dict[str, Any]:
    """One 12-megapixel pair under `count` names: what a fit of many large files takes."""
    picture = Image.fromarray(np.uint8(255 * scene("coffee", 400) ** (1 / 2.2))).resize(
        size[::-1], Image.Resampling.BICUBIC
    )
    light = (np.asarray(picture) / np.float32(255)) ** 2.2
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_pairs(folder, PHONES["a"], {"large0": light}, SEED)
        for i in range(1, count):
            for ending in ("dng", "jpg"):
                os.link(folder / f"large0.{ending}", folder / f"large{i}.{ending}")
        command = [sys.executable, "-c", MEASURE, str(folder)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return dict(zip(("seconds", "held_out_psnr", "peak_kib"), map(float, printed))) | {"pairs": count}


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
        "lens": _lens,
        "intensity": _intensity,
        "large": _large,
    }.items():
        if part in results:
            lines += [*write(results[part]), ""]
    return "\n".join(lines)


def _iphone7(cases: Cases) -> list[str]:
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
    return [*lines, *_noise(pair["noise"]), "", f"Detail at strong edges, render over JPEG: {edge:.3f}."]


def _noise(figures: dict[str, Any]) -> list[str]:
    lines = [
        "| held-out flat regions | std, render / JPEG | lag-1 autocorrelation, render - JPEG |",
        "| --- | --- | --- |",
    ]
    for kind in ("luma", "chroma"):
        noise = figures[kind]
        lines.append(f"| {kind} | {noise['std_ratio']:.3f} | {noise['lag1_difference']:+.3f} |")
        for row in noise["by_level"]:
            ratio, grain = row["std"][0] / row["std"][1], row["lag1"][0] - row["lag1"][1]
            lines.append(f"| {kind}, level {row['level']:.2f} | {ratio:.3f} | {grain:+.3f} |")
    return lines


def _recovery(cases: Cases) -> list[str]:
    lines = [
        "## Known parameters, eight pairs each",
        "",
        "RAWs of the reference phones, JPEGs by a camera of the fitter's own kind with known parameters. "
        "Before the encoder: the rendering against the file, of which the JPEG alone keeps the true camera "
        "off (with the encoder it gives the file back bit for bit). A parameter counts as identified where "
        "its standard error is at most 2.5 %.",
        "",
        "| phone | design, true / found | held out [dB] | before the encoder, fitted / true [dB] "
        "| identified, within 5 % | s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, r in cases.items():
        lines.append(
            f"| {name} | {r['truth']} / {r['found']} | {r['held_out_psnr']:.2f} "
            f"| {r['developed_psnr']:.2f} / {r['developed_psnr_of_truth']:.2f} "
            f"| {r['identified_within_5_percent']} of {r['identified']} | {r['seconds']:.0f} |"
        )
    for name, r in cases.items():
        outside = ", ".join(f"{c['name']} ({100 * c['error']:.0f} %)" for c in r["outside"]) or "none"
        lines += ["", f"Phone {name}: identified but outside 5 %: {outside}. "
                  f"Not identified: {', '.join(r['unidentified']) or 'none'}."]  # fmt: skip
    return lines


def _phones(cases: Cases) -> list[str]:
    lines = [
        "## The reference phones' own JPEGs, eight pairs each",
        "",
        "| phone | held out [dB / SSIM] | worst pair [dB] | chosen | s |",
        "| --- | --- | --- | --- | --- |",
    ]
    return lines + [
        f"| {name} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['worst']:.2f} "
        f"| {r['design']} | {r['seconds']:.0f} |"
        for name, r in cases.items()
    ]


def _libraw(cases: Cases) -> list[str]:
    lines = [
        "## LibRaw with settings the fitter is not told",
        "",
        "| file | LibRaw's settings | held out [dB / SSIM] | chosen | s |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, r in cases.items():
        s = r["settings"]
        text = (
            f"{s['demosaic_algorithm']}, gamma {s['gamma'][0]:g} / {s['gamma'][1]:g}, "
            f"bright {s['bright']:.2f}, "
            f"{s['median_filter_passes']} medians, noise threshold {s['noise_thr']:g}"
        )
        lines.append(
            f"| {name} | {text} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['design']} "
            f"| {r['seconds']:.0f} |"
        )
    return lines


def _lens(cases: Cases) -> list[str]:
    r = cases["a"]
    lines = [
        "## A phone that corrects distortion and lateral colour, 512x512",
        "",
        "Displacement in the corner, of all colours and of red and blue against green.",
        "",
        "| | true [px] | found [px] |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {k} | {v:.3f} | {r['found_px'].get(k, 0.0):.3f} |" for k, v in r["true_px"].items()]
    return [*lines, "", f"Held out {r['held_out_psnr']:.2f} dB in {r['seconds']:.0f} s."]


def _intensity(cases: Cases) -> list[str]:
    lines = ["## A phone that smooths lights more than shadows"]
    for name, r in cases.items():
        text = f"Fitted exponent of luma in the bilateral filter: {r['guide_gamma']:.2f}"
        text = text if name == "free" else "The exponent fixed at 1"
        lines += ["", f"{text}; held out {r['held_out_psnr']:.2f} dB.", "", *_noise(r["noise"])]
    return lines


def _large(cases: Cases) -> list[str]:
    r = cases["ten"]
    return [
        "## Large files",
        "",
        f"{r['pairs']} pairs of 12 megapixels (one pair under {r['pairs']} names): {r['seconds']:.0f} s, "
        f"at most {r['peak_kib'] / 2**20:.1f} GiB, {r['held_out_psnr']:.2f} dB held out.",
    ]


if __name__ == "__main__":
    started = time.perf_counter()
    main()
    print(f"{time.perf_counter() - started:.0f} s")
