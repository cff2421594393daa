"""Bounded Gauss-Newton on normal equations that were computed by secants."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

_RIDGE = 1e-3
_WORTHWHILE = 2e-3
"""The share of the error that a step must gain for another."""
_FOLLOWED = 6
"""Steps at most on columns that are taken along before they are computed anew."""
_ANEW = 0.01
"""The share of the error that such steps must have gained for columns anew."""
_MODEST = 0.01
"""By what share of the error a move by its own spread off what is usual (`Move`) must lower it to be worth
it."""


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
        damped = gram + np.diag(_RIDGE * diagonal + 1e-12 * diagonal.max(initial=0.0) + 1e-30)
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

    What is minimised is the mean square error, times one and a hundredth for each spread squared by which a
    move is off what is usual, and what a prior adds.

    Args:
        which: the coordinates that move; with none the error alone is measured.
        scenes: the pairs that are looked at.
        steps: at most so many.
        fresh: whose columns are computed anew at each step; the others' are kept. All by default. A problem
            that can `follow` takes its columns along to a point: up to six steps are made on those, and all
            count as one.
        prior: what is believed of these coordinates beforehand.

    Returns:
        the mean square residual over these scenes, and what the prior adds to it.
    """
    which, scenes = list(which), list(scenes)
    follow = getattr(problem, "follow", None)
    go, most, worth = (follow, _FOLLOWED, _ANEW) if follow else (problem.move_to, 1, _WORTHWHILE)
    at = _measured(problem, problem.z, which, scenes, prior)
    kept = {} if fresh is None else {i: problem.columns[i] for i in which if i not in set(fresh)}
    for _ in range(steps if which else 0):  # a given camera has no base to be fitted
        problem.columns.update(kept)
        problem.compute(which)
        start = at
        for _ in range(most):
            better = _step(problem, which, scenes, at, prior)
            if better is None:
                break
            gained, at = at.total - better.total, better
            go(at.z)
            if gained < _WORTHWHILE * at.total:
                break
        if follow:
            kept = {i: problem.columns[i] for i in kept}
            problem.columns = {}
        if start.total - at.total < worth * at.total:
            break
    return at.total


def _step(
    problem: Any, which: Sequence[int], scenes: Sequence[int], at: "_Point", prior: Belief | None
) -> "_Point | None":
    gram, slope = (part[scenes].sum(0) for part in problem.normal(which))
    beliefs = [modest(problem, which, at.error)]
    beliefs += [] if prior is None else [prior.normal(problem.z[which])]
    for own_gram, own_slope in beliefs:
        gram, slope = gram + len(scenes) * own_gram, slope + len(scenes) * own_slope
    move = solve(gram, slope, problem.z[which], problem.model.ranges[:, which])
    return _line_search(problem, which, move, scenes, at, prior)


def modest(problem: Any, which: Sequence[int], error: float) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) and (K,) that keep moves near to what is usual, in proportion to the mean square error: what
    a model leaves says how far its figures may be off."""
    which = list(which)
    precisions = _MODEST * problem.model.precisions[which]
    weights = error / _excess(problem, problem.z, which) * precisions
    return np.diag(weights), weights * (problem.model.usual - problem.z)[which]


def _excess(problem: Any, z: np.ndarray, which: Sequence[int]) -> float:
    """What the error is multiplied by for moves that are off."""
    which = list(which)
    off = (z - problem.model.usual)[which]
    return 1 + _MODEST * float((problem.model.precisions[which] * off**2).sum())


class _Point(NamedTuple):
    """Where, the mean square error there, and what is minimised."""

    z: np.ndarray
    error: float
    total: float


def _measured(
    problem: Any, z: np.ndarray, which: Sequence[int], scenes: Sequence[int], prior: Belief | None
) -> _Point:
    error = float(problem.errors(z)[scenes].mean())
    believed = 0.0 if prior is None else prior.penalty(z[which])
    return _Point(z, error, error * _excess(problem, z, which) + believed)


def _line_search(
    problem: Any,
    which: Sequence[int],
    move: np.ndarray,
    scenes: Sequence[int],
    start: _Point,
    prior: Belief | None,
) -> _Point | None:
    for share in (1.0, 0.5, 0.2):
        z = problem.z.copy()
        z[which] = np.clip(z[which] + share * move, *problem.model.ranges[:, which])
        found = _measured(problem, z, which, scenes, prior)
        if found.total < start.total:
            return found
    return None
