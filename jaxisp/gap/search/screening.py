"""Which effect may cause the gap: all screened by secants, and the best of those that were refitted."""

from collections.abc import Sequence

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.gauss_newton import modest, solve
from jaxisp.gap.objective.protocol import Evidence, NormalEquations, Objective, Point
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.search.refit import distant, lowest, searched, switched_on
from jaxisp.gap.search.trial import Trial
from jaxisp.gap.simulator.effects import EFFECTS

_ALONG = (1.0, 0.5, 0.25)
"""How much of a step is tried."""


def screen(evidence: Evidence, point: Point, names: Sequence[str]) -> tuple[dict[str, float], Point]:
    """The predicted drop of the held-out error with each effect, beyond the base's own, by linear prediction;
    and the point with the columns that this took.

    Both halves are predicted from each other, which halves the chance of a lucky split.
    """
    model, split = point.model, evidence.split
    base = model.base_indices + switched_on(point)
    steps = {i: lowest(evidence, point, i) for i in searched(model, names)}
    wanted = [*base, *model.indices(names)]
    point = evidence.compute(point, wanted, steps | distant(evidence, point, names))
    halves = [(split.fit, split.held_out), (split.held_out, split.fit)]
    gram, slope = evidence.normal(point, sorted(point.columns))
    order = {i: k for k, i in enumerate(sorted(point.columns))}

    def drop(which: Sequence[int]) -> float:
        at = [order[i] for i in which]
        own = NormalEquations(gram[:, at][:, :, at], slope[:, at])
        total = 0.0
        for learn, apply in halves:
            move = _step(point, which, own, learn)
            a, b = own.gram[list(apply)].mean(0), own.slope[list(apply)].mean(0)
            total += float(2 * move @ b - move @ a @ move) / 2
        return total

    own = drop(base) if base else 0.0
    return {
        name: drop([*base, *model.indices([name])]) - own - _anyway(evidence, point, name) for name in names
    }, point


def hidden(objective: Objective, point: Point, names: Sequence[str], least: float) -> list[str]:
    """Effects that these pairs cannot show: half of their range changes them by less than `least`, a mean
    square, beyond what the base imitates. Grey scenes cannot show saturation, for example.

    Needs the columns of `screen`. An effect that is searched for on a grid has no such change, and is never
    listed.
    """
    model = point.model
    order = {i: k for k, i in enumerate(sorted(point.columns))}
    gram = objective.normal(point, list(order)).gram.mean(0)
    base = [order[i] for i in (*model.base_indices, *switched_on(point))]
    onto = np.linalg.pinv(gram[np.ix_(base, base)], rcond=1e-9, hermitian=True)

    def change(name: str) -> float:
        own = model.indices([name])
        at, reach = [order[i] for i in own], np.abs(model.ranges[:, own] - point.z[own]).max(0) / 2
        beyond = np.diag(gram)[at] - np.einsum(
            "kb,bc,kc->k", gram[np.ix_(at, base)], onto, gram[np.ix_(at, base)]
        )
        return float(reach**2 @ beyond)

    return [name for name in names if not searched(model, [name]) and change(name) < least]


def _step(point: Point, which: Sequence[int], normal: NormalEquations, learn: Sequence[int]) -> np.ndarray:
    """(K,) the move of these coordinates that some pairs ask for."""
    which, learn = list(which), list(learn)
    believed = modest(point, which, float(point.errors[learn].mean()))
    return solve(
        normal.gram[learn].mean(0) + believed[0],
        normal.slope[learn].mean(0) + believed[1],
        point.z[which], point.model.ranges[:, which],
    )  # fmt: skip


def _anyway(evidence: Evidence, point: Point, name: str) -> float:
    """How much the error falls where an effect does no more than what the file does anyway."""
    z = point.z.copy()
    for i in set(point.model.indices([name])) & set(evidence.references):
        z[i] = evidence.references[i]
    if (z == point.z).all():
        return 0.0
    return float((point.errors - evidence.at(point.model, z).errors).mean())


def predicted(evidence: Evidence, point: Point, effect: str) -> float:
    """The drop of the held-out error with an effect and the base one step on, as `screen` sees that step from
    the fitted pairs: as much of it as is best there. Statistics follow most effects in curves, for
    which a straight line predicts too little."""
    model, split = point.model, evidence.split
    which = [*model.base_indices, *switched_on(point), *model.indices([effect])]
    move = _step(point, which, evidence.normal(point, which), split.fit)

    def along(share: float) -> np.ndarray:
        z = point.z.copy()
        z[which] = np.clip(z[which] + share * move, *model.ranges[:, which])
        return evidence.at(model, z).errors

    found = min((point.errors, *parallel_map(along, _ALONG)), key=lambda e: e[list(split.fit)].mean())
    return float((point.errors - found)[list(split.held_out)].mean()) - _anyway(evidence, point, effect)


def best(
    trials: Sequence[Trial], criteria: Criteria, seen: Sequence[str] = (), remaining: float = 1.0
) -> Trial | None:
    """The accepted trial that closes most, or of those that close about as much or are nearer by far the one
    whose pictures are clearly nearest; one that another can imitate in full is preferred to it.

    Args:
        trials: of one step.
        criteria: what they are judged by.
        seen: effects that the files themselves show: what others close may be theirs, so that they come
            first where they could lead.
        remaining: the share of the gap that earlier causes leave.
    """
    accepted = sorted((t for t in trials if t.accepted(criteria)), key=lambda t: -t.closed)
    if not accepted:
        return None
    shown = [t for t in accepted if t.effect in seen and t.closed >= criteria.leading]
    if shown:
        return shown[0]
    first = _nearest([t for t in accepted if _rivals(t, accepted[0], remaining, criteria)], criteria)
    for other in (t for t in accepted if t is not first):
        contained = other.effect in EFFECTS[first.effect].contains
        imitated = contained and other.closed > criteria.imitated * first.closed
        simpler = len(EFFECTS[other.effect].moves) < len(EFFECTS[first.effect].moves)
        as_good = simpler and other.closed > criteria.simpler * first.closed
        if (imitated or as_good) and not closer_in_pixels(first, other, criteria):
            first = other
    return first


def _rivals(other: Trial, most: Trial, remaining: float, criteria: Criteria) -> bool:
    """Whether an effect closes about as much as what closes most, or could lead what is left and is so much
    nearer in pixels as one that is as much farther would be refused for."""
    nearer = closer_in_pixels(other, most, criteria) and other.farther < most.farther - criteria.farthest
    leads = other.closed >= criteria.leading * remaining and nearer
    return other.closed > criteria.as_much * most.closed or leads


def _nearest(trials: Sequence[Trial], criteria: Criteria) -> Trial:
    """The first of these, or the one whose pixels are nearer to the real ones by more than chance."""
    near = min(trials, key=lambda t: t.farther)
    return near if closer_in_pixels(near, trials[0], criteria) else trials[0]


def closer_in_pixels(one: Trial, other: Trial, criteria: Criteria) -> bool:
    """Whether the one's pictures are clearly nearer than the other's, where no noise is at stake."""
    random = any(EFFECTS[t.effect].random for t in (one, other))
    return not random and one.farther < other.farther - criteria.nearer


def lookalikes(
    winner: Trial, trials: Sequence[Trial], criteria: Criteria, apart: float = np.inf
) -> list[str]:
    """Effects whose closure these pairs cannot tell from the winner's.

    Args:
        winner: the best of the trials.
        trials: of one step.
        criteria: what they are judged by.
        apart: shares that differ by more are told apart, unless the winner's own interval says otherwise, or
            the two are known to be easily taken for one another and the other leaves less than twice as much:
            what they leave then is not theirs alone, and grows with the gap.
    """
    wide, interval = (1 - criteria.as_much) * winner.closed, 0.5 * (winner.high - winner.low)

    def near(other: Trial) -> bool:
        alike = _alike(winner.effect, other.effect) and other.after < criteria.left_alike * winner.after
        margin = wide if alike else min(wide, apart)
        as_much = other.closed > winner.closed - max(margin, interval)
        told = not other.possible(criteria) or closer_in_pixels(winner, other, criteria)
        return other.effect != winner.effect and as_much and not told

    return [t.effect for t in trials if near(t)]


def of_form(effect: str, causes: Sequence[Trial], criteria: Criteria) -> float:
    """The share of the gap that an effect may close where one of the causes, for which it is easily taken, is
    there in a form that is not quite right."""
    own = [(1 - criteria.as_much) * t.closed for t in causes if _alike(t.effect, effect)]
    return max(own, default=0.0)


def like_the_nearest(trials: Sequence[Trial], others: Sequence[str], criteria: Criteria) -> list[str]:
    """What the effect that closes most may have been taken for, where that could lead: one move from nothing,
    which is what screening sees, does not predict what the whole of an effect does."""
    nearest = max(trials, key=lambda t: t.closed)
    alike = EFFECTS[nearest.effect].alternatives if nearest.closed >= criteria.leading else ()
    return [name for name in others if name in alike]


def _alike(one: str, other: str) -> bool:
    return other in EFFECTS[one].alternatives or one in EFFECTS[other].alternatives
