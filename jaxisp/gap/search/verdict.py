"""The verdict: which of the effects that the search found are there, and how sure that is.

Detection is apart from explanation. An effect is named where its signs make it probable, however small a
part of the gap it closes. What the named effects leave stays unexplained.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import Case, Gap, Tick
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.search import score
from jaxisp.gap.search.film_grain import Residual, grain_trial, with_grain
from jaxisp.gap.search.refit import clustered
from jaxisp.gap.search.signs import Signs, left_signs, signs
from jaxisp.gap.search.states import Shown, shown, sized
from jaxisp.gap.search.stepwise import Searched, Terms, ended, replayed, search
from jaxisp.gap.search.trial import Cause, Trial, Whole

_LOCATED = 4
"""Trials of the first step whose axes are measured: those that close most."""


class Refused(NamedTuple):
    """Effects that the search accepted and that are not probable enough to be named.

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
        causes: the named effects, each with its look-alikes.
        point: the point with the causes.
        trials: all trials of the first step, by effect.
        predicted: the drop that screening predicted, by effect.
        before: the gap by axis without the causes.
        after: the gap by axis with the causes.
        refused: what the search accepted, if there is no cause.
        hidden: effects that these pairs cannot show.
        accepted: effects that the search accepted, named or not.
        signs: signs of the refitted effects.
        probabilities: of the refitted effects, "other" and "none".
        smallest: result of `screening.smallest`.
        gap: at the base, above the floor that the point with the causes has; closures are shares of it. None
            without causes.
    """

    causes: list[Cause]
    point: Point
    trials: dict[str, Trial]
    predicted: dict[str, float]
    before: Shown
    after: Shown
    refused: Refused | None = None
    hidden: Sequence[str] = ()
    accepted: Sequence[str] = ()
    signs: Mapping[str, Mapping[str, float]] = {}
    probabilities: Mapping[str, float] = {}
    smallest: Mapping[str, tuple[int, float]] = {}
    gap: Gap | None = None

    @property
    def nearest(self) -> list[Trial]:
        """Trials that the search accepted and that are not named; empty if causes were named."""
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
        leading=min(criteria.begins, visible / scale),
        enough=alone if criteria.least_of_rest else -np.inf,
        apart=criteria.apart * gap.unit / scale,
        seen=case.seen,
        plainly=harmless,
        visible=visible,
        bars=dict.fromkeys(barred, visible / scale),
    )


def searched(case: Case, gap: Gap, tick: Tick) -> Found:
    """Search for effects, and name those that are probable."""
    evidence, criteria, start = case.evidence, case.criteria, case.point
    before, terms = shown(evidence, start), terms_of(case, gap)
    found = search(evidence, start, case.offered, terms, tick)
    seen = effect_signs(case, gap, found, before)
    probable = {name: score.probability(score.EFFECT, own._asdict()) for name, own in seen.items()}
    noted: dict[str, Mapping[str, float]] = {name: own._asdict() for name, own in seen.items()}
    causes, at = named(case, found, probable, terms)
    trials, predicted = found.trials, found.predicted
    end = ended(evidence, start, *(t for t, _ in found.causes))
    if case.stored is not None:
        grain = _grain(case, at, end, gap.scale, terms.least)
        noted[grain.effect] = own = grain_signs(gap, grain)
        probable[grain.effect] = score.probability(score.GRAIN, own)
        if terms.most and probable[grain.effect] >= criteria.named:
            causes = with_grain(causes, grain, gap.floor, criteria)
        trials, predicted = trials | {"film_grain": grain}, predicted | {"film_grain": grain.gain}
    after = shown(evidence, at) if causes else before
    refused = None
    if not causes and found.causes:
        refused = Refused(by_closure(found.causes), shown(evidence, end), end)
    above: Gap | None = None
    if causes:
        causes, after, at = _as_added(case, causes, after, at, terms)
        above = case.gap_above(gap, at)
        causes = [(t.share_of(gap.scale / above.scale), alike) for t, alike in causes]
        trials = {name: t.share_of(gap.scale / above.scale) for name, t in trials.items()}
    reached = causes[-1][0].after if causes else gap.before
    most = max(probable.values(), default=0.0)
    left = left_signs(above or gap, reached, most, criteria.null_drop)
    probable |= {q: score.probability(q, left) for q in (score.OTHER, score.NONE)}
    accepted = [t.effect for t, _ in found.causes] + [n for n in trials if n not in found.trials]
    return Found(
        causes, at, trials, predicted, before, after, refused, found.hidden, accepted, noted, probable,
        found.smallest, above,
    )  # fmt: skip


def effect_signs(case: Case, gap: Gap, found: Searched, before: Shown) -> dict[str, Signs]:
    """The signs of all refitted effects: of a cause in the step that found it, of others in the first."""
    evidence, model, start = case.evidence, case.point.model, case.point
    own: dict[str, Signs] = {}
    left = 1.0 - sum(t.closed for t, _ in found.causes)

    def of(trial: Trial, step: Sequence[Trial], agreed: float, was: Shown, now: Shown) -> Signs:
        numbers = trial.z[model.indices([trial.effect])] if trial.effect in model.effects else np.zeros(0)
        return signs(case.kind, gap, trial, step, numbers, agreed, (was, now), left)

    first = sorted(found.steps[0] if found.steps else [], key=lambda t: -t.closed)
    located = first[:_LOCATED]
    sizes = parallel_map(lambda t: sized(evidence, ended(evidence, start, t)), located)
    states = dict(zip((t.effect for t in located), sizes))
    for trial in first:
        now = states.get(trial.effect, before)
        own[trial.effect] = of(trial, first, found.halves.get(trial.effect, 0.0), before, now)
    at, was = start, before
    for k, (trial, _) in enumerate(found.causes):
        at = ended(evidence, at, trial)
        now = states[trial.effect] if k == 0 and trial.effect in states else sized(evidence, at)
        if k:
            own[trial.effect] = of(trial, found.steps[k], found.halves.get(trial.effect, 0.0), was, now)
        was = now
    return own


def named(
    case: Case, found: Searched, probable: Mapping[str, float], terms: Terms
) -> tuple[list[Cause], Point]:
    """The causes that are probable, and the point with them; refitted where one before another is dropped."""
    kept = [cause for cause in found.causes if probable[cause[0].effect] >= case.criteria.named]
    if not kept:
        return [], case.point
    end = ended(case.evidence, case.point, *(t for t, _ in found.causes))
    if len(kept) == len(found.causes):
        return kept, end
    if kept == found.causes[: len(kept)]:
        return kept, ended(case.evidence, case.point, *(t for t, _ in kept))
    names = [t.effect for t, _ in kept]
    trials, at = replayed(case.evidence, case.point, names, end.z, terms.whole, 0.0, case.criteria)
    return [(trial, alike) for trial, (_, alike) in zip(trials, kept)], at


def grain_signs(gap: Gap, grain: Trial) -> dict[str, float]:
    """The signs of film grain beside a RAW, which moves no parameter and lowers no error."""
    return {
        "size": float(np.log2(1 + max(grain.low * gap.scale / gap.unit, 0.0))),
        "closed": float(np.clip(grain.closed, 0, 1.2)),
    }


def _grain(case: Case, at: Point, end: Point, scale: float, least: float) -> Trial:
    """The trial of film grain beside the causes. It is measured beside all effects that the search accepted,
    and needs RAW+JPEG pairs with known errors of the file's compression."""
    pixels, stored = case.pixels, case.stored
    assert pixels is not None and stored is not None
    seen = Residual(pixels.target, at.shown[0], pixels.weight[..., 0] ** 2, pixels.counts, case.split)
    return grain_trial(seen, stored, at.z, scale, least, end.shown[0])


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
