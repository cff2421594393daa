"""Fit of the mean of a noisy base, pixel by pixel."""

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
from jaxisp.process.memory import give_back
from jaxisp.stages.balance import ColorMatrix

_SETTLED = 0.01
_ALIKE = 3.0
"""Largest ratio of the scenes' brightness gains, from clean to noisy, that counts as one exposure."""


class MeanFit(NamedTuple):
    """A fitted noise-free base.

    Attributes:
        camera: the discrete choices of the base.
        objective: mean squared errors of pixels; the light of its pairs includes each scene's exposure.
        point: the end of the fit.
    """

    camera: Camera
    objective: PixelObjective
    point: Point

    @property
    def model(self) -> Model:
        """The model with the fitted values at z = 0."""
        return self.point.model.moved(self.point.z)


def fit_mean(file: Jpeg | None, pairs: Pairs, split: Split, cfa: str | None) -> MeanFit:
    """Fit the noise-free base to the noisy pictures, pixel by pixel.

    Args:
        file: a JPEG with the header to use; None if the pictures are not JPEGs.
        pairs: the pairs.
        split: fitted and held-out pairs.
        cfa: Bayer pattern; None: it is searched for.
    """
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
    give_back()
    camera = find_sensor(camera, fitted, pairs, fit_on, cfa is None)
    give_back()
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
    """Gains (3,) from clean to noisy pictures in linear light, by channel, over the fitted pairs."""
    which = list(fit_on)
    own, light = pairs.mask[which][..., None], np.asarray(pairs.light, np.float64)[which]
    seen = (srgb_to_linear(pairs.pictures[which].astype(np.float64)) * own).sum((0, 1, 2))
    return np.asarray(np.clip(seen / np.maximum((light * own).sum((0, 1, 2)), 1e-9), 0.05, 20))


def _scaled(pairs: Pairs) -> Pairs:
    """Scale the light of each scene to the mean brightness of its picture in linear light.

    Clean pictures may have another exposure and be tens of times as dark.
    """
    light, own = np.asarray(pairs.light, np.float64), pairs.mask[..., None]
    ratio = (srgb_to_linear(pairs.pictures.astype(np.float64)) * own).sum((1, 2, 3)) / np.maximum(
        (light * own).sum((1, 2, 3)), 1e-9
    )
    if ratio.max() < _ALIKE * ratio.min():  # one exposure; clipping and the curve explain differences
        ratio = np.full_like(ratio, 1.0 if 1 / _ALIKE < ratio.mean() < _ALIKE else ratio.mean())
    return pairs.relit(lambda light: light * ratio.astype(np.float32)[:, None, None, None])


def _exposed(objective: PixelObjective, at: Point) -> tuple[Pairs, float]:
    """Scale the light of each scene to the exposure of its picture, by channel.

    White is balanced for each scene, so channels differ.

    Returns:
        the pairs; the largest relative change.
    """
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
