"""Which effects cause the gap, one after the other: refitted, accepted where they hold on other scenes.

Works on anything that has the columns and errors of a `Problem`, residuals or statistics alike.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import Tick
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Measured
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.parallel import each
from jaxisp.gap.search.refit import NEARER, Trial, Whole, distance, nearest_form, refit
from jaxisp.gap.search.screening import (
    LEADING,
    best,
    foretold,
    hidden,
    like_the_nearest,
    lookalikes,
    of_form,
    screen,
    told_by_pixels,
)
from jaxisp.gap.simulator.model import Model

_REFITTED = 6  # of those that screening promises most of

Forms = dict[str, np.ndarray]


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
        plainly: as `least`, of a later effect that pixels show by themselves: beside a large gap another may
            be a small part of it.
        again: whether the best of a later step are fitted once more, all columns anew: the base there has
            imitated what was missing.
        visible: of `hidden`.
        bars: as `least`, of effects that must close more than others.
    """

    least: float
    most: int
    leading: float = LEADING
    part: float = 0.0
    enough: float = -np.inf
    apart: float = np.inf
    seen: Sequence[str] = ()
    plainly: float = np.inf
    again: bool = False
    visible: float = 0.0
    bars: Mapping[str, float] = MappingProxyType({})


class Searched(NamedTuple):
    """What a search has found.

    Attributes:
        causes: the accepted trials with their look-alikes, in order.
        trials: those of the first step.
        promises: what each effect promised there.
        hidden: effects that these pairs cannot show.
    """

    causes: list[tuple[Trial, list[str]]]
    trials: dict[str, Trial]
    promises: dict[str, float]
    hidden: list[str]


def search(
    problem: Measured, names: Sequence[str], split: Split, whole: Whole, terms: Terms, tick: Tick
) -> Searched:
    """Forward steps: the best effect is added and fitted, and all others are tried again. Then one back: what
    the others make up for was only taken for them."""
    if not (terms.most and names):
        promises = screen(problem, names, split)
        return Searched([], {}, promises, hidden(problem, names, terms.visible))
    start, left = (problem.model, problem.z), list(names)
    causes: list[tuple[Trial, list[str]]] = []
    first_trials: dict[str, Trial] = {}
    first_promises: dict[str, float] = {}
    unseen: list[str] = []
    views = _views(problem, split)
    for step in range(min(terms.most, len(names))):
        accepted = [t for t, _ in causes]
        trials, promises = _tried(views, left, accepted, split, whole, terms, tick)
        if step == 0:
            first_trials, first_promises = {t.effect: t for t in trials}, promises
            unseen = hidden(problem, names, terms.visible)
        elif terms.again:
            tick(step, terms.most, "fitting the best anew")
            trials = _again(problem, start[1], trials, split, whole)
        views = views[:1]
        winner = best(trials, terms.seen, _remaining(accepted))
        if winner is None or (not causes and winner.closed < terms.leading):
            break
        causes.append((winner, lookalikes(winner, trials, terms.apart)))
        left.remove(winner.effect)
        _go_to(problem, winner)
        if _remaining([*accepted, winner]) < terms.enough:
            break
    if len(causes) > 1:
        tick(terms.most - 1, terms.most, "looking for effects that the others make up for")
        needed = _needed(problem, start, [t for t, _ in causes], split, whole, terms)
        if len(needed) < len(causes):
            names_needed = [t.effect for t in needed]
            others = [t for t in first_trials.values() if t.effect not in names_needed]
            causes = [(t, lookalikes(t, others, terms.apart)) for t in needed]
    return Searched(causes, first_trials, first_promises, unseen)


def _remaining(causes: Sequence[Trial]) -> float:
    """The share of the gap that these causes leave."""
    return 1.0 - sum(t.closed for t in causes)


def _go_to(problem: Measured, trial: Trial) -> None:
    problem.move_to(trial.z)
    if trial.choice is not None:
        problem.choose(trial.choice)


def _tried(
    views: Sequence["_View"],
    left: Sequence[str],
    causes: Sequence[Trial],
    split: Split,
    whole: Whole,
    terms: Terms,
    tick: Tick,
) -> tuple[list[Trial], dict[str, float]]:
    """One step: of the effects that are left those that promise most beside the causes, refitted, and what
    all of them promise."""
    problem, step, every = views[0].problem, len(causes), (*split.fit, *split.held_out)
    tick(step, terms.most, "screening effects")
    promises = _most(views, lambda view: screen(view, left, split), every)
    forms = _forms(problem, left, split)
    promises |= {name: max(promises[name], _drop(problem, z, every)) for name, z in forms.items()}
    rest = _remaining(causes)
    least = max(terms.least, terms.part * rest)

    def one(name: str) -> Trial:
        tick(step, terms.most, f"refitting {name}")
        form_only = of_form(name, causes)
        own = max(form_only, terms.bars.get(name, 0.0))
        bar, plainly = max(least, own), max(terms.plainly, own) if step else np.inf
        return refit(problem, name, split, whole, bar, form=forms.get(name), plainly=plainly, rest=rest)

    ranked = sorted(left, key=lambda name: -promises[name])
    tried = [n for n in ranked[:_REFITTED] if promises[n] > 0.01 * whole.size] or ranked[:1]
    tried += [n for n in left if n in terms.seen and n not in tried]
    trials = each(one, tried)
    trials += each(one, like_the_nearest(trials, [n for n in left if n not in tried]))
    if not causes:
        promises |= _predicted(views, [t.effect for t in trials], forms, split)
    return trials, promises


def _again(
    problem: Measured, first: np.ndarray, trials: Sequence[Trial], split: Split, whole: Whole
) -> list[Trial]:
    """The trials, the two that matter fitted once more, all columns anew: from where they ended, and from
    there with the base as it was at first. What leaves the least on the fitted pairs stays.

    These are the one that closes most, and the one that pixels show best or else closes second most.
    """
    base, ranked = problem.model.base_indices, sorted(trials, key=lambda t: -t.closed)
    ranked = [t for t in ranked if t.choice is None]  # another demosaicker's base was fitted anew with it
    nearer = [t for t in ranked[1:] if told_by_pixels(t, ranked[0])]
    second = [min(nearer, key=lambda t: t.farther)] if nearer else ranked[1:2]
    points = []
    for trial in (*ranked[:1], *second):
        anew = trial.z.copy()
        anew[base] = first[base]
        points += [(trial, trial.z), (trial, anew)]

    def begun(point: tuple[Trial, np.ndarray]) -> Trial:
        trial, z = point
        return refit(
            problem, trial.effect, split, whole, trial.least, begin=z, plainly=trial.plainly, rest=trial.rest
        )

    found = each(begun, points)
    return [min((t, *(f for f in found if f.effect == t.effect)), key=lambda t: t.error) for t in trials]


class _View(NamedTuple):
    """Where effects are looked at: a problem, and by how much more (N,) it leaves than the one at hand, None
    for that itself."""

    problem: Measured
    more: np.ndarray | None = None


def _views(problem: Measured, split: Split) -> list[_View]:
    """The problem; and if its base has a rival that with the base fitted beside it."""
    if problem.rival is None:
        return [_View(problem)]
    other = copy.copy(problem)
    other.choose(problem.rival)
    part = other.take(split.fit)
    fit(part, part.model.base_indices, range(len(split.fit)), steps=2)
    other.move_to(part.z)
    return [_View(problem), _View(other, other.errors(other.z) - problem.errors(problem.z))]


def _most(
    views: Sequence[_View], look: Callable[[Measured], dict[str, float]], which: Sequence[int]
) -> dict[str, float]:
    """What is promised of each effect where most is, of the error of the problem at hand."""
    less = [0.0 if view.more is None else float(view.more[list(which)].mean()) for view in views]
    found = [look(view.problem) for view in views]
    return {name: max(own[name] - more for own, more in zip(found, less)) for name in found[0]}


def _predicted(views: Sequence[_View], names: Sequence[str], forms: Forms, split: Split) -> dict[str, float]:
    """What is said beforehand of these effects' drop on the held-out pairs: where a form ends, or a step."""
    held = split.held_out
    steps = _most(views, lambda view: {name: foretold(view, name, split) for name in names}, held)
    return steps | {name: _drop(views[0].problem, z, held) for name, z in forms.items()}


def _forms(problem: Measured, names: Sequence[str], split: Split) -> Forms:
    """Where effects of exact forms begin: no small step of theirs promises anything."""
    found = {name: nearest_form(problem, name, split) for name in names}
    return {name: z for name, z in found.items() if z is not None}


def _drop(problem: Measured, z: np.ndarray, which: Sequence[int]) -> float:
    return float((problem.errors(problem.z) - problem.errors(z))[list(which)].mean())


def _needed(
    problem: Measured,
    start: tuple[Model, np.ndarray],
    trials: Sequence[Trial],
    split: Split,
    whole: Whole,
    terms: Terms,
) -> Sequence[Trial]:
    """These trials, or fewer that close as much but for what nulls have, and leave pixels as near: those
    before the last that the files do not show are left out, one after the other, the rest fitted from where
    all of them ended."""
    end, near = trials[-1], _apart(problem, split)
    for left_out in (t for t in trials[:-1] if t.effect not in terms.seen):
        rest = [t.effect for t in trials if t is not left_out]
        found = replayed(problem, start, rest, end.z, split, whole, terms.least)
        as_good = found[-1].after - end.after < terms.least * whole.size
        if all(t.accepted for t in found) and as_good and _apart(problem, split) <= (1 + NEARER) * near:
            return _needed(problem, start, found, split, whole, terms)
    return trials


def _apart(problem: Measured, split: Split) -> float:
    """How far the held-out pixels are where the problem stands, at what is still in that."""
    return distance(problem.take(split.held_out), problem.model.still(problem.z))


def replayed(
    problem: Measured,
    start: tuple[Model, np.ndarray],
    names: Sequence[str],
    end: np.ndarray,
    split: Split,
    whole: Whole,
    least: float,
) -> list[Trial]:
    """Trials of these effects one after the other from the start, each begun from what it ended with."""
    problem.model, z = start
    problem.move_to(z)
    found: list[Trial] = []
    for k, name in enumerate(names):
        off = problem.model.indices(set(problem.model.effects) - set(names[: k + 1]))
        begin = end.copy()
        begin[off] = 0
        found.append(refit(problem, name, split, whole, least, begin=begin, rest=_remaining(found)))
        _go_to(problem, found[-1])
    return found
