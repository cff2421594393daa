"""Which effect causes the gap: screen all by secants, refit the best, accept what holds on other scenes.

Works on anything that has the columns and errors of a `Problem`, residuals or statistics alike.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from jaxisp.gap.effects import EFFECTS
from jaxisp.gap.model import Choice, Model
from jaxisp.gap.solve import fit, solve

SMALLEST = 0.05
"""The lower end of an accepted effect's interval of closure."""
LEADING = 0.25
"""What the first of the causes must close: less does not account for a gap, a stranger looks like that."""
_REFITTED = 6
_DRAWS = 400


class Measured(Protocol):
    """What the search needs; see `jaxisp.gap.residual.Problem`."""

    model: Model
    z: np.ndarray
    columns: dict[int, np.ndarray]
    choices: Sequence[Choice]
    references: Mapping[int, float]  # where a coordinate does what the file does anyway

    def units(self, z: np.ndarray) -> np.ndarray: ...
    def errors(self, z: np.ndarray) -> np.ndarray: ...
    def compute(self, which: Sequence[int], steps: Mapping[int, float] | None = None) -> None: ...
    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]: ...
    def move_to(self, z: np.ndarray) -> None: ...
    def choose(self, choice: Choice) -> None: ...
    def take(self, which: Sequence[int]) -> "Measured": ...


class Part:
    """Some of the pairs of a problem that can be measured only together."""

    choices: Sequence[Choice] = ()

    def __init__(self, whole: Any, which: Sequence[int]) -> None:
        self.__dict__["_whole"], self.__dict__["_which"] = copy.copy(whole), list(which)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._whole, name, value)

    def units(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(self._whole.units(z)[self._which])

    def errors(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(self._whole.errors(z)[self._which])

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        gram, slope = self._whole.normal(which)
        return gram[self._which], slope[self._which]


@dataclasses.dataclass(frozen=True)
class Split:
    """Pairs that parameters are fitted on, and those that every figure comes from."""

    fit: tuple[int, ...]
    held_out: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Trial:
    """An effect refitted with the base: where it ended, and the share of the gap it closes there.

    `choice` is what the base became with it, None where it stayed as it was; `params` are the effect's own
    where `z` has none for it.
    """

    effect: str
    z: np.ndarray
    before: float
    after: float
    closed: float
    low: float
    high: float
    least: float
    choice: Choice | None = None
    params: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def accepted(self) -> bool:
        return self.low > max(SMALLEST, self.least)


def screen(problem: Measured, names: Sequence[str], split: Split) -> dict[str, float]:
    """The drop of the held-out error that each effect promises beyond the base's own, by linear prediction.

    Both halves are predicted from each other, which halves the chance of a lucky split.
    """
    base = problem.model.base_indices + _on(problem)
    steps = {i: _lowest(problem, i, range(len(problem.errors(problem.z)))) for i in _searched(problem, names)}
    problem.compute([*base, *problem.model.indices(names)], steps)
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


def refit(problem: Measured, effect: str, split: Split, scale: float, least: float, steps: int = 4) -> Trial:
    """Fit an effect and the base together on the fitted pairs, and measure the closure on the others.

    The problem stays where it is.

    Args:
        scale: the whole gap, before any effect less the floor, that closure is a share of.
        least: the share that the lower end of its interval must be above, beside `SMALLEST`.
    """
    own = problem.model.indices([effect])
    moving = [*problem.model.base_indices, *_on(problem), *own]
    part, seen = problem.take(split.fit), range(len(split.fit))
    _fit_with(part, moving, own, seen, steps)
    choice = _choose_again(part, seen)
    if choice is not None:
        fit(part, [i for i in moving if i not in _searched(part, [effect])], seen, steps=2)
    held = problem.take(split.held_out)
    before = held.units(problem.z)
    harmless = _harmless(problem, own, moving, split, held) if set(own) & set(problem.references) else before
    if choice is not None:
        held.choose(problem.choices[choice].take(split.held_out))
    after = held.units(part.z)
    drop = harmless - after
    lost = float(np.nanmean(drop))
    low, high = interval(drop, scale)
    chosen = None if choice is None else problem.choices[choice]
    start = float(np.nanmean(before))
    return Trial(effect, part.z, start, start - lost, lost / scale, low, high, least, chosen)


def _harmless(
    problem: Measured, own: Sequence[int], moving: Sequence[int], split: Split, held: Measured
) -> np.ndarray:
    """The held-out units where an effect does what the file does anyway, the base fitted beside it."""
    part = problem.take(split.fit)
    z = problem.z.copy()
    for i in set(own) & set(problem.references):
        z[i] = problem.references[i]
    part.move_to(z)
    fit(part, [i for i in moving if i not in set(own)], range(len(split.fit)), steps=3)
    return held.units(part.z)


def _fit_with(
    part: Measured, moving: Sequence[int], own: Sequence[int], seen: Sequence[int], steps: int
) -> None:
    """Fit, the effect's own columns anew at each step; what does not act smoothly is searched for."""
    searched = [i for i in own if part.model.coordinates[i].move.grid]
    columns = part.columns
    for i in searched:
        part.move_to(_with(part.z, i, part.z[i] + _lowest(part, i, seen)))
    smooth = [i for i in moving if i not in searched]
    part.columns = columns
    fit(part, smooth, seen, steps=steps, fresh=[i for i in own if i in smooth])
    for i in searched:
        for share in (0.5, 0.25):
            part.move_to(_nearby(part, i, share, seen))


def _searched(problem: Measured, names: Sequence[str]) -> list[int]:
    return [i for i in problem.model.indices(names) if problem.model.coordinates[i].move.grid]


def _with(z: np.ndarray, i: int, value: float) -> np.ndarray:
    moved = z.copy()
    moved[i] = value
    return moved


def _lowest(problem: Measured, i: int, seen: Sequence[int]) -> float:
    """Which change of the grid leaves the least error."""
    seen, grid = list(seen), problem.model.coordinates[i].move.grid
    return min(grid, key=lambda v: problem.errors(_with(problem.z, i, v))[seen].mean())


def _nearby(problem: Measured, i: int, share: float, seen: Sequence[int]) -> np.ndarray:
    """The best of the point itself and those a share of the grid's spacing to both sides."""
    grid = np.array(problem.model.coordinates[i].move.grid)
    spacing = np.sort(np.abs(grid - problem.z[i]))[1] * share
    tried = [np.clip(problem.z[i] + d, *problem.model.ranges[:, i]) for d in (0, -spacing, spacing)]
    points = [_with(problem.z, i, v) for v in tried]
    return min(points, key=lambda z: problem.errors(z)[list(seen)].mean())


_CLEARLY = 0.98


def _choose_again(problem: Measured, seen: Sequence[int]) -> int | None:
    """Put the choice that fits best beside the effect into the problem, where it is another; says which.

    Without its effect a camera is explained best by the demosaicker whose flaws look most like the effect.
    """
    seen, model = list(seen), problem.model
    lowest, best_choice = problem.errors(problem.z)[seen].mean() * _CLEARLY, None
    for k, choice in enumerate(problem.choices):
        problem.model = model.chosen(choice)
        error = problem.errors(problem.z)[seen].mean()
        if error < lowest:
            lowest, best_choice = error, k
    problem.model = model
    if best_choice is not None:
        problem.choose(problem.choices[best_choice])
    return best_choice


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
    left = list(names)
    causes: list[tuple[Trial, list[str]]] = []
    first_trials: dict[str, Trial] = {}
    first_promises: dict[str, float] = {}
    for step in range(most):
        tick(step, most, "screening effects")
        promises = screen(problem, left, split)
        ranked = sorted(left, key=lambda name: -promises[name])
        tried = [n for n in ranked[:_REFITTED] if promises[n] > 0.01 * scale] or ranked[:1]
        trials = []
        for name in tried:
            tick(step, most, f"refitting {name}")
            trials.append(refit(problem, name, split, scale, least))
        if step == 0:
            first_trials, first_promises = {t.effect: t for t in trials}, promises
        winner = best(trials)
        if winner is None or (not causes and winner.closed < LEADING):
            break
        causes.append((winner, lookalikes(winner, trials)))
        left.remove(winner.effect)
        problem.move_to(winner.z)
        if winner.choice is not None:
            problem.choose(winner.choice)
    return causes, first_trials, first_promises
