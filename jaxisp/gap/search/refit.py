"""Refit of one effect together with the base, and its closure on the held-out pairs."""

from collections.abc import Sequence

import numpy as np

from jaxisp.gap.axes.interval import few_scenes, interval
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Evidence, Objective, Point
from jaxisp.gap.pairs.scenes import by_scene
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.search.trial import Bars, Trial, Whole
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import Model
from jaxisp.gap.simulator.noise import Ladders, informed_by_noise, noisier, placed, starts

_ROUNDING = 1 / 12  # squared 8-bit steps, variance of rounding


def switched_on(point: Point) -> list[int]:
    """Indices of the coordinates of accepted effects, which stay free."""
    first = len(point.model.base)
    return [i for i in range(first, len(point.z)) if point.z[i] != 0]


def refit(
    evidence: Evidence,
    point: Point,
    effect: str,
    whole: Whole,
    bars: Bars,
    criteria: Criteria,
    *,
    steps: int = 4,
    begin: np.ndarray | None = None,
    form: np.ndarray | None = None,
) -> Trial:
    """Fit an effect and the base together on the fitted pairs, and measure the closure on the held-out pairs.

    Args:
        evidence: of all pairs.
        point: without the effect, with the columns for the first step of the fit.
        effect: its name.
        whole: the gap before any effect.
        bars: bars of the trial.
        criteria: thresholds of the trial.
        steps: largest number of steps of the fit.
        begin: start of the fit, with grid coordinates already found; None: they are searched for.
        form: result of `nearest_form`. A free fit from there must lower the error by
            `Criteria.between_forms` to be kept.
    """
    own = point.model.indices([effect])
    moving = [*point.model.base_indices, *switched_on(point), *own]
    part, start = evidence.fitted(point)
    if begin is None:
        at = _fit_with(part, start, moving, own, steps, form)
    else:
        smooth = [i for i in moving if not start.model.coordinates[i].move.grid]
        at = fit(part, part.at(start.model, begin), smooth, steps=steps).point
    if form is not None:
        exact = part.at(at.model, form)
        at = exact if at.error > criteria.between_forms * exact.error else at
    choice = _choose_again(part, at, criteria)
    if choice is not None:
        chosen = part.at(at.model.chosen(part.choices[choice]), at.z)
        smooth = [i for i in moving if i not in searched(at.model, [effect])]
        at = fit(part, chosen, smooth, steps=2).point
    held, there = evidence.held_out(point)
    # pixels cannot judge a pattern at a random place
    told = effect not in EFFECTS or not EFFECTS[effect].random
    before, far = held.units(there), distance(held, there.model, there.z) if told else 0.0
    harmless = before
    if set(own) & set(evidence.references):
        harmless = held.units(held.at(there.model, _harmless(evidence, point, own, moving)))
    if choice is not None:
        there = held.at(there.model.chosen(held.choices[choice]), there.z)
        alone = held.units(there)  # the gain of the choice without the effect does not count
        harmless = alone if np.nanmean(alone) < np.nanmean(harmless) else harmless
    ended = held.at(there.model, at.z)
    drop = harmless - held.units(ended)
    lost = float(np.nanmean(drop))
    drops = clustered(evidence, drop)
    low, high = interval(drops, whole.size)
    nearer = far - distance(held, there.model, at.z) if told else 0.0
    weighed = np.isfinite(bars.plainly) and nearer > criteria.nearer * far
    noise = _noise(held, there.model, there.z, at.z) if weighed else 0.0
    cleared = nearer / (far - noise) if far > noise > 0 else 0.0
    first = float(np.nanmean(before))
    closed, factor = lost / whole.size, few_scenes(evidence.scenes(evidence.split.held_out))
    return Trial(
        effect, at.z, first, first - lost, closed, low, high, bars,
        None if choice is None else evidence.choices[choice],
        farther=-nearer / max(far, _ROUNDING), cleared=cleared, error=at.error,
        surely=closed - factor * (closed - interval(drops, whole.parts)[0]),
        learnt=(start.error - at.error) / whole.size,
        drops=drop,
        changes=held.changes(there, ended),
    )  # fmt: skip


def clustered(evidence: Evidence, values: np.ndarray) -> np.ndarray:
    """Group values (N, U) of the held-out pairs by scene, (scenes, U): only scenes are independent."""
    return by_scene(values, [evidence.names[i] for i in evidence.split.held_out])


def distance(held: Evidence, model: Model, z: np.ndarray) -> float:
    """Mean squared distance over pixels at a point; 0 for RAW+JPEG pairs."""
    found = held.distances(model, z)
    return 0.0 if found is None else float(found.mean())


def _noise(held: Evidence, model: Model, *points: np.ndarray) -> float:
    """Mean square of the noise, the largest of these points; a poor base may have too little noise."""
    found = [held.scatter(model, z) for z in points]
    return max((float(noise.mean()) for noise in found if noise is not None), default=0.0)


def _harmless(evidence: Evidence, point: Point, own: Sequence[int], moving: Sequence[int]) -> np.ndarray:
    """The point at which an effect only repeats the file's own compression, with the base fitted to it."""
    part, start = evidence.fitted(point)
    z = point.z.copy()
    for i in set(own) & set(evidence.references):
        z[i] = evidence.references[i]
    return fit(part, part.at(start.model, z), [i for i in moving if i not in set(own)], steps=3).point.z


def _fit_with(
    part: Objective,
    at: Point,
    moving: Sequence[int],
    own: Sequence[int],
    steps: int,
    form: np.ndarray | None = None,
) -> Point:
    """Fit, with the effect's columns renewed at each step; coordinates on a grid are searched."""
    model = at.model
    gridded = [i for i in own if model.coordinates[i].move.grid]
    afar = _from_afar(part, at, own) if form is None else at.z
    if (afar != at.z).any():
        at = part.compute(part.at(model, afar), [i for i in moving if i not in gridded])
    columns = at.columns
    for i in gridded:
        points = [placed(model, at.z, i, at.z[i] + v) for v in model.coordinates[i].move.grid]
        at = _climbed([ladder for z in points for ladder in noisier(model, z, i)], part, model)
    begun = starts(model, at.z, [i for i in own if i not in gridded])
    if begun:
        ladders = [ladder for own_form in begun for ladder in own_form]
        at = _climbed(ladders, part, model) if form is None else part.at(model, form)
    smooth = [i for i in moving if i not in gridded]
    noise = informed_by_noise(model)
    fresh = [i for i in smooth if i in own or i in noise]
    if begun or gridded:  # the columns were computed at another point
        columns = {i: column for i, column in columns.items() if i not in fresh}
    at = fit(part, at.with_columns(columns), smooth, steps=steps, fresh=fresh).point

    def moved_to(at: Point, z: np.ndarray) -> Point:
        """Move to z and refit the smooth coordinates."""
        if (z == at.z).all():
            return at
        return fit(part, part.at(model, z).with_columns(columns), smooth, steps=2, fresh=fresh).point

    for i in gridded:
        at = moved_to(at, _nearby(part, at, i, 0.5))
        at = moved_to(at, _nearby(part, at, i, 0.25))
        if model.coordinates[i].move.fine:
            at = moved_to(at, _finely(part, at, i))
    return at


def nearest_form(evidence: Evidence, point: Point, effect: str, criteria: Criteria) -> np.ndarray | None:
    """The best exact form of an effect, with the base refitted for each form.

    The base has imitated the effect, so the right form may raise the error until the base is refitted. A free
    fit would then end between two forms, and such a fit does not generalise to other scenes.

    Returns:
        coordinates (Z,) of the best fit; None if the effect has no exact forms, or if the base alone fits as
        well.
    """
    own = point.model.indices([effect]) if effect in EFFECTS and EFFECTS[effect].exact else []
    forms = starts(point.model, point.z, own) if own else []
    if not forms:
        return None
    part, start = evidence.fitted(point)
    model, noise = start.model, informed_by_noise(start.model)
    moving = [*model.base_indices, *switched_on(point)]
    columns = {i: column for i, column in start.columns.items() if i not in noise}
    points = [_climbed(ladders, part, model) for ladders in forms]
    least = min(at.error for at in points)
    ends = []
    for at in points:
        if at.error <= criteria.hopeless * least:
            at = part.compute(at.with_columns(columns), moving)
            ends.append(fit(part, at, moving, steps=2, fresh=noise))
    found = min(ends, key=lambda end: end.total).point.z
    return found if (found[own] != point.z[own]).any() else None


def _climbed(ladders: Ladders, part: Objective, model: Model) -> Point:
    """The point of least error; each ladder is climbed as long as the error falls."""

    def climb(ladder: list[np.ndarray]) -> tuple[float, np.ndarray]:
        least, best = np.inf, ladder[0]
        for z in ladder:
            error = part.at(model, z).error
            if error >= least:
                break
            least, best = error, z
        return least, best

    return part.at(model, min(parallel_map(climb, ladders), key=lambda found: found[0])[1])


def _best_of(points: Sequence[np.ndarray], part: Objective, model: Model) -> np.ndarray:
    """The coordinates (Z,) of least error among `points`."""
    errors = parallel_map(lambda z: part.at(model, z).error, points)
    return points[int(np.argmin(errors))]


def _from_afar(part: Objective, at: Point, own: Sequence[int]) -> np.ndarray:
    """The point with the better start: as it is, or with the effect far from its small probe."""
    z, model = at.z, at.model
    for i in own:
        points = [z, *(placed(model, z, i, z[i] + v) for v in model.coordinates[i].move.far)]
        z = _best_of(points, part, model) if len(points) > 1 else z
    return z


def distant(evidence: Objective, point: Point, names: Sequence[str]) -> dict[int, float]:
    """By coordinate of these effects: the change in `Move.far` that lowers the error most, if one does."""
    model, found = point.model, {}
    for i in model.indices(names):
        tried = model.coordinates[i].move.far
        points = [placed(model, point.z, i, point.z[i] + v) for v in tried]
        errors = parallel_map(lambda z: evidence.at(model, z).error, points)
        if errors and min(errors) < point.error:
            found[i] = tried[int(np.argmin(errors))]
    return found


def searched(model: Model, names: Sequence[str]) -> list[int]:
    """Indices of the coordinates of these effects that are searched on a grid."""
    return [i for i in model.indices(names) if model.coordinates[i].move.grid]


def lowest(evidence: Objective, point: Point, i: int) -> float:
    """The change on the grid of coordinate `i` with the least error."""
    model, grid = point.model, point.model.coordinates[i].move.grid
    errors = parallel_map(lambda v: evidence.at(model, placed(model, point.z, i, v)).error, grid)
    return grid[int(np.argmin(errors))]


def _nearby(part: Objective, at: Point, i: int, share: float) -> np.ndarray:
    """The best of the point and its neighbours, at a share of the grid's spacing to both sides."""
    model = at.model
    grid = np.array(model.coordinates[i].move.grid)
    spacing = np.sort(np.abs(grid - at.z[i]))[1] * share
    tried = [np.clip(at.z[i] + d, *model.ranges[:, i]) for d in (0, -spacing, spacing)]
    return _best_of([placed(model, at.z, i, v) for v in tried], part, model)


def _finely(part: Objective, at: Point, i: int) -> np.ndarray:
    """The best point in the range that the search has narrowed down, at the resolution of the move."""
    model, move, z = at.model, at.model.coordinates[i].move, at.z[i]
    reach = np.sort(np.abs(np.array(move.grid) - z))[1] / 4
    tried = np.clip(z + np.arange(-reach, reach, move.fine), *model.ranges[:, i])
    return _best_of([at.z, *(placed(model, at.z, i, v) for v in tried)], part, model)


def _choose_again(part: Evidence, at: Point, criteria: Criteria) -> int | None:
    """The index of the demosaicker that fits best together with the effect; None if the base has it already.

    Without the effect, the best demosaicker is the one whose errors look most like the effect.
    """
    least, best = at.error * criteria.chosen_anew, None
    for k, choice in enumerate(part.choices):
        error = part.at(at.model.chosen(choice), at.z).error
        if error < least:
            least, best = error, k
    return best
