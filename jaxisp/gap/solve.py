"""Bounded Gauss-Newton on normal equations that were computed by secants."""

from collections.abc import Sequence
from typing import Any, Protocol

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


class Belief(Protocol):
    """A prior of what is fitted, in units of the mean square error."""

    def penalty(self, z: np.ndarray) -> float: ...
    def normal(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


def fit(
    problem: Any,
    which: Sequence[int],
    scenes: Sequence[int],
    *,
    steps: int,
    fresh: Sequence[int] | None = None,
    prior: Belief | None = None,
) -> float:
    """Gauss-Newton over some coordinates on some scenes, in place.

    Args:
        which: the coordinates that move.
        scenes: the pairs that are looked at.
        steps: at most so many.
        fresh: whose columns are computed anew at each step; the others' are kept. All by default.
        prior: what is believed of these coordinates beforehand.

    Returns:
        the mean square residual over these scenes, and what the prior adds to it.
    """
    which, scenes = list(which), list(scenes)
    error = _objective(problem, problem.z, which, scenes, prior)
    kept = {} if fresh is None else {i: problem.columns[i] for i in which if i not in set(fresh)}
    for _ in range(steps):
        problem.columns.update(kept)
        problem.compute(which)
        gram, slope = (part[scenes].sum(0) for part in problem.normal(which))
        if prior is not None:
            own_gram, own_slope = prior.normal(problem.z[which])
            gram, slope = gram + len(scenes) * own_gram, slope + len(scenes) * own_slope
        move = solve(gram, slope, problem.z[which], problem.model.ranges[:, which])
        better = _line_search(problem, which, move, scenes, error, prior)
        if better is None:
            break
        z, lower = better
        gained, error = error - lower, lower
        problem.move_to(z)
        if gained < 2e-3 * error:
            break
    return float(error)


def _objective(
    problem: Any, z: np.ndarray, which: Sequence[int], scenes: Sequence[int], prior: Belief | None
) -> float:
    error = float(problem.errors(z)[scenes].mean())
    return error if prior is None else error + prior.penalty(z[which])


def _line_search(
    problem: Any,
    which: Sequence[int],
    move: np.ndarray,
    scenes: Sequence[int],
    error: float,
    prior: Belief | None,
) -> tuple[np.ndarray, float] | None:
    for share in (1.0, 0.5, 0.2):
        z = problem.z.copy()
        z[which] = np.clip(z[which] + share * move, *problem.model.ranges[:, which])
        lower = _objective(problem, z, which, scenes, prior)
        if lower < error:
            return z, lower
    return None
