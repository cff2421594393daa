"""A phone that smooths lights more than shadows: what an exponent of luma in the filter is for."""

import dataclasses
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.fit_phones.common import SEED, Cases, Run, changed, fitted, noise_table, short
from jaxisp.samples import PHONES, scene, write_pairs
from jaxisp.samples.phone_filters import LUMA_FILTERS, gaussian


def runs(data: Path | None) -> dict[str, Run]:
    return {"free": partial(by_intensity, ()), "fixed": partial(by_intensity, ("bilateral.guide_gamma",))}


def by_intensity(fixed: tuple[str, ...]) -> dict[str, Any]:
    """A noisy phone a that smooths its shadows far less than its lights."""
    body = dataclasses.replace(PHONES["a"], iso=1600, luma_strength=0.05)

    even = LUMA_FILTERS["bilateral"]

    def smooths(luma: np.ndarray, strength: float) -> np.ndarray:
        low, high = (even(luma, s * strength) for s in (0.25, 2.0))
        share = np.clip(gaussian(luma, 4.0), 0, 1)
        return (1 - share) * low + share * high

    with tempfile.TemporaryDirectory() as folder, changed(LUMA_FILTERS, "bilateral", smooths):
        write_pairs(folder, body, {"coffee": scene("coffee", 384)}, SEED)
        result = fitted("-".join(["intensity", *fixed]), folder, freeze=fixed)
    gamma = float(result.camera.prior["bilateral"].guide_gamma)
    return {"guide_gamma": gamma, "noise": result.pairs[0].noise, **short(result)}


def page(cases: Cases) -> list[str]:
    lines = ["## A phone that smooths lights more than shadows"]
    for name, r in cases.items():
        text = f"Fitted exponent of luma in the bilateral filter: {r['guide_gamma']:.2f}"
        text = text if name == "free" else "The exponent fixed at 1"
        lines += ["", f"{text}; held out {r['held_out_psnr']:.2f} dB.", "", *noise_table(r["noise"])]
    return lines
