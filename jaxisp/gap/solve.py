"""Bounded Gauss-Newton on normal equations that were computed by secants."""

from collections.abc import Sequence
from typing import Any

import numpy as np

_RIDGE = 1e-3


def solve(gram: np.ndarray, slope: np.ndarray, z: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """The move that lowers the mean square most, within the ranges.

    Args:
        gram: (K, K) summed over pairs.
        slope: (K,) likewise.
        z: (K,) where we are.
        ranges: (2, K).
    """
    free = np.ones(len(z), bool)
    move = np.zeros(len(z))
    diagonal = np.diag(gram)
    for _ in range(len(z) + 1):  # coordinates that would leave their range are put on its end
        fixed = ~free
        right = slope - gram[:, fixed] @ move[fixed]
        damped = gram + np.diag(_RIDGE * diagonal + 1e-12 * diagonal.max() + 1e-30)
        move[free] = np.linalg.solve(damped[np.ix_(free, free)], right[free])
        out = free & ((z + move < ranges[0] - 1e-9) | (z + move > ranges[1] + 1e-9))
        if not out.any():
            break
        move[out] = np.clip(z + move, *ranges)[out] - z[out]
        free &= ~out
    return move


def fit(
    problem: Any,
    which: Sequence[int],
    scenes: Sequence[int],
    *,
    steps: int,
    fresh: Sequence[int] | None = None,
) -> float:
    """Gauss-Newton over some coordinates on some scenes, in place.

    Args:
        which: the coordinates that move.
        scenes: the pairs that are looked at.
        steps: at most so many.
        fresh: whose columns are computed anew at each step; the others' are kept. All by default.

    Returns:
        the mean square residual over these scenes.
    """
    which, scenes = list(which), list(scenes)
    error = problem.errors(problem.z)[scenes].mean()
    kept = {} if fresh is None else {i: problem.columns[i] for i in which if i not in set(fresh)}
    for _ in range(steps):
        problem.columns.update(kept)
        problem.compute(which)
        gram, slope = problem.normal(which)
        move = solve(
            gram[scenes].sum(0), slope[scenes].sum(0), problem.z[which], problem.model.ranges[:, which]
        )
        better = _line_search(problem, which, move, scenes, error)
        if better is None:
            break
        z, lower = better
        gained, error = error - lower, lower
        problem.move_to(z)
        if gained < 2e-3 * error:
            break
    return float(error)


def _line_search(
    problem: Any, which: Sequence[int], move: np.ndarray, scenes: Sequence[int], error: float
) -> tuple[np.ndarray, float] | None:
    for share in (1.0, 0.5, 0.2):
        z = problem.z.copy()
        z[which] = np.clip(z[which] + share * move, *problem.model.ranges[:, which])
        lower = problem.errors(z)[scenes].mean()
        if lower < error:
            return z, lower
    return None
