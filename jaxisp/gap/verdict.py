"""The gap at the base and its causes: effects that lower it by more than where nothing is missing."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxisp.gap.effects import RAW_JPEG
from jaxisp.gap.grain import Cause, grain_trial, with_grain
from jaxisp.gap.measured import Case
from jaxisp.gap.refit import Whole
from jaxisp.gap.which import Tick, search

MOST_CAUSES = 3
NULL_EXCESS = {RAW_JPEG: 0.5, "clean+noisy": 1.0}
"""How far above the floor, as a share of it, the gap of a camera that lacks nothing may be: its demosaicker
and its order of steps are not quite the base's. As 47 and 24 nulls have it, see docs/diagnosis.md."""
NULL_DROP = {RAW_JPEG: 0.1, "clean+noisy": 0.7}
"""By how much, as a share of the floor, an effect may lower that camera's gap all the same."""
APART = {RAW_JPEG: np.inf, "clean+noisy": 0.35}
"""By how much, as a share of the floor, what two effects leave must differ for them to be told apart: in
statistics by what is harmless, in pixels by a share of the gap only."""
LEAST_CLOSED = {RAW_JPEG: 0.0, "clean+noisy": 0.15}
"""What the lower end of an effect's interval must be above: many effects lower some statistics a little."""

ACCOUNTED = 0.5
"""What all causes together must close where more is left than where nothing is missing: something else makes
most of such a gap, and what closes the smaller part may be but its likeness."""


class Gap(NamedTuple):
    """On the held-out pairs, at the base."""

    before: float
    floor: float

    @property
    def scale(self) -> float:
        """What counts as the whole of it."""
        return max(self.before - self.floor, 0.02 * self.floor, 1e-6)

    def exceeds(self, share: float) -> bool:
        """Whether it is above the floor by this share of it."""
        return self.before >= self.floor * (1 + share)


class Found(NamedTuple):
    """The accepted effects, each with those like it; all that were tried; what their screening promised."""

    causes: list[Any]
    trials: dict[str, Any]
    promises: dict[str, float]


def gap_at(case: Case) -> Gap:
    held = list(case.split.held_out)
    before = float(np.nanmean(case.problem.units(case.problem.z)[held]))
    return Gap(before, float(min(case.floors[held].mean(), before)))


def whole_of(case: Case, size: float) -> Whole:
    """The gap above the floor, unit by unit of the held-out pairs."""
    problem, held = case.problem, list(case.split.held_out)
    above = problem.units(problem.z)[held] - case.floors[held][:, None]
    return Whole(size, problem.clustered(above, held))


def searched(case: Case, gap: Gap, tick: Tick) -> Found:
    """Moves the problem to where its causes take it."""
    problem, scale, kind = case.problem, gap.scale, case.kind
    start, model = problem.z.copy(), problem.model
    could = gap.exceeds(NULL_DROP[kind])  # smoothing alone can come nearer than the floor
    least = max(NULL_DROP[kind] * gap.floor / scale, LEAST_CLOSED[kind])
    most, enough = MOST_CAUSES if could else 0, LEAST_CLOSED[kind] or -np.inf
    apart = APART[kind] * gap.floor / scale
    causes, trials, promises = search(
        problem, case.offered, case.split, whole_of(case, scale), least, most, tick, enough, apart, case.seen
    )
    if case.stored is not None:
        grain = grain_trial(problem, case.stored, case.split, scale, least)
        causes, trials = with_grain(causes, grain, gap.floor), trials | {"film_grain": grain}
        promises["film_grain"] = grain.before - grain.after
    if not could or not accounted(causes, gap, NULL_EXCESS[kind]):
        causes, problem.model = [], model
        problem.move_to(start)
    return Found(by_closure(causes), trials, promises)


def accounted(causes: Sequence[Cause], gap: Gap, excess: float) -> bool:
    """Whether the causes close enough, or leave a gap that is within `excess` of the floor."""
    left = causes[-1][0].after if causes else gap.before
    return left < gap.floor * (1 + excess) or gap.before - left >= ACCOUNTED * gap.scale


def by_closure(causes: Sequence[Cause]) -> list[Cause]:
    """The causes in the order of decreasing closure, with the same drops and the same end: what was added
    later may close more."""
    found: list[Cause] = []
    after = causes[-1][0].after if causes else 0.0
    for trial, alike in sorted(causes, key=lambda cause: cause[0].closed):
        before = after + trial.before - trial.after
        found.insert(0, (dataclasses.replace(trial, before=before, after=after), alike))
        after = before
    return found
