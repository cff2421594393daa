"""Stepwise search: effects are refitted one after another and accepted if they generalise to other scenes."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import Tick
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Evidence, Point
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.search.refit import distance, nearest_form, refit
from jaxisp.gap.search.screening import (
    best,
    closer_in_pixels,
    drop_at,
    halves,
    hidden,
    like_the_nearest,
    lookalikes,
    of_form,
    predicted,
    screen,
    smallest,
)
from jaxisp.gap.search.trial import Bars, Cause, Trial, Whole
from jaxisp.process.memory import give_back

Forms = dict[str, np.ndarray]


class Terms(NamedTuple):
    """Conditions for accepting effects and for stopping the search; shares are of the gap.

    Attributes:
        criteria: of the kind of pairs.
        whole: the gap.
        least: share that the lower end of an effect's interval must exceed.
        most: largest number of accepted effects.
        leading: share that the first effect must close.
        enough: remaining share below which the search stops.
        apart: argument of `lookalikes`.
        seen: effects that the files themselves show; they are always refitted.
        plainly: as `least`, for later effects that pixels show on their own; these may be small parts of a
            large gap.
        visible: argument `least` of `hidden`.
        bars: as `least`, for effects with a bar of their own.
    """

    criteria: Criteria
    whole: Whole
    least: float
    most: int
    leading: float
    enough: float = -np.inf
    apart: float = np.inf
    seen: Sequence[str] = ()
    plainly: float = np.inf
    visible: float = 0.0
    bars: Mapping[str, float] = MappingProxyType({})


class Searched(NamedTuple):
    """Result of the stepwise search.

    Attributes:
        causes: accepted trials with their look-alikes, in order of acceptance.
        trials: trials of the first step, by effect.
        predicted: predicted drop of the error at the first step, by effect.
        hidden: effects that these pairs cannot show.
        smallest: result of `screening.smallest`: the least change of each effect that the gap would show.
        steps: trials of each step.
        halves: result of `screening.halves`, of the first step.
    """

    causes: list[Cause]
    trials: dict[str, Trial]
    predicted: dict[str, float]
    hidden: list[str]
    smallest: Mapping[str, tuple[int, float]]
    steps: Sequence[Sequence[Trial]] = ()
    halves: Mapping[str, float] = MappingProxyType({})


def search(evidence: Evidence, start: Point, names: Sequence[str], terms: Terms, tick: Tick) -> Searched:
    """Forward selection, then one backward pass.

    Each forward step adds the best effect and tries the others again. The backward pass drops effects whose
    contribution the others can absorb.
    """
    if not (terms.most and names):
        drops, screened = screen(evidence, start, names)
        least = terms.visible
        hid, small = hidden(evidence, screened, names, least), smallest(evidence, screened, names, least)
        return Searched([], {}, drops, hid, small)
    at, left, criteria = start, list(names), terms.criteria
    causes: list[Cause] = []
    first_trials: dict[str, Trial] = {}
    first_drops: dict[str, float] = {}
    unseen: list[str] = []
    seen: dict[str, tuple[int, float]] = {}
    steps: list[list[Trial]] = []
    agreed: dict[str, float] = {}
    views = _views(evidence, start)
    for step in range(min(terms.most, len(names))):
        accepted = [t for t, _ in causes]
        trials, drops, at = _tried(evidence, views, left, accepted, terms, tick)
        if step == 0:
            first_trials, first_drops = {t.effect: t for t in trials}, drops
            unseen = hidden(evidence, at, names, terms.visible)
            seen = smallest(evidence, at, names, terms.visible)
            agreed = halves(evidence, at, [t.effect for t in trials])
        elif criteria.anew:
            tick(step, terms.most, "fitting the best anew")
            trials = _again(evidence, at, start.z, trials, terms)
        steps.append(list(trials))
        winner = best(trials, criteria, terms.seen, _remaining(accepted))
        if winner is None or (not causes and winner.closed < terms.leading):
            break
        causes.append((winner, lookalikes(winner, trials, criteria, terms.apart)))
        left.remove(winner.effect)
        at = ended(evidence, at, winner)
        views = [_View(at)]
        if _remaining([*accepted, winner]) < terms.enough:
            break
    if len(causes) > 1:
        tick(terms.most - 1, terms.most, "looking for effects that the others make up for")
        needed = _needed(evidence, start, [t for t, _ in causes], terms)
        if len(needed) < len(causes):
            names_needed = [t.effect for t in needed]
            others = [t for t in first_trials.values() if t.effect not in names_needed]
            causes = [(t, lookalikes(t, others, criteria, terms.apart)) for t in needed]
    return Searched(causes, first_trials, first_drops, unseen, seen, steps, agreed)


def _remaining(causes: Sequence[Trial]) -> float:
    """The share of the gap that these causes leave."""
    return 1.0 - sum(t.closed for t in causes)


def ended(evidence: Evidence, point: Point, *trials: Trial) -> Point:
    """The point after these trials, applied in order."""
    model, z = point.model, point.z
    for trial in trials:
        model = model if trial.choice is None else model.chosen(trial.choice)
        z = trial.z
    return evidence.at(model, z)


class _View(NamedTuple):
    """A point from which effects are predicted.

    Attributes:
        point: the point.
        more: (N,) its error minus the error of the current point; None for the current point.
    """

    point: Point
    more: np.ndarray | None = None


def _tried(
    evidence: Evidence,
    views: Sequence[_View],
    left: Sequence[str],
    causes: Sequence[Trial],
    terms: Terms,
    tick: Tick,
) -> tuple[list[Trial], dict[str, float], Point]:
    """One forward step: predict the drop of each remaining effect and refit the most promising ones.

    Returns:
        the trials; the predicted drop by effect; the point with its columns.
    """
    step, criteria = len(causes), terms.criteria
    tick(step, terms.most, "screening effects")
    screened = [screen(evidence, view.point, left) for view in views]
    # fits start at the first view alone
    views = [
        view._replace(point=point if k == 0 else point.with_columns({}))
        for k, (view, (_, point)) in enumerate(zip(views, screened))
    ]
    drops = _most(evidence, views, [found for found, _ in screened])
    point = views[0].point
    forms = _forms(evidence, point, left, criteria)
    drops |= {name: max(drops[name], drop_at(evidence, point, z)) for name, z in forms.items()}
    rest = _remaining(causes)
    least = max(terms.least, criteria.least_of_rest * rest)

    def one(name: str) -> Trial:
        tick(step, terms.most, f"refitting {name}")
        own = max(of_form(name, causes, criteria), terms.bars.get(name, 0.0))
        bars = Bars(max(least, own), max(terms.plainly, own) if step else np.inf, rest)
        trial = refit(evidence, point, name, terms.whole, bars, criteria, form=forms.get(name))
        give_back()
        return trial

    ranked = sorted(left, key=lambda name: -drops[name])
    enough = criteria.predicted * terms.whole.size
    tried = [n for n in ranked[: criteria.refitted] if drops[n] > enough] or ranked[:1]
    tried += [n for n in left if n in terms.seen and n not in tried]
    trials = parallel_map(one, tried)
    trials += parallel_map(one, like_the_nearest(trials, [n for n in left if n not in tried], criteria))
    if not causes:
        drops |= _predicted(evidence, views, [t.effect for t in trials], forms)
    return trials, drops, point


def _again(
    evidence: Evidence, point: Point, first: np.ndarray, trials: Sequence[Trial], terms: Terms
) -> list[Trial]:
    """Refit the two most important trials with new columns, and keep the better fit of each.

    They are the trial that closes most, and the one that pixels show best or that closes second most. Each is
    refitted from its end, and from its end with the original base. The fit with the least error on the fitted
    pairs is kept.
    """
    criteria, base = terms.criteria, point.model.base_indices
    ranked = sorted(trials, key=lambda t: -t.closed)
    ranked = [t for t in ranked if t.choice is None]  # with a new demosaicker, the base was already refitted
    nearer = [t for t in ranked[1:] if closer_in_pixels(t, ranked[0], criteria)]
    second = [min(nearer, key=lambda t: t.farther)] if nearer else ranked[1:2]
    begun = []
    for trial in (*ranked[:1], *second):
        anew = trial.z.copy()
        anew[base] = first[base]
        begun += [(trial, trial.z), (trial, anew)]

    def from_there(own: tuple[Trial, np.ndarray]) -> Trial:
        trial, z = own
        return refit(evidence, point, trial.effect, terms.whole, trial.bars, criteria, begin=z)

    found = parallel_map(from_there, begun)
    return [min((t, *(f for f in found if f.effect == t.effect)), key=lambda t: t.error) for t in trials]


def _views(evidence: Evidence, point: Point) -> list[_View]:
    """The current point and, if the base has a rival demosaicker, the point with that, its base refitted."""
    if evidence.rival is None:
        return [_View(point)]
    other = evidence.at(point.model.chosen(evidence.rival), point.z)
    part, at = evidence.fitted(other)
    z = fit(part, at, at.model.base_indices, steps=2).point.z
    other = evidence.at(other.model, z)
    return [_View(point), _View(other, other.errors - point.errors)]


def _most(
    evidence: Evidence, views: Sequence[_View], found: Sequence[Mapping[str, float]]
) -> dict[str, float]:
    """The largest drop of each effect over the views, relative to the held-out error of the current point."""
    held = list(evidence.split.held_out)
    less = [0.0 if view.more is None else float(view.more[held].mean()) for view in views]
    return {name: max(own[name] - more for own, more in zip(found, less)) for name in found[0]}


def _predicted(
    evidence: Evidence, views: Sequence[_View], names: Sequence[str], forms: Forms
) -> dict[str, float]:
    """The predicted drop of each effect on the held-out pairs: at its fitted form, or after one step."""
    steps = [{name: predicted(evidence, view.point, name) for name in names} for view in views]
    at_forms = {name: drop_at(evidence, views[0].point, z) for name, z in forms.items()}
    return _most(evidence, views, steps) | at_forms


def _forms(evidence: Evidence, point: Point, names: Sequence[str], criteria: Criteria) -> Forms:
    """Start points of effects with exact forms, by effect: a small step does not predict their drop."""
    found = {name: nearest_form(evidence, point, name, criteria) for name in names}
    return {name: z for name, z in found.items() if z is not None}


def _needed(evidence: Evidence, start: Point, trials: Sequence[Trial], terms: Terms) -> Sequence[Trial]:
    """Backward pass: drop trials whose contribution the others can absorb.

    Each trial is left out in turn, except the last and those that the files show. The others are refitted
    from the common end. The trial is dropped if the gap rises by a harmless amount and pixels stay as close.
    """
    end, near = trials[-1], _apart(evidence, ended(evidence, start, *trials))
    for left_out in (t for t in trials[:-1] if t.effect not in terms.seen):
        rest = [t.effect for t in trials if t is not left_out]
        found, at = replayed(evidence, start, rest, end.z, terms.whole, terms.least, terms.criteria)
        as_good = found[-1].after - end.after < terms.least * terms.whole.size
        enough = as_good and all(t.accepted(terms.criteria) for t in found)
        if enough and _apart(evidence, at) <= (1 + terms.criteria.nearer) * near:
            return _needed(evidence, start, found, terms)
    return trials


def _apart(evidence: Evidence, point: Point) -> float:
    """Distance of the held-out pixels at a point, with its random effects off."""
    return distance(evidence.held_out(point)[0], point.model, point.model.still(point.z))


def replayed(
    evidence: Evidence,
    start: Point,
    names: Sequence[str],
    end: np.ndarray,
    whole: Whole,
    least: float,
    criteria: Criteria,
) -> tuple[list[Trial], Point]:
    """Refit these effects in order from the start, each from its coordinates in `end`.

    Returns:
        the trials; the final point.
    """
    at, model = start, start.model
    found: list[Trial] = []
    for k, name in enumerate(names):
        off = model.indices(set(model.effects) - set(names[: k + 1]))
        begin = end.copy()
        begin[off] = 0
        bars = Bars(least, rest=_remaining(found))
        found.append(refit(evidence, at.with_columns({}), name, whole, bars, criteria, begin=begin))
        at = ended(evidence, at, found[-1])
    return found, at
