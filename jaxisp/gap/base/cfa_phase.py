"""Alignment of pairs that were cropped at different phases of the colour filter array.

Crops of several phones, or at odd offsets, have different Bayer patterns. A single pattern for all of them
would leave a gap on the CFA phase that no effect explains.
"""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np

from jaxisp.gap.base.mean import MeanFit
from jaxisp.gap.features.mean import CHANNELS
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs

_APART = 0.1
"""Difference of log variances for the right pattern; chance alone gives a third of it."""
_SURELY = 30.0
"""Twice the log odds at which one pair proves that the pairs have different patterns."""
_MOVES = tuple(itertools.product((0, 1), repeat=2))


def moves(real: np.ndarray, simulated: np.ndarray, mean: MeanFit) -> np.ndarray:
    """Find the shift that gives each pair the common pattern.

    The shift aligns the phase of the noise variance with the simulation, and the demosaicking errors at
    edges.

    Args:
        real: (N, F) statistics of the real pictures, see `residual_statistics.features`.
        simulated: (N, F) statistics of the simulated pictures.
        mean: the fitted noise-free base.

    Returns:
        shifts (N, 2) in rows and columns, 0 or 1; all 0 if the pairs have one pattern or the evidence is
        weak.
    """
    names = feature_names()
    at = [[[names.index(f"logvar cfa_phase {c}{i}{j}") for j in (0, 1)] for i in (0, 1)] for c in CHANNELS]
    own, model = (found[:, at] - found[:, at].mean((2, 3), keepdims=True) for found in (real, simulated))
    squares = np.stack([((own - np.roll(model, move, (2, 3))) ** 2).sum((1, 2, 3)) for move in _MOVES])
    unlikely = squares / _APART**2 + _edges(mean)
    best = unlikely.argmin(0)
    found = np.array(_MOVES)[best]
    clear = (unlikely[0] - unlikely.min(0)).max() > _SURELY
    return found if clear and len(set(best)) > 1 else np.zeros_like(found)


def _edges(mean: MeanFit) -> np.ndarray:
    """Minus twice the log-likelihood (4, N) of each pair's pixels under each shift, up to a constant.

    Errors of neighbouring pixels are correlated, so only a tenth of the pixels counts.
    """
    pairs, point = mean.objective.pairs, mean.point
    count = pairs.mask.sum((1, 2)) / 10
    found = []
    for move in _MOVES:
        objective = PixelObjective.of(moved(pairs, np.tile(move, (len(count), 1))))
        found.append(count * np.log(objective.at(point.model, point.z).errors + 1e-12))
    return np.stack(found)


def moved(pairs: Pairs, by: np.ndarray) -> Pairs:
    """Shift each pair by its (row, column) in `by` (N, 2), cyclically; the border is masked anyway."""

    def turned(stack: np.ndarray) -> np.ndarray:
        return np.stack([np.roll(one, tuple(move), (0, 1)) for one, move in zip(stack, by)])

    relit = pairs.relit(lambda light: jnp.asarray(turned(np.asarray(light))))
    return dataclasses.replace(relit, pictures=turned(pairs.pictures), mask=turned(pairs.mask))
