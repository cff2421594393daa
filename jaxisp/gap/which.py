"""Which effect causes the gap: screen all by secants, refit the best, accept what holds on other scenes.

Works on anything that has the columns and errors of a `Problem`, residuals or statistics alike.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from jaxisp.gap.effects import EFFECTS
from jaxisp.gap.model import Model
from jaxisp.gap.solve import fit, solve

SMALLEST = 0.05
"""The lower end of an accepted effect's interval of closure."""
_REFITTED = 6
_DRAWS = 400


class Measured(Protocol):
    """What the search needs; see `jaxisp.gap.residual.Problem`."""

    model: Model
    z: np.ndarray
    columns: dict[int, np.ndarray]

    def units(self, z: np.ndarray) -> np.ndarray: ...
    def errors(self, z: np.ndarray) -> np.ndarray: ...
    def compute(self, which: Sequence[int]) -> None: ...
    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]: ...
    def move_to(self, z: np.ndarray) -> None: ...


@dataclasses.dataclass(frozen=True)
class Split:
    """Pairs that parameters are fitted on, and those that every figure comes from."""

    fit: tuple[int, ...]
    held_out: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Trial:
    """An effect refitted with the base: where it ended, and the share of the gap it closes there."""

    effect: str
    z: np.ndarray
    before: float
    after: float
    closed: float
    low: float
    high: float
    least: float

    @property
    def accepted(self) -> bool:
        return self.low > max(SMALLEST, self.least)


def screen(problem: Measured, names: Sequence[str], split: Split) -> dict[str, float]:
    """The drop of the held-out error that each effect promises beyond the base's own, by linear prediction.

    Both halves are predicted from each other, which halves the chance of a lucky split.
    """
    base = problem.model.base_indices + _on(problem)
    problem.compute([*base, *problem.model.indices(names)])
    halves = [(split.fit, split.held_out), (split.held_out, split.fit)]
    gram, slope = problem.normal(sorted(problem.columns))
    order = {i: k for k, i in enumerate(sorted(problem.columns))}

    def promised(which: Sequence[int]) -> float:
        at = [order[i] for i in which]
        total = 0.0
        for learn, apply in halves:
            move = solve(
                gram[list(learn)][:, at][:, :, at].mean(0), slope[list(learn)][:, at].mean(0),
                problem.z[list(which)], problem.model.ranges[:, list(which)],
            )  # fmt: skip
            a, b = gram[list(apply)][:, at][:, :, at].mean(0), slope[list(apply)][:, at].mean(0)
            total += float(2 * move @ b - move @ a @ move) / 2
        return total

    own = promised(base) if base else 0.0
    return {name: promised([*base, *problem.model.indices([name])]) - own for name in names}


def _on(problem: Measured) -> list[int]:
    """Coordinates of effects that were accepted already and stay free."""
    first = len(problem.model.base)
    return [i for i in range(first, len(problem.z)) if problem.z[i] != 0]


def refit(
    problem: Measured,
    effect: str,
    split: Split,
    start: np.ndarray,
    scale: float,
    least: float,
    steps: int = 4,
) -> Trial:
    """Fit an effect and the base together on the fitted pairs, and measure the closure on the others.

    Args:
        start: the point before the effect.
        scale: the whole gap, before any effect less the floor, that closure is a share of.
        least: the share that the lower end of its interval must be above, beside `SMALLEST`.
    """
    kept = problem.columns
    moving = [*problem.model.base_indices, *_on(problem), *problem.model.indices([effect])]
    problem.move_to(start)
    problem.columns = dict(kept)
    held = list(split.held_out)
    before = problem.units(start)[held]
    fit(problem, moving, split.fit, steps=steps, fresh=problem.model.indices([effect]))
    z = problem.z
    after = problem.units(z)[held]
    problem.move_to(start)
    problem.columns = kept
    drop = before - after
    closed = float(np.nanmean(drop)) / scale
    low, high = interval(drop, scale)
    return Trial(effect, z, float(np.nanmean(before)), float(np.nanmean(after)), closed, low, high, least)


def interval(drop: np.ndarray, scale: float, seed: int = 0) -> tuple[float, float]:
    """90 % interval of the mean of (N, U) drops over `scale`, by a bootstrap of pairs and their units."""
    rng = np.random.default_rng(seed)
    n, u = drop.shape
    pairs = rng.integers(n, size=(_DRAWS, n))
    units = rng.integers(u, size=(_DRAWS, n, u))
    means = np.nanmean(drop[pairs[..., None], units], (1, 2)) / scale
    low, high = np.percentile(means, (5, 95))
    return float(low), float(high)


def best(trials: Sequence[Trial]) -> Trial | None:
    """The accepted trial that closes most; one that another can imitate in full is preferred to it."""
    accepted = sorted((t for t in trials if t.accepted), key=lambda t: -t.closed)
    if not accepted:
        return None
    first = accepted[0]
    for other in accepted[1:]:
        imitated = other.effect in EFFECTS[first.effect].contains and other.closed > 0.93 * first.closed
        simpler = len(EFFECTS[other.effect].moves) < len(EFFECTS[first.effect].moves)
        if imitated or (simpler and other.closed > 0.98 * first.closed):
            first = other
    return first


def lookalikes(winner: Trial, trials: Sequence[Trial]) -> list[str]:
    """Effects whose closure these pairs cannot tell from the winner's."""
    margin = max(0.2 * winner.closed, 0.5 * (winner.high - winner.low))
    return [t.effect for t in trials if t.effect != winner.effect and t.closed > winner.closed - margin]


Tick = Callable[[int, int, str], Any]


def search(
    problem: Measured, names: Sequence[str], split: Split, scale: float, least: float, most: int, tick: Tick
) -> tuple[list[tuple[Trial, list[str]]], dict[str, Trial], dict[str, float]]:
    """Forward steps: the best effect is added and fitted, and all others are tried again.

    Returns:
        the accepted trials with their look-alikes, in order; the trials of the first step; what each effect
        promised there.
    """
    left, causes = list(names), []
    first_trials: dict[str, Trial] = {}
    first_promises: dict[str, float] = {}
    for step in range(most):
        tick(step, most, "screening effects")
        promises = screen(problem, left, split)
        ranked = sorted(left, key=lambda name: -promises[name])
        tried = [n for n in ranked[:_REFITTED] if promises[n] > 0.01 * scale] or ranked[:1]
        start = problem.z.copy()
        trials = []
        for name in tried:
            tick(step, most, f"refitting {name}")
            trials.append(refit(problem, name, split, start, scale, least))
        if step == 0:
            first_trials, first_promises = {t.effect: t for t in trials}, promises
        winner = best(trials)
        if winner is None:
            break
        causes.append((winner, lookalikes(winner, trials)))
        left.remove(winner.effect)
        problem.move_to(winner.z)
    return causes, first_trials, first_promises
