"""A reference phone that bends its picture as if to correct its lens."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from experiments.fit_phones.common import SEED, Cases, Run, changed, fitted, short
from jaxisp.fit.lens import Lens
from jaxisp.samples import PHONES, scene, write_pairs
from jaxisp.samples.phone_filters import DEMOSAICKERS

LENS = Lens(3.0 / 361, 0.0, 1 / (1 + 1.0 / 361), 1 / (1 - 0.8 / 361))


def runs(data: Path | None) -> dict[str, Run]:
    return {"a": corrects_its_lens}


def corrects_its_lens() -> dict[str, Any]:
    """Phone a, with a step that bends its demosaicked picture, by SciPy's splines: 512x512."""
    plain = DEMOSAICKERS["gradient"]

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

    with tempfile.TemporaryDirectory() as folder, changed(DEMOSAICKERS, "gradient", bends):
        write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", 512)}, SEED)
        result = fitted("lens", folder)
    return {"true_px": LENS.in_the_corner(2 * 255.5**2), "found_px": result.lens_px, **short(result)}


def page(cases: Cases) -> list[str]:
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
    return [*lines, "", f"Held out {r['held_out_psnr']:.2f} dB."]
