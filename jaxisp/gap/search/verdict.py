"""The verdict: causes of the gap, which lower it by more than effects do for cameras that lack none."""

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
    """The best causes that do not account for the gap.

    Attributes:
        causes: trials with their look-alikes.
        after: the gap by axis with them.
        point: the point with them.
    """

    causes: list[Cause]
    after: Shown
    point: Point


class Found(NamedTuple):
    """Result of the search.

    Attributes:
        causes: the accepted effects, each with its look-alikes.
        point: the point with the causes.
        trials: all trials of the first step, by effect.
        predicted: the drop that screening predicted, by effect.
        before: the gap by axis without the causes.
        after: the gap by axis with the causes.
        refused: the best refused causes, if there is no cause.
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
        """Trials of the best refused causes; empty if causes were accepted."""
        return [] if self.refused is None else [trial for trial, _ in self.refused.causes]


def whole_of(case: Case, size: float) -> Whole:
    """The gap above the floor, with its parts by scene and unit of the held-out pairs."""
    held = list(case.split.held_out)
    above = case.evidence.units(case.point)[held] - case.floors[held][:, None]
    return Whole(size, clustered(case.evidence, above))


def terms_of(case: Case, gap: Gap) -> Terms:
    """Terms of the search: the criteria converted to shares of this gap."""
    criteria, scale, model = case.criteria, gap.scale, case.point.model
    harmless = criteria.null_drop * gap.unit / scale
    alone = max(harmless, criteria.smallest)
    visible = criteria.null_excess * gap.unit
    # a second compression on the file's own grid partly imitates any other compression
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
    """Search for causes, and keep the longest leading part of them that accounts for the gap."""
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
        # without a gap there are no causes, although smoothing alone can come below the floor
        if terms.most and causes and max(t.closed for t, _ in causes) >= criteria.leading:
            after, names, left = shown(evidence, at), [t.effect for t, _ in causes], causes[-1][0].after
            if accounted(criteria, names, before, after, gap, left):
                causes, after, at = _as_added(case, causes, after, at, terms)
                return Found(causes, at, trials, predicted, before, after, hidden=found.hidden)
            refused = refused or Refused(by_closure(causes), after, at)
    return Found([], start, trials, predicted, before, before, refused, found.hidden)


def _grain(case: Case, at: Point, scale: float, least: float) -> Trial:
    """The trial of film grain; it needs RAW+JPEG pairs with known errors of the file's compression."""
    pixels, stored = case.pixels, case.stored
    assert pixels is not None and stored is not None
    seen = Residual(pixels.target, at.shown[0], pixels.weight[..., 0] ** 2, pixels.counts, case.split)
    return grain_trial(seen, stored, at.z, scale, least)


def _grain_closes(case: Case, scale: float, least: float) -> float:
    """The share in [0, 1] of the gap that film grain accounts for at the base; no effect can close it."""
    if case.stored is None:
        return 0.0
    grain = _grain(case, case.point, scale, least)
    return min(max(grain.closed, 0.0), 1.0) if grain.accepted(case.criteria) else 0.0


def _as_added(
    case: Case, causes: Sequence[Cause], after: Shown, at: Point, terms: Terms
) -> tuple[list[Cause], Shown, Point]:
    """Order the causes by decreasing closure, and measure each on top of those before it.

    Causes found in another order are refitted in this order, from their end. The refit is discarded in favour
    of `by_closure` if its closures do not decrease, or if it leaves a larger gap. Film grain of RAW+JPEG
    pairs is not fitted, so causes with it are never refitted.

    Returns:
        the causes; the gap by axis with them; the point with them.
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
    """Sort the causes by decreasing closure; each keeps its drop, and all keep their common end."""
    found: list[Cause] = []
    after = causes[-1][0].after if causes else 0.0
    for trial, alike in sorted(causes, key=lambda cause: cause[0].closed):
        before = after + trial.gain
        found.insert(0, (dataclasses.replace(trial, before=before, after=after), alike))
        after = before
    return found
