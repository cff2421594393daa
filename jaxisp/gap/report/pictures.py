"""Example pictures and residual spectra for the page."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxisp.gap.case import Case
from jaxisp.gap.features.residual_statistics import frames_of, noise_of
from jaxisp.gap.features.spectra import Spread, spreads
from jaxisp.gap.objective.measure import Measure
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.pairs import INNER, to_steps

Spreads = dict[str, dict[str, Spread]]
"""Spectra of "luma" and "chroma", keyed by source: "simulator", and "floor" or "real".

"floor" is the error of the file's own compression, if known. "real" is the noise of the real pictures."""


def example(case: Case, point: Point, when: str) -> dict[str, Any]:
    """Render one held-out pair at a point, with its residual and the spectra of all held-out pairs.

    Args:
        case: the pairs and their objective.
        point: where the simulator stands.
        when: "before" or "after"; part of the keys.

    Returns:
        part of the `pictures` of `page.write_report`.
    """
    pairs, i = case.pairs, case.split.held_out[0]
    if case.pixels is not None:
        whole = case.pixels.rendered(point.model, point.z)
        spread = _of_residuals(case.pixels, to_steps(whole[INNER]), case.stored)
    else:
        assert case.statistics is not None
        whole = case.statistics.measure.rendered(point.model, point.z)
        spread = _of_noise(case.statistics.measure, to_steps(whole[INNER]))
    return {
        "name": pairs.names[i],
        "target": pairs.pictures[i],
        when: whole[i],
        f"residual_{when}": to_steps(pairs.pictures[INNER])[i] - to_steps(whole[INNER])[i],
        f"spread_{when}": spread.pop("simulator"),
        **{f"spread_{whose}": own for whose, own in spread.items()},
    }


def _of_residuals(pixels: PixelObjective, picture: np.ndarray, stored: np.ndarray | None) -> Spreads:
    """Spectra of target minus picture and of the floor, both (N, h, w, 3) Y'CbCr in 8-bit steps."""
    held = list(pixels.split.held_out)
    weight = pixels.weight[held][..., 0]
    left = {"simulator": pixels.target - picture, "floor": stored}
    return {whose: spreads(own[held], weight) for whose, own in left.items() if own is not None}


def _of_noise(measure: Measure, picture: np.ndarray) -> Spreads:
    """Spectra of the noise of simulated pictures (N, h, w, 3), Y'CbCr in 8-bit steps, and of real ones."""
    held = list(measure.split.held_out)
    weight = np.sqrt(np.asarray(measure.mask))[held]
    frames = frames_of(measure.scenes(held))
    counted = jnp.asarray(weight > 0, jnp.float32)
    looked_at = {"simulator": (picture, measure.again), "real": (measure.target, measure.reference)}
    found = {}
    for whose, (pictures, against) in looked_at.items():
        own, shown = against.take(held), jnp.asarray(pictures[held])
        noise = noise_of(shown, own.picture, counted, own.maps, frames)
        found[whose] = spreads(np.asarray(noise), weight)
    return found
