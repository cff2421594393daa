"""Bounded Gauss-Newton on normal equations that were computed by secants.

`jaxisp.fit.solve` has a loop of its own, for another problem: one camera's parameters with each picture's
own, by exact Jacobians over devices, damped after Levenberg and Marquardt, under a robust loss whose
curvature is positive everywhere. Here columns are dear and rough (a rendering each, no derivatives), few
coordinates move at once, and they end at bounds: columns are kept from step to step or taken along, the step
is solved within the bounds, and its length searched.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from jaxisp.gap.objective.protocol import Objective, Point

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


class Fitted(NamedTuple):
    """Where a fit ended, and what it minimised there."""

    point: Point
    total: float


def fit(
    objective: Objective,
    point: Point,
    which: Sequence[int],
    scenes: Sequence[int] | None = None,
    *,
    steps: int,
    fresh: Sequence[int] | None = None,
    prior: Belief | None = None,
) -> Fitted:
    """Gauss-Newton over some coordinates on some scenes.

    What is minimised is the mean square error, times one and a hundredth for each spread squared by which a
    move is off what is usual, and what a prior adds.

    Args:
        objective: of the errors.
        point: where the fit starts, with the columns that are kept.
        which: the coordinates that move; with none the point is where it was.
        scenes: the pairs that are looked at; all by default.
        steps: at most so many.
        fresh: whose columns are computed anew at each step; the others' are kept. All by default. An
            objective that `follows` takes its columns along to a point: up to six steps are made on those,
            and all count as one.
        prior: what is believed of these coordinates beforehand.

    Returns:
        the point, its columns those that were computed there; and the mean square residual over these scenes
        with what the prior adds to it.
    """
    task = _Task(objective, list(which), list(range(len(point.errors)) if scenes is None else scenes), prior)
    most, worth = (_FOLLOWED, _ANEW) if objective.follows else (1, _WORTHWHILE)
    at = Fitted(point, task.total(point))
    kept = {} if fresh is None else {i: point.columns[i] for i in task.which if i not in set(fresh)}
    for _ in range(steps if task.which else 0):  # a given camera has no base to be fitted
        columns = at.point.with_columns({**at.point.columns, **kept})
        at = start = Fitted(objective.compute(columns, task.which), at.total)
        for _ in range(most):
            better = task.step(at)
            if better is None:
                break
            gained = at.total - better.total
            at = better._replace(point=objective.follow(at.point, better.point))
            if gained < _WORTHWHILE * at.total:
                break
        if objective.follows:
            kept = {i: at.point.columns[i] for i in kept}
            at = at._replace(point=at.point.with_columns({}))
        if start.total - at.total < worth * at.total:
            break
    return at


class _Task(NamedTuple):
    """What is minimised, over which coordinates and on which scenes."""

    objective: Objective
    which: list[int]
    scenes: list[int]
    prior: Belief | None

    def total(self, point: Point) -> float:
        believed = 0.0 if self.prior is None else self.prior.penalty(point.z[self.which])
        return self._error(point) * _excess(point, self.which) + believed

    def _error(self, point: Point) -> float:
        return float(point.errors[self.scenes].mean())

    def step(self, at: Fitted) -> Fitted | None:
        """The first better point along the step, or None."""
        point = at.point
        gram, slope = (part[self.scenes].sum(0) for part in self.objective.normal(point, self.which))
        beliefs = [modest(point, self.which, self._error(point))]
        beliefs += [] if self.prior is None else [self.prior.normal(point.z[self.which])]
        for own_gram, own_slope in beliefs:
            gram, slope = gram + len(self.scenes) * own_gram, slope + len(self.scenes) * own_slope
        move = solve(gram, slope, point.z[self.which], point.model.ranges[:, self.which])
        for share in (1.0, 0.5, 0.2):
            z = point.z.copy()
            z[self.which] = np.clip(z[self.which] + share * move, *point.model.ranges[:, self.which])
            found = self.objective.at(point.model, z)
            total = self.total(found)
            if total < at.total:
                return Fitted(found, total)
        return None


def modest(point: Point, which: Sequence[int], error: float) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) and (K,) that keep moves near to what is usual, in proportion to the mean square error: what
    a model leaves says how far its figures may be off."""
    which = list(which)
    precisions = _MODEST * point.model.precisions[which]
    weights = error / _excess(point, which) * precisions
    return np.diag(weights), weights * (point.model.usual - point.z)[which]


def _excess(point: Point, which: Sequence[int]) -> float:
    """What the error is multiplied by for moves that are off what is usual."""
    which = list(which)
    off = (point.z - point.model.usual)[which]
    return 1 + _MODEST * float((point.model.precisions[which] * off**2).sum())
