"""The brightness that a camera gives each of its pictures, beside what its RAW file states.

Many cameras and converters set a picture's brightness or contrast by its own mean. One tone curve of all
pictures leaves most of that, and a diagnosis would take it for an effect.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Params
from jaxisp.stages.balance import WhiteBalance

_NODE = "later_balance"
_STEP = 0.02  # stops
_FARTHEST = 1.5  # stops
_ROUNDS = 3
_WORTH = 0.97
"""Share of the error that pictures of their own brightness must leave to be taken for it."""


class Exposed(NamedTuple):
    """A base whose pictures have a brightness each.

    Attributes:
        model: the base.
        stops: (N,) by how much the camera made each picture brighter than the base, 0 on average.
    """

    model: Model
    stops: np.ndarray


def exposed(per_pair: Params, stops: np.ndarray) -> Params:
    """The parameters of each pair with the light after white balance brighter by (N,) stops."""
    gains = np.asarray(per_pair[_NODE].gains) * np.exp2(stops)[:, None]
    return per_pair | {_NODE: WhiteBalance(gains=np.asarray(gains, np.float32))}


def with_exposures(objective: PixelObjective, model: Model, fit_on: Sequence[int]) -> Exposed | None:
    """Fit a brightness of each picture, and the base of all beside it.

    That of a held-out picture is fitted to this picture: no other tells it, and one number explains nothing
    but brightness.

    Args:
        objective: of all pairs.
        model: a fitted base; z = 0 is its fit.
        fit_on: the pairs that the base is fitted to.

    Returns:
        None where the fitted pairs' error falls by less than 3 %: one brightness does for all.
    """
    own, z = list(fit_on), np.zeros(len(model.coordinates))
    objective = objective.robust(objective.at(model, z))
    before = float(objective.at(model, z).errors[own].mean())
    stops, at = np.zeros(len(objective.target)), model
    for _ in range(_ROUNDS):
        stops = np.clip(stops + _off(objective, at, z), -_FARTHEST, _FARTHEST)
        stops = stops - stops.mean()
        at = _brighter(model, at, stops)
        part = objective.take(own)
        at = at.moved(fit(part, part.at(at.take(own), z), at.base_indices, steps=2).point.z)
        if objective.at(at, z).errors[own].mean() > _WORTH * before:
            return None
    return Exposed(at, stops)


def _off(objective: PixelObjective, model: Model, z: np.ndarray) -> np.ndarray:
    """(N,) stops by which pictures are darker than they should be, by a step of Gauss and Newton."""
    here = objective.picture(model, z)
    every = np.full(len(here), _STEP)
    ahead = objective.picture(_brighter(model, model, every), z)
    weight = objective.weight**2
    change = (ahead - here) / _STEP
    across, square = (
        (a * b * weight).sum((1, 2, 3), dtype=np.float64)
        for a, b in ((change, objective.target - here), (change, change))
    )
    return np.asarray(across / np.maximum(square, 1e-9))


def _brighter(start: Model, model: Model, stops: np.ndarray) -> Model:
    """A model whose pairs are as at the start, but for stops."""
    return dataclasses.replace(model, per_pair=exposed(start.per_pair, stops))
