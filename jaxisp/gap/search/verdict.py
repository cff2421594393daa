"""The gap at the base and its causes: effects that lower it by more than where nothing is missing."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import Case, Gap, Tick
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.search.account import Shown, accounted, shown
from jaxisp.gap.search.film_grain import Residual, grain_trial, with_grain
from jaxisp.gap.search.refit import clustered
from jaxisp.gap.search.stepwise import Terms, ended, replayed, search
from jaxisp.gap.search.trial import Cause, Trial, Whole


class Refused(NamedTuple):
    """What comes nearest but does not account for the gap: causes, what shows with them, and the point that
    they lead to."""

    causes: list[Cause]
    after: Shown
    point: Point


class Found(NamedTuple):
    """What a search has found.

    Attributes:
        causes: the accepted effects, each with those like it.
        point: where they lead.
        trials: all that were refitted at first.
        predicted: the drop that screening predicted, by effect.
        before, after: what shows of the gap without and with the causes.
        refused: where there is no cause, what comes nearest.
        hidden: effects that these pairs cannot show.
    """

    causes: list[Cause]
    point: Point
    trials: dict[str, Trial]
    predicted: dict[str, float]
    before: Shown
    after: Shown
    refused: Refused | None = None
    hidden: Sequence[str] = ()

    @property
    def nearest(self) -> list[Trial]:
        """The effects that come nearest where none is accepted."""
        return [] if self.refused is None else [trial for trial, _ in self.refused.causes]


def whole_of(case: Case, size: float) -> Whole:
    """The gap above the floor, unit by unit of the held-out pairs."""
    held = list(case.split.held_out)
    above = case.evidence.units(case.point)[held] - case.floors[held][:, None]
    return Whole(size, clustered(case.evidence, above))


def terms_of(case: Case, gap: Gap) -> Terms:
    """When an effect counts in this gap: the criteria as shares of it."""
    criteria, scale, model = case.criteria, gap.scale, case.point.model
    harmless = criteria.null_drop * gap.unit / scale
    alone = max(harmless, criteria.smallest)
    visible = criteria.null_excess * gap.unit
    # a second compression on the file's own grid imitates a little of any other compression
    references = set(case.evidence.references)
    barred = [name for name in model.effects if references & set(model.indices([name]))]
    return Terms(
        criteria,
        whole_of(case, scale),
        least=alone,
        most=criteria.most_causes if gap.exceeds(criteria.null_drop) else 0,
        leading=criteria.leading * (1 - _grain_closes(case, scale, alone)),
        enough=alone if criteria.least_of_rest else -np.inf,
        apart=criteria.apart * gap.unit / scale,
        seen=case.seen,
        plainly=harmless,
        visible=visible,
        bars=dict.fromkeys(barred, visible / scale),
    )


def searched(case: Case, gap: Gap, tick: Tick) -> Found:
    """As many of the causes found as account for the gap."""
    evidence, criteria, start = case.evidence, case.criteria, case.point
    before, terms = shown(evidence, start), terms_of(case, gap)
    found = search(evidence, start, case.offered, terms, tick)
    steps, trials, predicted = found.causes, found.trials, found.predicted
    refused: Refused | None = None
    for count in range(len(steps), -1, -1):
        causes = steps[:count]
        at = ended(evidence, start, *(t for t, _ in causes))
        if case.stored is not None:
            grain = _grain(case, at, gap.scale, terms.least)
            causes = with_grain(causes, grain, gap.floor, criteria)
            if count == len(steps):
                trials, predicted = trials | {"film_grain": grain}, predicted | {"film_grain": grain.gain}
        # smoothing alone can come nearer than the floor: then nothing is a cause
        if terms.most and causes and max(t.closed for t, _ in causes) >= criteria.leading:
            after, names, left = shown(evidence, at), [t.effect for t, _ in causes], causes[-1][0].after
            if accounted(criteria, names, before, after, gap, left):
                causes, after, at = _as_added(case, causes, after, at, terms)
                return Found(causes, at, trials, predicted, before, after, hidden=found.hidden)
            refused = refused or Refused(by_closure(causes), after, at)
    return Found([], start, trials, predicted, before, before, refused, found.hidden)


def _grain(case: Case, at: Point, scale: float, least: float) -> Trial:
    """Film grain, where the files' own doing is known and pixels are compared."""
    pixels, stored = case.pixels, case.stored
    assert pixels is not None and stored is not None
    seen = Residual(pixels.target, at.shown[0], pixels.weight[..., 0] ** 2, pixels.counts, case.split)
    return grain_trial(seen, stored, at.z, scale, least)


def _grain_closes(case: Case, scale: float, least: float) -> float:
    """The share of the gap that film grain accounts for at the base: no effect can lead with that."""
    if case.stored is None:
        return 0.0
    grain = _grain(case, case.point, scale, least)
    return min(max(grain.closed, 0.0), 1.0) if grain.accepted(case.criteria) else 0.0


def _as_added(
    case: Case, causes: Sequence[Cause], after: Shown, at: Point, terms: Terms
) -> tuple[list[Cause], Shown, Point]:
    """The causes by decreasing closure, each measured where those before it are in, what shows with them, and
    where they lead.

    What was found in another order is fitted again in this one, from where it ended. Should it close in yet
    another order then, or leave more by a harmless share of the gap, it stays as it was, as `by_closure`
    has it; so does film grain beside a RAW, which is not fitted.
    """
    alike = {trial.effect: names for trial, names in causes}
    order = [t.effect for t in sorted((t for t, _ in causes), key=lambda t: -t.closed)]
    if order == list(alike) or (case.stored is not None and "film_grain" in alike):
        return by_closure(causes), after, at
    whole, criteria = terms.whole, case.criteria
    trials, end = replayed(case.evidence, case.point, order, at.z, whole, 0.0, criteria)
    as_good = trials[-1].after - causes[-1][0].after < terms.least * whole.size
    as_told = all(a.closed >= b.closed for a, b in itertools.pairwise(trials))
    if as_good and as_told and all(t.low > criteria.smallest for t in trials):
        return [(t, alike[t.effect]) for t in trials], shown(case.evidence, end), end
    return by_closure(causes), after, at


def by_closure(causes: Sequence[Cause]) -> list[Cause]:
    """The causes in the order of decreasing closure, with the same drops and the same end: what was added
    later may close more."""
    found: list[Cause] = []
    after = causes[-1][0].after if causes else 0.0
    for trial, alike in sorted(causes, key=lambda cause: cause[0].closed):
        before = after + trial.gain
        found.insert(0, (dataclasses.replace(trial, before=before, after=after), alike))
        after = before
    return found
