"""Priors on a camera's colour matrix and tone curve.

A few crops with few colours do not determine the matrix and the curve everywhere. Without a prior, the fit
gives other scenes colours that no camera produces.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxisp.gap.base.palette import typical_matrix
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point

_SHARE = 0.5  # share of a phone's matrix, since clean pictures may be in sensor or in display colours
_SPREAD = {"matrix": 0.35, "scale": 1.0, "bend": 0.08, "offset": 0.4}
_TILE = 32  # px, correlation length of errors of tone


@dataclasses.dataclass(frozen=True)
class Prior:
    """Independent normal priors: `rows @ z` has mean `wanted` and standard deviation 1.

    Attributes:
        rows: (R, K) for K fitted coordinates.
        wanted: (R,) means.
        weight: of one row, in the unit of the minimised error.
    """

    rows: np.ndarray
    wanted: np.ndarray
    weight: float

    def penalty(self, z: np.ndarray) -> float:
        """Penalty that is added to the mean squared error."""
        return self.weight * float(((self.wanted - self.rows @ z) ** 2).sum())

    def normal(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Terms (K, K) and (K,) that are added to the normal equations."""
        rows = self.weight * self.rows.T
        return rows @ self.rows, rows @ (self.wanted - self.rows @ z)


def usual_matrix(gains: np.ndarray) -> np.ndarray:
    """Usual matrix (3, 3) from clean to final colours in linear light; its rows sum to the gains (3,)."""
    return typical_matrix(gains, _SHARE)


def plain_prior(objective: PixelObjective, at: Point, gains: np.ndarray, fit_on: Sequence[int]) -> Prior:
    """Prior on the matrix and the curve of the plain base.

    Args:
        objective: of pixels.
        at: a point of the noise-free base, whose coordinates are all fitted.
        gains: (3,) gains of `usual_matrix`.
        fit_on: indices of the fitted pairs.
    """
    model = at.model
    index = {(c.node, c.move.field, c.move.index): k for k, c in enumerate(model.base)}
    matrix = np.asarray(model.shared["color_matrix"].matrix, float)
    offsets = np.asarray(model.shared["tone_curve"].offsets, float)
    usual = usual_matrix(gains)
    rows, wanted = [], []

    def add(coefficients: dict[int, float], value: float, spread: float) -> None:
        row = np.zeros(len(model.base))
        row[list(coefficients)] = list(coefficients.values())
        rows.append(row / spread)
        wanted.append(value / spread)

    for i in range(3):
        for j in range(3):
            spread = gains[i] * _SPREAD["scale" if i == j else "matrix"]
            add({index["color_matrix", "matrix", (i, j)]: 1.0}, usual[i, j] - matrix[i, j], spread)
    curve = [index["tone_curve", "offsets", (i,)] for i in range(len(offsets))]
    for i, k in enumerate(curve):
        add({k: 1.0}, -offsets[i], _SPREAD["offset"])
    for i in range(1, len(offsets) - 1):
        bend = {curve[i - 1]: 1.0, curve[i]: -2.0, curve[i + 1]: 1.0}
        add(bend, -float(offsets[i - 1] - 2 * offsets[i] + offsets[i + 1]), _SPREAD["bend"])
    return Prior(np.array(rows), np.array(wanted), _variance(objective, at, fit_on))


def _variance(objective: PixelObjective, at: Point, fit_on: Sequence[int]) -> float:
    """Variance of the mean error over tiles, which are taken as independent.

    Noise averages out within a tile; errors of tone do not.
    """
    which = list(fit_on)
    residual, weight = objective.residual(at)[which], objective.weight[which][..., :1]
    sums, counts = (_tiles(a) for a in (residual * weight, weight**2))
    whole = counts[..., 0] > 0.1 * _TILE**2
    means = sums[whole] / counts[whole]
    return float((means**2).sum(-1).mean() / len(means)) if len(means) else 0.0


def _tiles(values: np.ndarray) -> np.ndarray:
    """Sums (tiles, C) of values (N, h, w, C) over tiles."""
    edges = [np.arange(0, n, _TILE) for n in values.shape[1:3]]
    sums = np.add.reduceat(np.add.reduceat(values, edges[0], 1), edges[1], 2)
    return np.asarray(sums.reshape(-1, values.shape[-1]), float)
