"""Which effect may cause the gap: all screened by secants, and the best of those that were refitted.

Works on anything that has the columns and errors of a `Problem`, residuals or statistics alike.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.gauss_newton import modest, solve
from jaxisp.gap.objective.protocol import Measured
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.parallel import each
from jaxisp.gap.search.refit import FARTHEST, NEARER, Trial, distant, lowest, searched, switched_on
from jaxisp.gap.simulator.effects import EFFECTS

LEADING = 0.25
"""What the first of the causes must close: less does not account for a gap, a stranger looks like that."""
_AS_MUCH = 0.8  # of what the best closes: a form that is not quite right costs a fifth


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
        own = Normal(gram[:, at][:, :, at], slope[:, at])
        total = 0.0
        for learn, apply in halves:
            move = _step(problem, which, own, learn, errors)
            a, b = own.gram[list(apply)].mean(0), own.slope[list(apply)].mean(0)
            total += float(2 * move @ b - move @ a @ move) / 2
        return total

    own = promised(base) if base else 0.0
    return {
        name: promised([*base, *problem.model.indices([name])]) - own - _anyway(problem, name)
        for name in names
    }


def hidden(problem: Measured, names: Sequence[str], least: float) -> list[str]:
    """Effects that these pairs cannot show: half of their range changes them by less than `least`, a mean
    square, beyond what the base imitates. Grey scenes say nothing of saturation.

    Needs the columns of `screen`. Of what is searched for on a grid nothing is said: it has no such change.
    """
    order = {i: k for k, i in enumerate(sorted(problem.columns))}
    gram = problem.normal(list(order))[0].mean(0)
    base = [order[i] for i in (*problem.model.base_indices, *switched_on(problem))]
    onto = np.linalg.pinv(gram[np.ix_(base, base)], rcond=1e-9, hermitian=True)

    def change(name: str) -> float:
        own = problem.model.indices([name])
        at, reach = [order[i] for i in own], np.abs(problem.model.ranges[:, own] - problem.z[own]).max(0) / 2
        beyond = np.diag(gram)[at] - np.einsum(
            "kb,bc,kc->k", gram[np.ix_(at, base)], onto, gram[np.ix_(at, base)]
        )
        return float(reach**2 @ beyond)

    return [name for name in names if not searched(problem, [name]) and change(name) < least]


class Normal(NamedTuple):
    """Normal equations (N, K, K) and (N, K) of each pair."""

    gram: np.ndarray
    slope: np.ndarray


def _step(
    problem: Measured, which: Sequence[int], normal: Normal, learn: Sequence[int], errors: np.ndarray
) -> np.ndarray:
    """(K,) the move of these coordinates that some pairs ask for."""
    which, learn = list(which), list(learn)
    believed = modest(problem, which, float(errors[learn].mean()))
    return solve(
        normal.gram[learn].mean(0) + believed[0],
        normal.slope[learn].mean(0) + believed[1],
        problem.z[which], problem.model.ranges[:, which],
    )  # fmt: skip


def _anyway(problem: Measured, name: str) -> float:
    """How much the error falls where an effect does no more than what the file does anyway."""
    z = problem.z.copy()
    for i in set(problem.model.indices([name])) & set(problem.references):
        z[i] = problem.references[i]
    return float((problem.errors(problem.z) - problem.errors(z)).mean()) if (z != problem.z).any() else 0.0


_ALONG = (1.0, 0.5, 0.25)
"""How much of a step is tried."""


def foretold(problem: Measured, effect: str, split: Split) -> float:
    """The drop of the held-out error with an effect and the base one step on, as `screen` sees that step from
    the fitted pairs: as much of it as is best there. Statistics follow most effects in curves, which a
    straight line promises too little of."""
    which = [*problem.model.base_indices, *switched_on(problem), *problem.model.indices([effect])]
    errors = problem.errors(problem.z)
    move = _step(problem, which, Normal(*problem.normal(which)), split.fit, errors)

    def along(share: float) -> np.ndarray:
        z = problem.z.copy()
        z[which] = np.clip(z[which] + share * move, *problem.model.ranges[:, which])
        return problem.errors(z)

    found = min((errors, *each(along, _ALONG)), key=lambda e: e[list(split.fit)].mean())
    return float((errors - found)[list(split.held_out)].mean()) - _anyway(problem, effect)


def best(trials: Sequence[Trial], seen: Sequence[str] = (), remaining: float = 1.0) -> Trial | None:
    """The accepted trial that closes most, or of those that close about as much or are nearer by far the one
    whose pictures are clearly nearest; one that another can imitate in full is preferred to it.

    Args:
        trials: of one step.
        seen: effects that the files themselves show: what others close may be theirs, so that they come
            first where they could lead.
        remaining: the share of the gap that causes before left.
    """
    accepted = sorted((t for t in trials if t.accepted), key=lambda t: -t.closed)
    if not accepted:
        return None
    shown = [t for t in accepted if t.effect in seen and t.closed >= LEADING]
    if shown:
        return shown[0]
    first = _nearest([t for t in accepted if _rivals(t, accepted[0], remaining)])
    for other in (t for t in accepted if t is not first):
        imitated = other.effect in EFFECTS[first.effect].contains and other.closed > 0.93 * first.closed
        simpler = len(EFFECTS[other.effect].moves) < len(EFFECTS[first.effect].moves)
        as_good = simpler and other.closed > 0.98 * first.closed
        if (imitated or as_good) and not told_by_pixels(first, other):
            first = other
    return first


def _rivals(other: Trial, most: Trial, remaining: float) -> bool:
    """Whether an effect closes about as much as what closes most, or could lead what is left and is so much
    nearer in pixels as one that is as much farther would be refused for."""
    nearer = told_by_pixels(other, most) and other.farther < most.farther - FARTHEST
    return other.closed > _AS_MUCH * most.closed or (other.closed >= LEADING * remaining and nearer)


def _nearest(trials: Sequence[Trial]) -> Trial:
    """The first of these, or the one whose pixels are nearer to the real ones by more than chance."""
    near = min(trials, key=lambda t: t.farther)
    return near if told_by_pixels(near, trials[0]) else trials[0]


def told_by_pixels(one: Trial, other: Trial) -> bool:
    """Whether the one's pictures are clearly nearer than the other's, where no noise is at stake."""
    random = any(EFFECTS[t.effect].random for t in (one, other))
    return not random and one.farther < other.farther - NEARER


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


def of_form(effect: str, causes: Sequence[Trial]) -> float:
    """The share of the gap that an effect may close where one of the causes, for which it is easily taken, is
    there in a form that is not quite right."""
    return max(((1 - _AS_MUCH) * t.closed for t in causes if _alike(t.effect, effect)), default=0.0)


def like_the_nearest(trials: Sequence[Trial], others: Sequence[str]) -> list[str]:
    """What the effect that closes most may have been taken for, where that could lead: one move from nothing,
    which is what screening sees, does not promise what the whole of an effect does."""
    nearest = max(trials, key=lambda t: t.closed)
    alike = EFFECTS[nearest.effect].alternatives if nearest.closed >= LEADING else ()
    return [name for name in others if name in alike]


def _alike(one: str, other: str) -> bool:
    return other in EFFECTS[one].alternatives or one in EFFECTS[other].alternatives
