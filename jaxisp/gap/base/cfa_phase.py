"""Pairs that were cut at different places of the colour filter array, moved so that it is one.

Crops of several phones, or at odd offsets, have no pattern in common; one pattern for all leaves a gap on its
phase that no effect accounts for.
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
"""What logarithms of variances differ by where the pattern is right: chance is a third of it."""
_SURELY = 30.0
"""Twice the logarithm of the odds from which on one pair shows that not all have one pattern."""
_MOVES = tuple(itertools.product((0, 1), repeat=2))


def moves(real: np.ndarray, simulated: np.ndarray, mean: MeanFit) -> np.ndarray:
    """(N, 2) rows and columns, 0 or 1, by which each pair has to be moved to have the pattern of the others:
    with which its noise is strong where it is in the simulation, and its edges have the errors that
    demosaicking leaves there. 0 for all where that is one for all.

    Args:
        real, simulated: (N, F) statistics, as `features` has them.
        mean: the noise-free base at its best.
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
    """(4, N) minus twice the log-likelihood of each pair's pixels, moved in each way, but for a constant:
    errors of next neighbours are alike, so that a tenth of them counts."""
    pairs, point = mean.objective.pairs, mean.point
    count = pairs.mask.sum((1, 2)) / 10
    found = []
    for move in _MOVES:
        objective = PixelObjective.of(moved(pairs, np.tile(move, (len(count), 1))))
        found.append(count * np.log(objective.at(point.model, point.z).errors + 1e-12))
    return np.stack(found)


def moved(pairs: Pairs, by: np.ndarray) -> Pairs:
    """Each pair moved by its own (row, column); what goes round lies in the border, which does not count."""

    def turned(stack: np.ndarray) -> np.ndarray:
        return np.stack([np.roll(one, tuple(move), (0, 1)) for one, move in zip(stack, by)])

    relit = pairs.relit(lambda light: jnp.asarray(turned(np.asarray(light))))
    return dataclasses.replace(relit, pictures=turned(pairs.pictures), mask=turned(pairs.mask))
