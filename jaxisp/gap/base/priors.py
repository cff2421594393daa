"""What cameras' colours and tones are usually like, where the pairs do not say.

A few crops of few colours leave a colour matrix and a tone curve open where they have nothing; without a
prior the fit puts anything there, and other scenes come out in colours that no camera makes.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxisp.gap.base.palette import typical_matrix
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point

_SHARE = 0.5  # of a phone's matrix: a clean picture may be in sensor colours or in the display's
_SPREAD = {"matrix": 0.35, "scale": 1.0, "bend": 0.08, "offset": 0.4}
_TILE = 32  # px: what is wrong with tones is alike over about so much


@dataclasses.dataclass(frozen=True)
class Prior:
    """Normal and independent: `rows @ z` is about `wanted`, in standard deviations.

    Attributes:
        rows: (R, K) of the K coordinates that are fitted.
        wanted: (R,).
        weight: of one row, in the units of the error that is minimised.
    """

    rows: np.ndarray
    wanted: np.ndarray
    weight: float

    def penalty(self, z: np.ndarray) -> float:
        """What is added to the mean square error."""
        return self.weight * float(((self.wanted - self.rows @ z) ** 2).sum())

    def normal(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, K) and (K,) that are added to the normal equations."""
        rows = self.weight * self.rows.T
        return rows @ self.rows, rows @ (self.wanted - self.rows @ z)


def usual_matrix(gains: np.ndarray) -> np.ndarray:
    """(3, 3) from clean to encoded colours, in linear light, whose rows sum to the gains (3,)."""
    return typical_matrix(gains, _SHARE)


def plain_prior(objective: PixelObjective, at: Point, gains: np.ndarray, fit_on: Sequence[int]) -> Prior:
    """About the matrix and the curve of the plain base.

    Args:
        objective: of pixels.
        at: noise-free; all of its base is fitted.
        gains: (3,) of `usual_matrix`.
        fit_on: the pairs that are fitted.
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
    """Of the mean of all tiles' errors, were tiles independent: noise averages out in them, what is wrong
    with tones does not."""
    which = list(fit_on)
    residual, weight = objective.residual(at)[which], objective.weight[which][..., :1]
    sums, counts = (_tiles(a) for a in (residual * weight, weight**2))
    whole = counts[..., 0] > 0.1 * _TILE**2
    means = sums[whole] / counts[whole]
    return float((means**2).sum(-1).mean() / len(means)) if len(means) else 0.0


def _tiles(values: np.ndarray) -> np.ndarray:
    """(tiles, C) sums of (N, h, w, C)."""
    edges = [np.arange(0, n, _TILE) for n in values.shape[1:3]]
    sums = np.add.reduceat(np.add.reduceat(values, edges[0], 1), edges[1], 2)
    return np.asarray(sums.reshape(-1, values.shape[-1]), float)
