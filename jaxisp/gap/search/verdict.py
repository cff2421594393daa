"""The gap at the base and its causes: effects that lower it by more than where nothing is missing."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.case import LEAST_UNIT, MOST_CAUSES, NULL_DROP, NULL_EXCESS, Case, Gap, Tick
from jaxisp.gap.objective.protocol import Measured
from jaxisp.gap.search.account import Shown, accounted, shown
from jaxisp.gap.search.film_grain import Cause, grain_trial, with_grain
from jaxisp.gap.search.refit import SMALLEST, Trial, Whole
from jaxisp.gap.search.screening import LEADING
from jaxisp.gap.search.stepwise import Terms, replayed, search
from jaxisp.gap.simulator.effects import RAW_JPEG
from jaxisp.gap.simulator.model import Model

APART = {RAW_JPEG: np.inf, "clean+noisy": 0.35}
"""By how much, as a share of the floor, what two effects leave must differ for them to be told apart: in
statistics by what is harmless, in pixels by a share of the gap only."""
LEAST_CLOSED = {RAW_JPEG: 0.0, "clean+noisy": 0.15}
"""What the lower end of an effect's interval must be above: many effects lower some statistics a little."""


class Refused(NamedTuple):
    """What comes nearest but does not account for the gap: causes, what shows with them, and the model and
    the point that they take the problem to."""

    causes: list[Cause]
    after: Shown
    model: Model
    z: np.ndarray


class Found(NamedTuple):
    """What a search has found.

    Attributes:
        causes: the accepted effects, each with those like it.
        trials: all that were refitted at first.
        promises: what screening predicted, by effect.
        before, after: what shows of the gap without and with the causes.
        refused: where there is no cause, what comes nearest.
        hidden: effects that these pairs cannot show.
    """

    causes: list[Cause]
    trials: dict[str, Trial]
    promises: dict[str, float]
    before: Shown
    after: Shown
    refused: Refused | None = None
    hidden: Sequence[str] = ()

    @property
    def nearest(self) -> list[Trial]:
        """The effects that come nearest where none is accepted."""
        return [] if self.refused is None else [trial for trial, _ in self.refused.causes]


def gap_at(case: Case) -> Gap:
    held = list(case.split.held_out)
    before = float(np.nanmean(case.problem.units(case.problem.z)[held]))
    return Gap(before, float(min(case.floors[held].mean(), before)), LEAST_UNIT[case.kind])


def whole_of(case: Case, size: float) -> Whole:
    """The gap above the floor, unit by unit of the held-out pairs."""
    problem, held = case.problem, list(case.split.held_out)
    above = problem.units(problem.z)[held] - case.floors[held][:, None]
    return Whole(size, problem.clustered(above, held))


def searched(case: Case, gap: Gap, tick: Tick) -> Found:
    """Moves the problem to where its causes take it: as many of those found as account for the gap."""
    problem, scale, kind, held = case.problem, gap.scale, case.kind, case.split.held_out
    start, before = (problem.model, problem.z.copy()), shown(problem, held)
    could = gap.exceeds(NULL_DROP[kind])  # smoothing alone can come nearer than the floor
    alone = max(NULL_DROP[kind] * gap.unit / scale, SMALLEST)
    most, enough = MOST_CAUSES if could else 0, alone if LEAST_CLOSED[kind] else -np.inf
    leading = LEADING * (1 - _grain_closes(case, scale, alone))
    part, apart = LEAST_CLOSED[kind], APART[kind] * gap.unit / scale
    plainly, again = NULL_DROP[kind] * gap.unit / scale, kind != RAW_JPEG  # whose columns are taken along
    visible = NULL_EXCESS[kind] * gap.unit
    # on the file's own grid one more compression imitates a little of whatever compresses otherwise
    model, references = problem.model, set(problem.references)
    bars = {name: visible / scale for name in model.effects if references & set(model.indices([name]))}
    terms = Terms(alone, most, leading, part, enough, apart, case.seen, plainly, again, visible, bars)
    whole = whole_of(case, scale)
    found = search(problem, case.offered, case.split, whole, terms, tick)
    steps, trials, promises = found.causes, found.trials, found.promises
    refused: Refused | None = None
    for count in range(len(steps), -1, -1):
        _stand_at(problem, start, steps[:count])
        causes = steps[:count]
        if case.stored is not None:
            grain = grain_trial(problem, case.stored, case.split, scale, alone)
            causes = with_grain(causes, grain, gap.floor)
            if count == len(steps):
                trials, promises = trials | {"film_grain": grain}, promises | {"film_grain": grain.gain}
        if could and causes and max(t.closed for t, _ in causes) >= LEADING:
            after, names, left = shown(problem, held), [t.effect for t, _ in causes], causes[-1][0].after
            if accounted(kind, names, before, after, gap, left):
                causes, after = _as_added(case, start, causes, after, whole, alone)
                return Found(causes, trials, promises, before, after, hidden=found.hidden)
            refused = refused or Refused(by_closure(causes), after, problem.model, problem.z.copy())
    return Found([], trials, promises, before, before, refused, found.hidden)


def _grain_closes(case: Case, scale: float, least: float) -> float:
    """The share of the gap that film grain accounts for at the base: no effect can lead with that."""
    if case.stored is None:
        return 0.0
    grain = grain_trial(case.problem, case.stored, case.split, scale, least)
    return min(max(grain.closed, 0.0), 1.0) if grain.accepted else 0.0


def _stand_at(problem: Measured, start: tuple[Model, np.ndarray], steps: Sequence[Cause]) -> None:
    """Put the problem where these steps have taken it from its start."""
    problem.model, z = start
    for trial, _ in steps:
        problem.model = problem.model if trial.choice is None else problem.model.chosen(trial.choice)
        z = trial.z
    problem.move_to(z)


def _as_added(
    case: Case,
    start: tuple[Model, np.ndarray],
    causes: Sequence[Cause],
    after: Shown,
    whole: Whole,
    harmless: float,
) -> tuple[list[Cause], Shown]:
    """The causes by decreasing closure, each measured where those before it are in, and what shows with them.

    What was found in another order is fitted again in this one, from where it ended. Should it close in yet
    another order then, or leave more by a `harmless` share of the gap, it stays as it was, as `by_closure`
    has it; so does film grain beside a RAW, which is not fitted.
    """
    alike = {trial.effect: names for trial, names in causes}
    order = [t.effect for t in sorted((t for t, _ in causes), key=lambda t: -t.closed)]
    if order == list(alike) or (case.stored is not None and "film_grain" in alike):
        return by_closure(causes), after
    problem, end = case.problem, (case.problem.model, case.problem.z.copy())
    trials = replayed(problem, start, order, end[1], case.split, whole, 0.0)
    as_good = trials[-1].after - causes[-1][0].after < harmless * whole.size
    as_told = all(a.closed >= b.closed for a, b in itertools.pairwise(trials))
    if as_good and as_told and all(t.low > SMALLEST for t in trials):
        return [(t, alike[t.effect]) for t in trials], shown(problem, case.split.held_out)
    _stand_at(problem, end, [])
    return by_closure(causes), after


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
