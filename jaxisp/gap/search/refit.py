"""One effect fitted together with the base, and what it closes on pairs that were not fitted."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxisp.gap.axes.interval import few_scenes, interval
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Measured
from jaxisp.gap.objective.starts import Ladders
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.parallel import each
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import Choice

SMALLEST = 0.05
"""The lower end of an accepted effect's interval of closure."""
FARTHEST = 0.2
"""By what share an effect may raise the mean square distance of pixels, noise and all. Statistics are blind
to much: a warp of several pixels smooths noise as well, but what it shows is elsewhere."""
NEARER = 0.05
"""By what share of the mean square distance of pixels one effect must be nearer than another to be told from
it by that."""
_CLEARED = 0.5
"""What share of the distance beyond the noise must go for pixels to show an effect by themselves."""
_MOST = 0.67
"""The share of what causes before it leave, from which on an effect needs to be sure of a part of that alone:
how unlike scenes are in the other causes' part is nothing against it."""
_DRAWS = 400
_HOPELESS = 4.0
"""How many times the least error of all forms one may leave at first for the base to be fitted beside it."""
_FREER = 0.9
"""What share of a form's error its effect must leave where its numbers are free, to be between forms."""
_ROUNDING = 1 / 12  # of 8 bits, which pictures without noise have left


@dataclasses.dataclass(frozen=True)
class Whole:
    """The gap above the floor that closure is a share of: its size, and the part (N, U) of each held-out
    pair's units, clustered as their drops are."""

    size: float
    parts: np.ndarray


@dataclasses.dataclass(frozen=True)
class Trial:
    """An effect refitted with the base: where it ended, and the share of the gap it closes there.

    `choice` is what the base became with it, None where it stayed as it was; `params` are the effect's own
    where `z` has none for it; `farther` is the share by which pixels are farther from the real ones with it.
    `low` and `high` are a bootstrap's; `surely` is the lower end of the share where a scene that has more of
    the gap is drawn with it, and scenes are few. `cleared` is the share of the pixels' distance beyond the
    noise that goes with it, and `plainly` what `low` must be above where they show it by themselves. `error`
    is what it leaves on the fitted pairs, `rest` the share of the gap that causes before it left.
    """

    effect: str
    z: np.ndarray
    before: float
    after: float
    closed: float
    low: float
    high: float
    least: float
    choice: Choice | None = None
    params: dict[str, float] = dataclasses.field(default_factory=dict)
    farther: float = 0.0
    surely: float = np.inf
    cleared: float = 0.0
    plainly: float = np.inf
    error: float = np.inf
    rest: float = 1.0

    @property
    def gain(self) -> float:
        return self.before - self.after

    @property
    def possible(self) -> bool:
        return self.farther < FARTHEST

    @property
    def shown(self) -> bool:
        """Whether pixels show it, whatever statistics say: they come nearer by as much as no stranger's have,
        or by half of what they are off."""
        return self.farther < -FARTHEST or (self.farther < -NEARER and self.cleared > _CLEARED)

    @property
    def accepted(self) -> bool:
        if self.low <= SMALLEST or not self.possible:
            return False
        sure = SMALLEST * (self.rest if self.closed > _MOST * self.rest else 1.0)
        by_statistics = self.low > self.least and self.surely > sure
        return by_statistics or (self.shown and self.low > self.plainly)


def switched_on(problem: Measured) -> list[int]:
    """Coordinates of effects that were accepted already and stay free."""
    first = len(problem.model.base)
    return [i for i in range(first, len(problem.z)) if problem.z[i] != 0]


def refit(
    problem: Measured,
    effect: str,
    split: Split,
    whole: Whole,
    least: float,
    steps: int = 4,
    begin: np.ndarray | None = None,
    form: np.ndarray | None = None,
    plainly: float = np.inf,
    rest: float = 1.0,
) -> Trial:
    """Fit an effect and the base together on the fitted pairs, and measure the closure on the others.

    The problem stays where it is.

    Args:
        whole: the gap before any effect.
        least: the share that the lower end of its interval must be above, beside `SMALLEST`.
        begin: where the fit starts, what is searched for being found there; None: it is looked for.
        form: of `nearest_form`; what moves freely from there must be better by a tenth.
        plainly: likewise, where pixels show the effect by themselves.
        rest: the share of the gap that causes before it left.
    """
    own = problem.model.indices([effect])
    moving = [*problem.model.base_indices, *switched_on(problem), *own]
    part, seen = problem.take(split.fit), range(len(split.fit))
    if begin is None:
        _fit_with(part, moving, own, seen, steps, form)
    else:
        part.move_to(begin)
        fit(part, [i for i in moving if not part.model.coordinates[i].move.grid], seen, steps=steps)
    if form is not None and part.errors(part.z).mean() > _FREER * part.errors(form).mean():
        part.move_to(form)
    choice = _choose_again(part, seen)
    if choice is not None:
        fit(part, [i for i in moving if i not in searched(part, [effect])], seen, steps=2)
    held = problem.take(split.held_out)
    # of a pattern whose place is drawn pixels say nothing
    told = effect not in EFFECTS or not EFFECTS[effect].random
    before, far = held.units(problem.z), distance(held, problem.z) if told else 0.0
    harmless = _harmless(problem, own, moving, split, held) if set(own) & set(problem.references) else before
    if choice is not None:
        held.choose(problem.choices[choice].take(split.held_out))
        alone = held.units(problem.z)  # what the choice does without the effect is not the effect's
        harmless = alone if np.nanmean(alone) < np.nanmean(harmless) else harmless
    after = held.units(part.z)
    drop = harmless - after
    lost = float(np.nanmean(drop))
    drops = problem.clustered(drop, split.held_out)
    low, high = interval(drops, whole.size)
    chosen = None if choice is None else problem.choices[choice]
    nearer = far - distance(held, part.z) if told else 0.0
    noise = _noise(held, problem.z, part.z) if np.isfinite(plainly) and nearer > NEARER * far else 0.0
    cleared = nearer / (far - noise) if far > noise > 0 else 0.0
    start = float(np.nanmean(before))
    closed, factor = lost / whole.size, few_scenes(problem.scenes(split.held_out))
    surely = closed - factor * (closed - interval(drops, whole.parts)[0])
    return Trial(
        effect, part.z, start, start - lost, closed, low, high, least, chosen,
        farther=-nearer / max(far, _ROUNDING), surely=surely, cleared=cleared, plainly=plainly,
        error=float(part.errors(part.z).mean()), rest=rest,
    )  # fmt: skip


def distance(held: Measured, z: np.ndarray) -> float:
    """The mean square distance of these pixels at a point; 0 where pixels are what is compared."""
    found = held.distances(z)
    return 0.0 if found is None else float(found.mean())


def _noise(held: Measured, *points: np.ndarray) -> float:
    """The mean square of the noise, the larger of these points': a base that lacks much may have less."""
    found = [held.scatter(z) for z in points]
    return max((float(noise.mean()) for noise in found if noise is not None), default=0.0)


def _harmless(
    problem: Measured, own: Sequence[int], moving: Sequence[int], split: Split, held: Measured
) -> np.ndarray:
    """The held-out units where an effect does what the file does anyway, the base fitted beside it."""
    part = problem.take(split.fit)
    z = problem.z.copy()
    for i in set(own) & set(problem.references):
        z[i] = problem.references[i]
    part.move_to(z)
    fit(part, [i for i in moving if i not in set(own)], range(len(split.fit)), steps=3)
    return held.units(part.z)


def _fit_with(
    part: Measured,
    moving: Sequence[int],
    own: Sequence[int],
    seen: Sequence[int],
    steps: int,
    form: np.ndarray | None = None,
) -> None:
    """Fit, the effect's own columns anew at each step; what does not act smoothly is searched for."""
    gridded = [i for i in own if part.model.coordinates[i].move.grid]
    afar = _from_afar(part, own, seen) if form is None else part.z
    if (afar != part.z).any():
        part.move_to(afar)
        part.compute([i for i in moving if i not in gridded])
    columns = part.columns
    for i in gridded:
        points = [part.placed(part.z, i, part.z[i] + v) for v in part.model.coordinates[i].move.grid]
        part.move_to(_climbed([ladder for z in points for ladder in part.noisier(z, i)], part, seen))
    starts = part.starts([i for i in own if i not in gridded])
    if starts:
        part.move_to(
            _climbed([ladder for own in starts for ladder in own], part, seen) if form is None else form
        )
    smooth = [i for i in moving if i not in gridded]
    fresh = [i for i in smooth if i in own or i in part.fresh]
    if starts or gridded:  # the columns of these are another point's
        columns = {i: column for i, column in columns.items() if i not in fresh}
    part.columns = dict(columns)
    fit(part, smooth, seen, steps=steps, fresh=fresh)

    def go_to(z: np.ndarray) -> None:
        """The rest has been fitted for the place before."""
        if (z != part.z).any():
            part.move_to(z)
            part.columns = dict(columns)
            fit(part, smooth, seen, steps=2, fresh=fresh)

    for i in gridded:
        go_to(_nearby(part, i, 0.5, seen))
        go_to(_nearby(part, i, 0.25, seen))
        if part.model.coordinates[i].move.fine:
            go_to(_finely(part, i, seen))


def nearest_form(problem: Measured, effect: str, split: Split) -> np.ndarray | None:
    """Of an effect whose forms are exact the one that leaves the least error once the base is fitted beside
    it, where that ends; None of other effects, or where the base alone does as well.

    The base has imitated what a form does, so that the right one may look worse at first, and numbers that
    move freely from there end between two, which other scenes do not bear out.
    """
    own = problem.model.indices([effect]) if effect in EFFECTS and EFFECTS[effect].exact else []
    forms = problem.starts(own) if own else []
    if not forms:
        return None
    part, seen = problem.take(split.fit), range(len(split.fit))
    moving = [*problem.model.base_indices, *switched_on(problem)]
    columns = {i: column for i, column in part.columns.items() if i not in part.fresh}
    points = [_climbed(ladders, part, seen) for ladders in forms]
    errors = [float(part.errors(z).mean()) for z in points]
    ends = []
    for point in (z for z, error in zip(points, errors) if error <= _HOPELESS * min(errors)):
        part.move_to(point)
        part.columns = dict(columns)
        part.compute(moving)
        ends.append((fit(part, moving, seen, steps=2, fresh=part.fresh), part.z))
    found = min(ends, key=lambda end: end[0])[1]
    return found if (found[own] != problem.z[own]).any() else None


def _climbed(ladders: Ladders, part: Measured, seen: Sequence[int]) -> np.ndarray:
    """The point that leaves the least error, each ladder climbed as long as that falls."""

    def climb(ladder: list[np.ndarray]) -> tuple[float, np.ndarray]:
        least, best = np.inf, ladder[0]
        for z in ladder:
            error = float(part.errors(z)[list(seen)].mean())
            if error >= least:
                break
            least, best = error, z
        return least, best

    return min(each(climb, ladders), key=lambda found: found[0])[1]


def _best_of(points: Sequence[np.ndarray], problem: Measured, seen: Sequence[int]) -> np.ndarray:
    """The point that leaves the least error."""
    errors = each(lambda z: problem.errors(z)[list(seen)].mean(), points)
    return points[int(np.argmin(errors))]


def _from_afar(part: Measured, own: Sequence[int], seen: Sequence[int]) -> np.ndarray:
    """The point itself, or one that an effect far from its small probe starts from, where that is better."""
    z = part.z
    for i in own:
        points = [z, *(part.placed(z, i, z[i] + v) for v in part.model.coordinates[i].move.far)]
        z = _best_of(points, part, seen) if len(points) > 1 else z
    return z


def distant(problem: Measured, names: Sequence[str]) -> dict[int, float]:
    """By coordinate of these effects the change out of `Move.far` that lowers the error most, if one does."""
    at_rest, found = problem.errors(problem.z).mean(), {}
    for i in problem.model.indices(names):
        tried = problem.model.coordinates[i].move.far
        points = [problem.placed(problem.z, i, problem.z[i] + v) for v in tried]
        errors = each(lambda z: problem.errors(z).mean(), points)
        if errors and min(errors) < at_rest:
            found[i] = tried[int(np.argmin(errors))]
    return found


def searched(problem: Measured, names: Sequence[str]) -> list[int]:
    """Coordinates of these effects that are searched for on a grid."""
    return [i for i in problem.model.indices(names) if problem.model.coordinates[i].move.grid]


def lowest(problem: Measured, i: int, seen: Sequence[int]) -> float:
    """Which change of the grid leaves the least error."""
    seen, grid = list(seen), problem.model.coordinates[i].move.grid
    errors = each(lambda v: problem.errors(problem.placed(problem.z, i, v))[seen].mean(), grid)
    return grid[int(np.argmin(errors))]


def _nearby(problem: Measured, i: int, share: float, seen: Sequence[int]) -> np.ndarray:
    """The best of the point itself and those a share of the grid's spacing to both sides."""
    grid = np.array(problem.model.coordinates[i].move.grid)
    spacing = np.sort(np.abs(grid - problem.z[i]))[1] * share
    tried = [np.clip(problem.z[i] + d, *problem.model.ranges[:, i]) for d in (0, -spacing, spacing)]
    points = [problem.placed(problem.z, i, v) for v in tried]
    return _best_of(points, problem, seen)


def _finely(problem: Measured, i: int, seen: Sequence[int]) -> np.ndarray:
    """The best point as near as the search has come so far, in the steps that the move asks for."""
    move, z = problem.model.coordinates[i].move, problem.z[i]
    reach = np.sort(np.abs(np.array(move.grid) - z))[1] / 4
    tried = np.clip(z + np.arange(-reach, reach, move.fine), *problem.model.ranges[:, i])
    points = [problem.z, *(problem.placed(problem.z, i, v) for v in tried)]
    return _best_of(points, problem, seen)


_CLEARLY = 0.98


def _choose_again(problem: Measured, seen: Sequence[int]) -> int | None:
    """Put the choice that fits best beside the effect into the problem, where it is another; says which.

    Without its effect a camera is explained best by the demosaicker whose flaws look most like the effect.
    """
    seen, model = list(seen), problem.model
    least, best_choice = problem.errors(problem.z)[seen].mean() * _CLEARLY, None
    for k, choice in enumerate(problem.choices):
        problem.model = model.chosen(choice)
        error = problem.errors(problem.z)[seen].mean()
        if error < least:
            least, best_choice = error, k
    problem.model = model
    if best_choice is not None:
        problem.choose(problem.choices[best_choice])
    return best_choice
