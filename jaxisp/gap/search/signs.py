"""Signs of an effect: what its refit shows beside the share that it closes.

An effect that is there and one that imitates an out-of-library effect may close the same share of a gap.
They differ in other ways: how far the picture changes only where the gap falls, whether other scenes and the
other half of the pairs agree, what stays on axes of place, and how far other effects are behind. The score
(`score`) computes the probability of an effect from these numbers.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import Gap
from jaxisp.gap.search.states import Shown
from jaxisp.gap.search.trial import Trial
from jaxisp.gap.simulator.effects import CLEAN_NOISY, EFFECTS

_PLACE = frozenset({"row", "column", "radius", "orientation", "fixed_pattern", "neighbourhood"})
"""Axes of place and direction: a base without the right demosaicker, matrix or curve leaves little there."""
_FAMILIES = frozenset({"luma_denoising", "chroma_denoising", "resampling", "sharpening"})
"""Effects whose numbers are shares of filters: a negative one does the opposite of what the name says."""
_TINY = 1e-9
_LITTLE = 0.01  # units
_UNTOLD = 0.5  # shares of `null_drop`: weak effects leave gaps as small as harmless mismatches do


class Signs(NamedTuple):
    """Signs of one effect, from its refit in one step of the search.

    Attributes:
        size: log2(1 + the lower end of its drop of the gap, in units).
        gap: log2 of the gap in floors.
        closed: share of what earlier causes leave that it closes, within [0, 1.2].
        sure: lower end of its interval over `closed`, within [-1, 1].
        surely: the same of the interval that draws the gap together with the drop.
        lead: how much more it closes than any effect that it is not easily confused with, over `closed`,
            within [-1, 1].
        lead_alike: the same of the effects that it is easily confused with.
        ahead: the smaller of both: how much more it closes than any other effect.
        form: its drop of the gap over the mean square that it changes, within [-1, 1.5]: 1 if what it
            changes is a part of the gap, less if it changes something else as well.
        even: cosine between both over pairs and tiles.
        learnt: what it closes on the held-out pairs over what it closes on the fitted ones, within [0, 1.5].
        halves: agreement of its numbers between both halves of the pairs, see `screening.halves`.
        nearer: share by which pixels come nearer, within [-0.5, 1]; 0 for RAW+JPEG pairs.
        contrary: share of its numbers that contradict its name.
        own_share: share of the gap on its own axes.
        own_fell: share of the gap on its own axes that goes, within [-1, 1].
        other_fell: share of the gap on other axes that goes, within [-1, 1].
        place_left: what stays on axes of place that are not its own, over its drop, within [0, 2].
        worse: the largest rise of an axis over its drop, within [0, 2].
        left: share of the gap that all effects which the search accepted leave, within [0, 1].
        later: 1 if earlier causes were found.
        random: 1 for an effect that only adds noise.
    """

    size: float
    gap: float
    closed: float
    sure: float
    surely: float
    lead: float
    lead_alike: float
    ahead: float
    form: float
    even: float
    learnt: float
    halves: float
    nearer: float
    contrary: float
    own_share: float
    own_fell: float
    other_fell: float
    place_left: float
    worse: float
    left: float
    later: float
    random: float


def signs(
    kind: str,
    gap: Gap,
    trial: Trial,
    trials: Sequence[Trial],
    numbers: np.ndarray,
    agreed: float,
    states: tuple[Shown, Shown],
    left: float,
) -> Signs:
    """The signs of an effect.

    Args:
        kind: of the pairs.
        gap: at the base.
        trial: the refitted effect.
        trials: all of its step.
        numbers: its coordinates, which are 0 if it is off.
        agreed: result of `screening.halves`.
        states: the gap by axis before the effect and with it.
        left: share of the gap that all effects which the search accepted leave.
    """
    effect, closed = EFFECTS[trial.effect], max(trial.closed, 1e-3)
    drop = max(trial.gain / gap.unit, 1e-3)
    others = {t.effect: t.closed for t in trials if t.effect != trial.effect}
    near = {
        name for name in others if name in effect.alternatives or trial.effect in EFFECTS[name].alternatives
    }
    drops, changes = (np.nan_to_num(a).ravel() for a in (trial.drops, trial.changes))
    size = float(np.sqrt((drops**2).sum() * (changes**2).sum()))
    was, now = (_by_axis(kind, gap, state) for state in states)
    own, rest = set(effect.axes), {*was, *now} - set(effect.axes)
    negative = -np.minimum(numbers, 0).sum() / max(np.abs(numbers).sum(), _TINY)
    lead, lead_alike = (
        _within(1 - max((others[n] for n in names), default=0.0) / closed, -1, 1)
        for names in (set(others) - near, near)
    )
    return Signs(
        size=float(np.log2(1 + max(trial.low * gap.scale / gap.unit, 0.0))),
        gap=float(np.log2(max(gap.before / max(gap.floor, gap.least, _TINY), 0.5))),
        closed=_within(trial.closed / max(trial.bars.rest, 0.05), 0, 1.2),
        sure=_within(trial.low / closed, -1, 1),
        surely=_within(trial.surely / closed, -1, 1),
        lead=lead,
        lead_alike=lead_alike,
        ahead=min(lead, lead_alike),
        form=_within(drops.sum() / max(changes.sum(), _TINY), -1, 1.5),
        even=float(drops @ changes) / size if size > 0 else 0.0,
        learnt=_within(trial.closed / max(trial.learnt, 1e-3), 0, 1.5),
        halves=agreed,
        nearer=_within(-trial.farther, -0.5, 1),
        contrary=float(negative) if trial.effect in _FAMILIES else 0.0,
        own_share=_sum(was, own) / max(_sum(was, was), 1e-6),
        own_fell=_fell(was, now, own),
        other_fell=_fell(was, now, rest),
        place_left=_within(_sum(now, _PLACE - own) / drop, 0, 2),
        worse=_within(max((now[a] - was.get(a, 0.0) for a in now), default=0.0) / drop, 0, 2),
        left=_within(left, 0, 1),
        later=float(trial.bars.rest < 1),
        random=float(effect.random),
    )


def _by_axis(kind: str, gap: Gap, state: Shown) -> dict[str, float]:
    """The gap on each axis, in units; that of statistics counts above the floor."""
    above = max(state.error - (gap.floor if kind == CLEAN_NOISY else 0.0), 0.0) / gap.unit
    return {row["axis"]: above * row["share"] for row in state.rows}


def _sum(sizes: Mapping[str, float], axes: Mapping[str, float] | set[str] | frozenset[str]) -> float:
    return float(sum(sizes.get(axis, 0.0) for axis in axes))


def _fell(was: Mapping[str, float], now: Mapping[str, float], axes: set[str]) -> float:
    """The share of the gap on these axes that went; 0 if there was next to none."""
    before = _sum(was, axes)
    return _within(1 - _sum(now, axes) / before, -1, 1) if before > _LITTLE else 0.0


def _within(value: float, low: float, high: float) -> float:
    return float(np.clip(value, low, high))


def left_signs(gap: Gap, after: float, likeliest: float, null_drop: float) -> dict[str, float]:
    """Signs of what is left: for the questions whether something else is missing, and whether nothing is.

    Args:
        gap: at the base.
        after: the gap with the named effects.
        likeliest: the highest probability of an effect.
        null_drop: [units] by how much an effect may lower the gap of a camera that lacks nothing; half of
            it above the floor is as good as nothing.
    """
    excess = max(gap.before - gap.floor, 0.0) / gap.unit / null_drop
    return {
        "excess": float(np.log2(1 + max(excess, _UNTOLD))),
        "left": float(np.log2(1 + max(after - gap.floor, 0.0) / gap.unit)),
        "share_left": float(np.clip((after - gap.floor) / gap.scale, 0, 1)),
        "likeliest": likeliest,
    }
