"""A fit under way: where it is, and what is known there."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxisp.fit.tiles import Chunk
from jaxisp.pipeline import Params


class View(NamedTuple):
    """The tiles of one pair as they are fitted: demosaicked, where they lie, and the parameters of its
    file's JPEG encoder, None where that is not rendered. Of the picture the sums of `noise.moments`, and how
    many pixels of each cell of colour are fitted."""

    chunks: tuple[Chunk, ...]
    geometry: np.ndarray
    sums: np.ndarray
    pixels: np.ndarray
    encoder: Params | None = None


@dataclasses.dataclass(frozen=True)
class State:
    """A fit under way: one vector for the camera, one a pair for the image and its geometry."""

    camera: np.ndarray
    images: tuple[np.ndarray, ...]
    places: tuple[np.ndarray, ...]
    damping: float = 1e-2
    objective: float = float("inf")
    done: int = 0
    idle: int = 0

    def moved(self, step: np.ndarray) -> "State":
        """With a step on all vectors, in a row."""
        flat = np.concatenate([self.camera, *self.images, *self.places]) + step
        sizes = [len(v) for v in (self.camera, *self.images, *self.places)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        n = len(self.images)
        return dataclasses.replace(
            self, camera=parts[0], images=tuple(parts[1 : 1 + n]), places=tuple(parts[1 + n :])
        )


class Slopes(NamedTuple):
    """All chunks at a state, with derivatives: what equations are put together from, whatever a fit weighs.

    Args:
        parts: a `problem.Normal` each, without its Jacobian.
        jacobians: as `spread.each` gives and takes them.
    """

    parts: Any
    jacobians: Any


@dataclasses.dataclass(frozen=True)
class Equations:
    """All chunks together: the Hessian and the gradient of the objective in the order of a `State`."""

    objective: float
    matrix: np.ndarray
    vector: np.ndarray
    data: np.ndarray
    """The part of `matrix` that the pixels give, in squared levels."""
    scores: np.ndarray
    """(surfaces, columns): the gradient of the loss of the pixels of one colour in one picture, less what is
    their share of the whole."""
    loss: float
    weight: float
    slopes: np.ndarray
    """How each noise statistic moves, (n, m)."""
    jacobians: Any
    """As `spread.each` gives and takes them."""


class Place(NamedTuple):
    """The objective somewhere, its gradient with the Jacobians of a place nearby, the loss, and how far each
    noise statistic is off, in tolerances."""

    objective: float
    vector: np.ndarray
    loss: float
    rows: np.ndarray
