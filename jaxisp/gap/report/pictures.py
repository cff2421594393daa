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
from jaxisp.gap.search.verdict import Found

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


def candidate(case: Case, found: Found) -> dict[str, Any]:
    """What the first cause, or else the likeliest effect, changes in the pair that `example` shows.

    Returns:
        part of the `pictures` of `page.write_report`: `candidate` with `effect`, its name, and `changes`,
        (h, w, 3) Y'CbCr in 8-bit steps. Noise is drawn alike with and without the effect. Empty if no effect
        was refitted, or if the effect has no parameters.
    """
    trials = {name: t for name, t in found.trials.items() if name in found.probabilities}
    likely = sorted(trials.values(), key=lambda t: -found.probabilities[t.effect])
    first = [trial for trial, _ in found.causes] or likely
    model = case.point.model
    own = model.indices([first[0].effect]) if first and first[0].effect in model.effects else []
    shown = case.statistics.measure if case.statistics is not None else case.pixels
    if not own or shown is None:
        return {}
    without, i = first[0].z.copy(), case.split.held_out[0]
    without[own] = 0
    model = model if first[0].choice is None else model.chosen(first[0].choice)
    changes = shown.picture(model, first[0].z)[i] - shown.picture(model, without)[i]
    return {"candidate": {"effect": first[0].effect, "changes": np.asarray(changes)}}


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
