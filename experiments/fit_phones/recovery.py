"""Known parameters: JPEGs by a camera of the fitter's own kind, on RAWs of the reference phones."""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.fit_phones.common import SEED, Cases, Run, fitted, framed
from jaxisp.camera import develop
from jaxisp.fit import model
from jaxisp.fit.curvature import Identified
from jaxisp.fit.sharing import canonical
from jaxisp.io import open_dataset, read_raw, write_dng, write_jpeg
from jaxisp.params import specs
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, Phone, shoot
from jaxisp.stages.balance import ColorMatrix, Saturation
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.optics import Exposure, Vignetting
from jaxisp.stages.power import Gamma
from jaxisp.stages.tone import SCurve, ZoneCurve

DESIGNS = {
    "a": model.Design("demosaic_malvar"),
    "b": model.Design("demosaic_bilinear", median="cross"),
    "c": model.Design("demosaic_hibbard"),
}


def runs(data: Path | None) -> dict[str, Run]:
    return {name: partial(recover, name, PHONES[name]) for name in DESIGNS}


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


def known_pairs(folder: Path, phone: Phone, design: model.Design, scenes: dict[str, np.ndarray]) -> Recipe:
    """Write the pairs of a camera with known parameters, and return it."""
    truth = known_camera(phone, design)
    for index, (title, picture) in enumerate(scenes.items()):
        mosaic, _, header = shoot(picture, phone, (SEED, index))
        header["orientation"] = 1
        write_dng(folder / f"{title}.dng", mosaic, **header)
        done = develop(read_raw(folder / f"{title}.dng"), truth)
        write_jpeg(folder / f"{title}.jpg", done, quality=phone.quality, subsampling=phone.subsampling)
    return truth


def recover(name: str, phone: Phone, count: int = 8) -> dict[str, Any]:
    """Pairs made by a camera of the fitter's kind with known parameters, on RAWs of a reference phone."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        truth = known_pairs(folder, phone, DESIGNS[name], dict(list(framed().items())[:count]))
        result = fitted(f"recovery-{name}-{count}", folder)
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


def page(cases: Cases) -> list[str]:
    lines = [
        "## Known parameters, eight pairs each",
        "",
        "RAWs of the reference phones, JPEGs by a camera of the fitter's own kind with known parameters. "
        "Before the encoder: the rendering against the file, of which the JPEG alone keeps the true camera "
        "off (with the encoder it gives the file back bit for bit). A parameter counts as identified where "
        "its standard error is at most 2.5 %.",
        "",
        "| phone | design, true / found | held out [dB] | before the encoder, fitted / true [dB] "
        "| identified, within 5 % |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, r in cases.items():
        lines.append(
            f"| {name} | {r['truth']} / {r['found']} | {r['held_out_psnr']:.2f} "
            f"| {r['developed_psnr']:.2f} / {r['developed_psnr_of_truth']:.2f} "
            f"| {r['identified_within_5_percent']} of {r['identified']} |"
        )
    for name, r in cases.items():
        outside = ", ".join(f"{c['name']} ({100 * c['error']:.0f} %)" for c in r["outside"]) or "none"
        lines += ["", f"Phone {name}: identified but outside 5 %: {outside}. "
                  f"Not identified: {', '.join(r['unidentified']) or 'none'}."]  # fmt: skip
    return lines
