"""Screening of all effects by secants, and selection of the best refitted effect."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.gauss_newton import modest, solve
from jaxisp.gap.objective.protocol import Evidence, NormalEquations, Objective, Point
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.search.refit import distant, lowest, searched, switched_on
from jaxisp.gap.search.trial import Trial
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import Model
from jaxisp.process.memory import give_back

_ALONG = (1.0, 0.5, 0.25)
"""Shares of a step that are tried."""
_AT_ONCE = 24
"""Coordinates of effects whose columns are held at a time, but for one effect that has more."""


def screen(evidence: Evidence, point: Point, names: Sequence[str]) -> tuple[dict[str, float], Point]:
    """Predict linearly how far each effect lowers the held-out error, beyond a step of the base alone.

    The step is fitted to the fitted pairs, and every held-out pair counts the same: so does the refit that
    follows. The other way round, one fitted pair that lies far off would lead, though it is judged nowhere.

    Returns:
        the predicted drop by effect; the point with the columns computed for it.
    """
    model, split, base = point.model, evidence.split, _base(point)
    steps = {i: lowest(evidence, point, i) for i in searched(model, names)}
    point = _with_normals(evidence, point, names, steps | distant(evidence, point, names))
    held = list(split.held_out)

    def drop(which: Sequence[int]) -> float:
        own = _normal(evidence, point, which)
        move = _step(point, which, own, split.fit)
        a, b = own.gram[held].mean(0), own.slope[held].mean(0)
        return float(2 * move @ b - move @ a @ move)

    own = drop(base) if base else 0.0
    return {
        name: drop(_with_base(point, name)) - own - _anyway(evidence, point, name) for name in names
    }, point


def _base(point: Point) -> list[int]:
    """The coordinates of the base and of what is switched on."""
    return [*point.model.base_indices, *switched_on(point)]


def _with_base(point: Point, name: str) -> list[int]:
    return [*_base(point), *point.model.indices([name])]


def _with_normals(
    evidence: Objective, point: Point, names: Sequence[str], steps: Mapping[int, float]
) -> Point:
    """The point with the normal equations of each effect beside the base.

    The columns of a few effects at a time are computed. The point keeps those of the base, and those of
    effects where they are small.
    """
    model = point.model
    point = evidence.compute(point, _base(point), steps)
    normals = dict(point.normals)
    for some in _batches(model, names):
        there = evidence.compute(point, model.indices(some), steps)
        every = [*_base(point), *model.indices(some)]
        whole = evidence.normal(there, every)
        for name in some:
            which = _with_base(point, name)
            own = [every.index(i) for i in which]
            gram = whole.gram[:, own][:, :, own]
            normals[tuple(which)] = NormalEquations(gram, whole.slope[:, own])
        point = there if evidence.compact else point
        del there
        give_back()
    return dataclasses.replace(point, normals=normals)


def _batches(model: Model, names: Sequence[str]) -> Iterator[list[str]]:
    """The effects in order, as many at a time as have `_AT_ONCE` coordinates, or one."""
    batch: list[str] = []
    for name in names:
        if batch and len(model.indices([*batch, name])) > _AT_ONCE:
            yield batch
            batch = []
        batch.append(name)
    if batch:
        yield batch


def _normal(evidence: Objective, point: Point, which: Sequence[int]) -> NormalEquations:
    """The normal equations that the point has, or those of its columns."""
    known = point.normals.get(tuple(which))
    return evidence.normal(point, which) if known is None else known


def halves(evidence: Evidence, point: Point, names: Sequence[str]) -> dict[str, float]:
    """By effect, how far its numbers agree between the fitted and the held-out pairs, in [-1, 1].

    Each half takes a step of its own, beside the base. The value is the correlation of the changes that
    the effect's part of the two steps makes. The point needs the columns of `screen`.
    """
    split = evidence.split
    base = len(_base(point))
    found = {}
    for name in names:
        which = _with_base(point, name)
        normal = _normal(evidence, point, which)
        one, other = (_step(point, which, normal, half)[base:] for half in (split.fit, split.held_out))
        gram = normal.gram.mean(0)[base:, base:]
        size = float(np.sqrt((one @ gram @ one) * (other @ gram @ other)))
        found[name] = float(one @ gram @ other) / size if size > 0 else 0.0
    return found


def hidden(objective: Objective, point: Point, names: Sequence[str], least: float) -> list[str]:
    """Effects that these pairs cannot show; grey scenes, for example, cannot show saturation.

    Half the range of such an effect changes the pairs by less than `least`, a mean square. Changes that the
    base can imitate do not count.

    The point needs the columns of `screen`. Effects that are searched on a grid are never listed.
    """
    model = point.model
    names = [name for name in names if not searched(model, [name])]
    beyond = _beyond_base(objective, point, names)

    def change(name: str) -> float:
        own = model.indices([name])
        reach = np.abs(model.ranges[:, own] - point.z[own]).max(0) / 2
        return float(sum(r**2 * beyond[i] for r, i in zip(reach, own)))

    return [name for name in names if change(name) < least]


def smallest(
    objective: Objective, point: Point, names: Sequence[str], least: float
) -> dict[str, tuple[int, float]]:
    """By effect, its most visible coordinate, and the change of it that changes the pairs by `least`.

    Conditions are those of `hidden`. Effects that would need more than their range are left out.
    """
    model = point.model
    names = [name for name in names if not searched(model, [name])]
    beyond = _beyond_base(objective, point, names)
    found = {}
    for name in names:
        own = model.indices([name])
        reach = np.abs(model.ranges[:, own] - point.z[own]).max(0)
        needed = np.array([np.sqrt(least / max(beyond[i], 1e-12)) for i in own])
        k = int(np.argmin(needed / reach))
        if needed[k] < reach[k]:
            found[name] = own[k], float(needed[k])
    return found


def _beyond_base(objective: Objective, point: Point, names: Sequence[str]) -> dict[int, float]:
    """By coordinate of these effects, the mean square change of the pairs per unit that the base cannot
    imitate."""
    count = len(_base(point))
    found: dict[int, float] = {}
    for name in names:
        which = _with_base(point, name)
        gram = _normal(objective, point, which).gram.mean(0)
        onto = np.linalg.pinv(gram[:count, :count], rcond=1e-9, hermitian=True)
        across = gram[count:, :count]
        beyond = np.diag(gram)[count:] - np.einsum("kb,bc,kc->k", across, onto, across)
        found |= dict(zip(which[count:], beyond))
    return found


def _step(point: Point, which: Sequence[int], normal: NormalEquations, learn: Sequence[int]) -> np.ndarray:
    """The Gauss-Newton step (K,) of these coordinates, fitted to the pairs `learn`."""
    which, learn = list(which), list(learn)
    believed = modest(point, which, float(point.errors[learn].mean()))
    return solve(
        normal.gram[learn].mean(0) + believed[0],
        normal.slope[learn].mean(0) + believed[1],
        point.z[which], point.model.ranges[:, which],
    )  # fmt: skip


def _anyway(evidence: Evidence, point: Point, name: str) -> float:
    """The drop of the held-out error if an effect only repeats the file's own compression."""
    z = point.z.copy()
    for i in set(point.model.indices([name])) & set(evidence.references):
        z[i] = evidence.references[i]
    if (z == point.z).all():
        return 0.0
    return drop_at(evidence, point, z)


def drop_at(evidence: Evidence, point: Point, z: np.ndarray) -> float:
    """How much lower the held-out error is at z."""
    return float((point.errors - evidence.at(point.model, z).errors)[list(evidence.split.held_out)].mean())


def predicted(evidence: Evidence, point: Point, effect: str) -> float:
    """The drop of the held-out error after one step of an effect and the base.

    The step and its length are chosen on the fitted pairs, and the model is evaluated at its end. Statistics
    depend on most effects nonlinearly, so that a linear prediction is too small for them.
    """
    model, split = point.model, evidence.split
    which = _with_base(point, effect)
    move = _step(point, which, _normal(evidence, point, which), split.fit)

    def along(share: float) -> np.ndarray:
        z = point.z.copy()
        z[which] = np.clip(z[which] + share * move, *model.ranges[:, which])
        return evidence.at(model, z).errors

    found = min((point.errors, *parallel_map(along, _ALONG)), key=lambda e: e[list(split.fit)].mean())
    return float((point.errors - found)[list(split.held_out)].mean()) - _anyway(evidence, point, effect)


def best(
    trials: Sequence[Trial], criteria: Criteria, seen: Sequence[str] = (), remaining: float = 1.0
) -> Trial | None:
    """Select the best accepted trial; None if no trial is accepted.

    The trial that closes most is the first choice. Trials that close about as much, or are much closer in
    pixels, are rivals. A rival that is clearly closer in pixels wins. A simpler effect, or one that the
    winner contains, is preferred to it if it closes nearly as much.

    Args:
        trials: of one step.
        criteria: thresholds of the trials.
        seen: effects that the files themselves show. They come first if they could lead, since other effects
            may imitate them.
        remaining: share of the gap that earlier causes leave.
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
    """Whether an effect rivals the one that closes most.

    It does if it closes about as much. It also does if it could lead the remaining gap and is closer in
    pixels by more than `Criteria.farthest`.
    """
    nearer = closer_in_pixels(other, most, criteria) and other.farther < most.farther - criteria.farthest
    leads = other.closed >= criteria.leading * remaining and nearer
    return other.closed > criteria.as_much * most.closed or leads


def _nearest(trials: Sequence[Trial], criteria: Criteria) -> Trial:
    """The first trial, or the one closest in pixels if it is clearly closer."""
    near = min(trials, key=lambda t: t.farther)
    return near if closer_in_pixels(near, trials[0], criteria) else trials[0]


def closer_in_pixels(one: Trial, other: Trial, criteria: Criteria) -> bool:
    """Whether `one` brings the pictures clearly closer than `other`; False if either effect is random."""
    random = any(EFFECTS[t.effect].random for t in (one, other))
    return not random and one.farther < other.farther - criteria.nearer


def lookalikes(
    winner: Trial, trials: Sequence[Trial], criteria: Criteria, apart: float = np.inf
) -> list[str]:
    """Effects whose closure these pairs cannot distinguish from the winner's.

    Args:
        winner: the best of the trials.
        trials: of one step.
        criteria: thresholds of the trials.
        apart: difference of shares from which two effects count as distinct. It is raised to half the width
            of the winner's interval. It is also raised for known alternatives, unless the other effect leaves
            `Criteria.left_alike` times as much.
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
    """The share of the gap that an effect may close by correcting the form of a cause that it resembles."""
    own = [(1 - criteria.as_much) * t.closed for t in causes if _alike(t.effect, effect)]
    return max(own, default=0.0)


def like_the_nearest(trials: Sequence[Trial], others: Sequence[str], criteria: Criteria) -> list[str]:
    """Those of the other effects that are alternatives of the trial that closes most, if it could lead.

    Screening sees only a small step of an effect, which does not predict the full effect.
    """
    nearest = max(trials, key=lambda t: t.closed)
    alike = EFFECTS[nearest.effect].alternatives if nearest.closed >= criteria.leading else ()
    return [name for name in others if name in alike]


def _alike(one: str, other: str) -> bool:
    return other in EFFECTS[one].alternatives or one in EFFECTS[other].alternatives
