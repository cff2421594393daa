"""The mean of a noisy base, fitted pixel by pixel."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.color import srgb_to_linear
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.base.priors import plain_prior, usual_matrix
from jaxisp.gap.base.sensor import find_sensor
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.pairs import INNER, Pairs, to_steps
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.simulator.model import Model
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Params
from jaxisp.stages.balance import ColorMatrix

_SETTLED = 0.01
_ALIKE = 3.0
"""By how much scenes may differ in how bright the picture is for its clean one and count as one exposure."""


class MeanFit(NamedTuple):
    """A noise-free base at its best.

    Attributes:
        camera: what of it is chosen.
        objective: mean square errors of pixels; its pairs have each scene's light as it was exposed.
        point: where the fit ended.
    """

    camera: Camera
    objective: PixelObjective
    point: Point

    @property
    def model(self) -> Model:
        """With what was fitted as z = 0."""
        return self.point.model.moved(self.point.z)


def fit_mean(file: Jpeg | None, pairs: Pairs, split: Split, cfa: str | None) -> MeanFit:
    """The noise-free base whose pictures are nearest to the noisy ones, pixel by pixel; its colour filter
    array is found unless it is given."""
    camera, fit_on = Camera(file, cfa or "RGGB"), split.fit
    pairs = _scaled(pairs)
    gains = _gains(pairs, fit_on)
    start: Params = {"color_matrix": ColorMatrix(matrix=np.float32(np.clip(usual_matrix(gains), -4, 4)))}
    model = camera.mean_model(start)
    objective = PixelObjective.of(pairs, split)
    at = objective.at(model, np.zeros(len(model.coordinates)))
    for steps in (5, 1, 1, 1, 1, 2):
        at = _fit(objective, at, gains, steps)
        pairs, change = _exposed(objective, at)
        objective = dataclasses.replace(objective, pairs=pairs)
        at = objective.at(model, at.z)
        if change < _SETTLED and steps == 1:
            break
    at = _fit(objective, at, gains, 2)
    fitted = model.moved(at.z).shared
    camera = find_sensor(camera, fitted, pairs, fit_on, cfa is None)
    model = camera.mean_model(fitted)
    objective = PixelObjective.of(pairs, split)
    z = np.zeros(len(model.coordinates))
    objective = objective.robust(objective.at(model, z))
    return MeanFit(camera, objective, _fit(objective, objective.at(model, z), gains, 4))


def _fit(objective: PixelObjective, at: Point, gains: np.ndarray, steps: int) -> Point:
    fit_on = objective.split.fit
    prior = plain_prior(objective, at, gains, fit_on)
    return fit(objective, at, at.model.base_indices, fit_on, steps=steps, prior=prior).point


def _gains(pairs: Pairs, fit_on: Sequence[int]) -> np.ndarray:
    """(3,) how bright the fitted pictures are in linear light for their clean ones, channel by channel."""
    which = list(fit_on)
    own, light = pairs.mask[which][..., None], np.asarray(pairs.light, np.float64)[which]
    seen = (srgb_to_linear(pairs.pictures[which].astype(np.float64)) * own).sum((0, 1, 2))
    return np.asarray(np.clip(seen / np.maximum((light * own).sum((0, 1, 2)), 1e-9), 0.05, 20))


def _scaled(pairs: Pairs) -> Pairs:
    """The pairs with each scene's light as bright on average as its picture in linear light: a clean picture
    may be of another exposure, tens of times as dark."""
    light, own = np.asarray(pairs.light, np.float64), pairs.mask[..., None]
    ratio = (srgb_to_linear(pairs.pictures.astype(np.float64)) * own).sum((1, 2, 3)) / np.maximum(
        (light * own).sum((1, 2, 3)), 1e-9
    )
    if ratio.max() < _ALIKE * ratio.min():  # one exposure: its curve tells a little of what is clipped
        ratio = np.full_like(ratio, 1.0 if 1 / _ALIKE < ratio.mean() < _ALIKE else ratio.mean())
    return pairs.relit(lambda light: light * ratio.astype(np.float32)[:, None, None, None])


def _exposed(objective: PixelObjective, at: Point) -> tuple[Pairs, float]:
    """The pairs with each scene's light scaled to the exposure that its own picture shows, channel by channel
    (white is balanced for each scene), and the largest change that this was."""
    pairs, probe, weight = objective.pairs, 1.05, objective.weight
    columns = []
    for gains in 1 + (probe - 1) * np.eye(3, dtype=np.float32):
        brighter = to_steps(at.model.render(at.z, pairs.light * gains)[INNER])
        columns.append((brighter - at.shown[0]) * weight / (probe - 1))
    stacked = np.stack(columns, 1).reshape(len(pairs.names), 3, -1)
    gram = np.einsum("nip,njp->nij", stacked, stacked, dtype=np.float64)
    residual = objective.residual(at).reshape(len(stacked), -1)
    slope = np.einsum("nip,np->ni", stacked, residual, dtype=np.float64)
    damping = 1e-3 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-9
    gain = np.clip(1 + np.linalg.solve(gram + damping, slope[..., None])[..., 0], 0.5, 2)
    gain = np.clip(gain / np.exp(np.log(gain).mean(0)), 0.5, 2).astype(np.float32)
    moved = pairs.relit(lambda light: light * gain[:, None, None, :])
    return moved, float(np.abs(gain - 1).max())
