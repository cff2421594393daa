"""Which effect causes the gap: screen all by secants, refit the best, accept what holds on other scenes.

Works on anything that has the columns and errors of a `Problem`, residuals or statistics alike.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxisp.gap.effects import EFFECTS
from jaxisp.gap.measured import Measured, Split
from jaxisp.gap.refit import FARTHEST, Trial, Whole, distant, lowest, refit, searched, switched_on
from jaxisp.gap.solve import modest, solve

LEADING = 0.25
"""What the first of the causes must close: less does not account for a gap, a stranger looks like that."""
_REFITTED = 6
_AS_MUCH = 0.8  # of what the best closes: a form that is not quite right costs a fifth
_NEARER = 0.05
"""By what share of the mean square distance of pixels one effect must be nearer than another to be told from
it by that."""


def screen(problem: Measured, names: Sequence[str], split: Split) -> dict[str, float]:
    """The drop of the held-out error that each effect promises beyond the base's own, by linear prediction.

    Both halves are predicted from each other, which halves the chance of a lucky split.
    """
    base = problem.model.base_indices + switched_on(problem)
    steps = {i: lowest(problem, i, range(len(problem.errors(problem.z)))) for i in searched(problem, names)}
    problem.compute([*base, *problem.model.indices(names)], steps | distant(problem, names))
    halves = [(split.fit, split.held_out), (split.held_out, split.fit)]
    gram, slope = problem.normal(sorted(problem.columns))
    order = {i: k for k, i in enumerate(sorted(problem.columns))}
    errors = problem.errors(problem.z)

    def promised(which: Sequence[int]) -> float:
        at = [order[i] for i in which]
        total = 0.0
        for learn, apply in halves:
            believed = modest(problem, which, float(errors[list(learn)].mean()))
            move = solve(
                gram[list(learn)][:, at][:, :, at].mean(0) + believed[0],
                slope[list(learn)][:, at].mean(0) + believed[1],
                problem.z[list(which)], problem.model.ranges[:, list(which)],
            )  # fmt: skip
            a, b = gram[list(apply)][:, at][:, :, at].mean(0), slope[list(apply)][:, at].mean(0)
            total += float(2 * move @ b - move @ a @ move) / 2
        return total

    own = promised(base) if base else 0.0
    return {
        name: promised([*base, *problem.model.indices([name])]) - own - _anyway(problem, name)
        for name in names
    }


def _anyway(problem: Measured, name: str) -> float:
    """How much the error falls where an effect does no more than what the file does anyway."""
    z = problem.z.copy()
    for i in set(problem.model.indices([name])) & set(problem.references):
        z[i] = problem.references[i]
    return float((problem.errors(problem.z) - problem.errors(z)).mean()) if (z != problem.z).any() else 0.0


def best(trials: Sequence[Trial], seen: Sequence[str] = ()) -> Trial | None:
    """The accepted trial that closes most, or of those that close about as much or are nearer by far the one
    whose pictures are clearly nearest; one that another can imitate in full is preferred to it.

    Args:
        trials: of one step.
        seen: effects that the files themselves show: what others close may be theirs, so that they come
            first where they could lead.
    """
    accepted = sorted((t for t in trials if t.accepted), key=lambda t: -t.closed)
    if not accepted:
        return None
    shown = [t for t in accepted if t.effect in seen and t.closed >= LEADING]
    if shown:
        return shown[0]
    first = _nearest([t for t in accepted if _rivals(t, accepted[0])])
    for other in (t for t in accepted if t is not first):
        imitated = other.effect in EFFECTS[first.effect].contains and other.closed > 0.93 * first.closed
        simpler = len(EFFECTS[other.effect].moves) < len(EFFECTS[first.effect].moves)
        as_good = simpler and other.closed > 0.98 * first.closed
        if (imitated or as_good) and not told_by_pixels(first, other):
            first = other
    return first


def _rivals(other: Trial, most: Trial) -> bool:
    """Whether an effect closes about as much as what closes most, or could lead and is so much nearer in
    pixels as one that is as much farther would be refused for."""
    nearer = told_by_pixels(other, most) and other.farther < most.farther - FARTHEST
    return other.closed > _AS_MUCH * most.closed or (other.closed >= LEADING and nearer)


def _nearest(trials: Sequence[Trial]) -> Trial:
    """The first of these, or the one whose pixels are nearer to the real ones by more than chance."""
    near = min(trials, key=lambda t: t.farther)
    return near if told_by_pixels(near, trials[0]) else trials[0]


def told_by_pixels(one: Trial, other: Trial) -> bool:
    """Whether the one's pictures are clearly nearer than the other's, where no noise is at stake."""
    random = any(EFFECTS[t.effect].random for t in (one, other))
    return not random and one.farther < other.farther - _NEARER


def lookalikes(winner: Trial, trials: Sequence[Trial], apart: float = np.inf) -> list[str]:
    """Effects whose closure these pairs cannot tell from the winner's.

    Args:
        winner: the best of the trials.
        trials: of one step.
        apart: shares that differ by more are told apart, unless the winner's own interval says otherwise, or
            the two are known to be easily taken for one another and the other leaves less than twice as much:
            what they leave then is not theirs alone, and grows with the gap.
    """
    wide, interval = (1 - _AS_MUCH) * winner.closed, 0.5 * (winner.high - winner.low)

    def near(other: Trial) -> bool:
        alike = _alike(winner.effect, other.effect) and other.after < 2 * winner.after
        margin = wide if alike else min(wide, apart)
        as_much = other.closed > winner.closed - max(margin, interval)
        told = not other.possible or told_by_pixels(winner, other)
        return other.effect != winner.effect and as_much and not told

    return [t.effect for t in trials if near(t)]


def like_the_nearest(trials: Sequence[Trial], others: Sequence[str]) -> list[str]:
    """What the effect that closes most may have been taken for, where that could lead: one move from nothing,
    which is what screening sees, does not promise what the whole of an effect does."""
    nearest = max(trials, key=lambda t: t.closed)
    alike = EFFECTS[nearest.effect].alternatives if nearest.closed >= LEADING else ()
    return [name for name in others if name in alike]


def _alike(one: str, other: str) -> bool:
    return other in EFFECTS[one].alternatives or one in EFFECTS[other].alternatives


Tick = Callable[[int, int, str], Any]


class Terms(NamedTuple):
    """When an effect counts, and when it is enough.

    Attributes:
        least: the share of the gap that the lower end of its interval must be above.
        most: how many are accepted at most.
        leading: the share of the gap that the first must close.
        part: the share of what is left that the lower end must be above.
        enough: the share of the gap that no other effect is looked for to close.
        apart: of `lookalikes`.
        seen: effects that the files themselves show; they are refitted whatever they promise.
    """

    least: float
    most: int
    leading: float = LEADING
    part: float = 0.0
    enough: float = -np.inf
    apart: float = np.inf
    seen: Sequence[str] = ()


def search(
    problem: Measured, names: Sequence[str], split: Split, whole: Whole, terms: Terms, tick: Tick
) -> tuple[list[tuple[Trial, list[str]]], dict[str, Trial], dict[str, float]]:
    """Forward steps: the best effect is added and fitted, and all others are tried again.

    Returns:
        the accepted trials with their look-alikes, in order; the trials of the first step; what each effect
        promised there.
    """
    most, seen, remaining = terms.most, terms.seen, 1.0
    left = list(names)
    causes: list[tuple[Trial, list[str]]] = []
    first_trials: dict[str, Trial] = {}
    first_promises: dict[str, float] = {} if most and names else screen(problem, left, split)
    for step in range(min(most, len(names))):
        tick(step, most, "screening effects")
        promises = screen(problem, left, split)
        ranked = sorted(left, key=lambda name: -promises[name])
        tried = [n for n in ranked[:_REFITTED] if promises[n] > 0.01 * whole.size] or ranked[:1]
        tried += [n for n in left if n in seen and n not in tried]
        trials, least = [], max(terms.least, terms.part * remaining)
        for name in tried:
            tick(step, most, f"refitting {name}")
            trials.append(refit(problem, name, split, whole, least))
        for name in like_the_nearest(trials, [n for n in left if n not in tried]):
            tick(step, most, f"refitting {name}")
            trials.append(refit(problem, name, split, whole, least))
        if step == 0:
            first_trials, first_promises = {t.effect: t for t in trials}, promises
        winner = best(trials, seen)
        if winner is None or (not causes and winner.closed < terms.leading):
            break
        causes.append((winner, lookalikes(winner, trials, terms.apart)))
        left.remove(winner.effect)
        problem.move_to(winner.z)
        if winner.choice is not None:
            problem.choose(winner.choice)
        remaining -= winner.closed
        if remaining < terms.enough:
            break
    return causes, first_trials, first_promises
