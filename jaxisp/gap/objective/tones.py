"""Tones and colours, block by block, that a fit of statistics must not spoil.

Statistics are averaged over scenes, and there are few of them: matrix and curve that move along with an
effect make good three scenes' averages and spoil the scenes themselves, and all others. The means of small
blocks, which noise hardly moves, say so.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.objective.protocol import NormalEquations

_BLOCK = 8  # px
_STEP = 0.25
"""The squared 8-bit steps that blocks are off by at least: rounding, demosaicking."""


def of(pictures: np.ndarray, mask: jax.Array) -> np.ndarray:
    """(N, T) means of blocks and channels of (N, h, w, 3), times the root of the share of a block that
    counts; 0 where that is less than half."""
    height, width = (n // _BLOCK * _BLOCK for n in mask.shape[1:])
    shape = (len(mask), height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK)
    counts = mask[:, :height, :width].reshape(shape).mean((2, 4))[..., None]
    sums = (jnp.asarray(pictures) * mask[..., None])[:, :height, :width].reshape(*shape, 3).mean((2, 4))
    found = jnp.where(counts > 0.5, sums / jnp.sqrt(counts + 1e-6), 0)
    return np.asarray(found.reshape(len(mask), -1), float)


def excess(off: np.ndarray, before: np.ndarray) -> float:
    """What an error is multiplied by where blocks are off (N, T), and were off before."""
    return float(((off**2).mean() + _STEP) / ((before**2).mean() + _STEP))


def with_excess(
    normal: NormalEquations, error: float, columns: np.ndarray, off: np.ndarray, before: np.ndarray
) -> NormalEquations:
    """The normal equations of an error times its `excess`.

    Args:
        normal: of the error.
        error: itself.
        columns: (N, K, T) what blocks change by.
        off, before: of `excess`.
    """
    start, count = (before**2).mean() + _STEP, columns.shape[-1]
    gram = columns @ columns.transpose(0, 2, 1) / count
    slope = np.einsum("nkt,nt->nk", columns, off) / count
    share = excess(off, before)
    return NormalEquations(
        share * normal.gram + error / start * gram, share * normal.slope + error / start * slope
    )
