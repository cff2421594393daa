"""Differences of statistics between real pictures and simulated ones."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import jax
import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.axes.statistics import in_one_place, located, reattributed
from jaxisp.gap.features.quantization import Quantization
from jaxisp.gap.features.tolerances import (
    by_place,
    emphasis,
    emphasised,
    left_by_shift,
    noise_only,
    repeats,
    units,
    weights,
)
from jaxisp.gap.objective import tones
from jaxisp.gap.objective.measure import Measure, Shown
from jaxisp.gap.objective.protocol import NormalEquations, Point
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.simulator.model import Model, Variant

_REPLICATES = 4
_FIRST = 101  # number of the first draw that chance is measured with; others set the units
_FEWEST = 4  # scenes that tell how they differ


@dataclasses.dataclass(frozen=True, eq=False)
class StatisticsObjective:
    """Squares of the statistics' differences, in units of what is harmless or chance.

    Differences are averaged over the pairs of a half before they are squared: what a camera does is alike in
    all of its pictures, and chance is not.

    Attributes:
        measure: pictures as statistics.
        weights: (F,) how much each statistic counts, of mean one.
        scale: (N, F) what differences are multiplied by, so that their mean over a half is in units.
        counted: (F,) 1 for the statistics that count for now.
        emphasis: (F,) how much more a statistic counts for what the fitted pairs differed in; None before
            that is known.
        before: (N, T) what blocks were off by where a fit started; None where nothing is fitted.
        choices, rival, references: see `Evidence`.
        reported: the pairs that figures are of, in order; all if None.
    """

    measure: Measure
    weights: np.ndarray
    scale: np.ndarray
    counted: np.ndarray
    emphasis: np.ndarray | None = None
    before: np.ndarray | None = None
    choices: Sequence[Variant] = ()
    reported: tuple[int, ...] | None = None

    follows = True
    compact = True
    rival: Variant | None = None
    references: Mapping[int, float] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Model,
        pairs: Pairs,
        noise_free: Callable[[jax.Array], np.ndarray],
        split: Split,
        read: Quantization,
        choices: Sequence[Variant] = (),
        seed: int = 0,
    ) -> "StatisticsObjective":
        """Of pairs; chance is taken for alike in all statistics until `with_unit` measures it."""
        measure = Measure.of(pairs, split, noise_free, read, seed)
        counts = weights(measure.frames.repeated)
        found = cls(measure, counts, np.ones_like(measure.real), np.ones_like(counts), choices=tuple(choices))
        z = np.zeros(len(model.coordinates))
        return dataclasses.replace(
            found, scale=found._scaled(np.ones_like(measure.real), model, z, measure.real)
        )

    @property
    def split(self) -> Split:
        return self.measure.split

    @property
    def names(self) -> tuple[str, ...]:
        return self.measure.pairs.names

    def chance(self, point: Point, draws: int = 5) -> np.ndarray:
        """(D, N) each pair's part of the gap between two draws of the simulator's own noise.

        Only chance is in it: what a right simulator would leave. Every two of the draws are compared.
        """
        model, z = point.model, point.z
        drawn = [self.measure.simulated(model, z, _FIRST + k) for k in range(draws)]
        own = [self.scale * self.counted * (a - b) for a, b in itertools.combinations(drawn, 2)]
        return np.stack([(apart * self._mean(apart)).mean(1) for apart in own])

    def at(self, model: Model, z: np.ndarray) -> Point:
        z = np.asarray(z, float)
        return self._point(model, z, self.measure.shown(model, z))

    def _point(
        self,
        model: Model,
        z: np.ndarray,
        shown: Shown,
        columns: Mapping[int, np.ndarray] | None = None,
    ) -> Point:
        """(N,) each pair's part in the square of its half's mean difference, the mean of these parts."""
        simulated, toned = shown
        own = self.scale * self.counted * (self.measure.real - simulated)
        mean = self._mean(own)
        errors = (own * mean * self.spoiled(mean) ** 2).mean(1)
        if self.before is not None:
            errors = errors * tones.excess(self.measure.tones - toned, self.before)
        return Point(model, z, self._reported(errors), shown, columns or {})

    def _reported(self, values: np.ndarray) -> np.ndarray:
        return values if self.reported is None else values[list(self.reported)]

    def difference(self, point: Point) -> np.ndarray:
        """(N, F) each pair has the mean difference of its half, in units."""
        return self._mean(self.scale * self.counted * (self.measure.real - point.shown[0]))

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """(N, ...) each pair gets the mean of its half."""
        found = np.empty_like(values, float)
        for half in (self.split.fit, self.split.held_out):
            if half:
                found[list(half)] = values[list(half)].mean(0)
        return found

    def spoiled(self, difference: np.ndarray) -> np.ndarray:
        """(N, F) of at least one: what a difference is multiplied by where a fit must not spoil what was
        right: then it counts as much as what was as wrong at the base."""
        if self.before is None or self.emphasis is None:
            return np.ones_like(difference)
        now = emphasis(difference**2 / self.weights)
        return np.sqrt(np.maximum(now / self.emphasis, 1.0))

    def counting(self, which: np.ndarray) -> "StatisticsObjective":
        """With only these statistics (F,) counting."""
        return dataclasses.replace(self, counted=which)

    def with_unit(self, point: Point, *, emphasise: bool = False) -> "StatisticsObjective":
        """With the scatter from draw to draw and from scene to scene at a point in the unit of each
        statistic; the floor is one such unit. `emphasise` what the fitted pairs have most of their gap in."""
        model, z = point.model, point.z
        draws = np.stack([self.measure.simulated(model, z, k) for k in range(1, 1 + _REPLICATES)])
        scale = self._scaled(draws.var(0, ddof=1), model, z, point.shown[0])
        found = dataclasses.replace(self, scale=scale)
        if not emphasise:
            return found
        difference = found.difference(point)
        more = emphasis(difference[self.split.fit[0]] ** 2 / self.weights)
        counts = emphasised(self.weights, more)
        return dataclasses.replace(
            found, weights=counts, emphasis=more, scale=scale * np.sqrt(counts / self.weights)
        )

    def _scaled(self, chance: np.ndarray, model: Model, z: np.ndarray, simulated: np.ndarray) -> np.ndarray:
        """(N, F) the scale, by the variance (N, F) by chance and what is simulated (N, F) at z.

        A statistic that a picture has no pixels for does not vary, and does not count there.
        """
        counted = (chance > 1e-12) + 1e-9
        shares = counted / self._mean(counted)
        sizes = np.array([len(self._half(i)) for i in range(len(chance))])[:, None]
        scatter = 2 * repeats() * self._mean(shares**2 * chance) / sizes
        unlike, uneven = self._unlike(shares, simulated), self._uneven(shares, model, z)
        return np.asarray(shares * np.sqrt(self.weights / units(np.maximum(scatter, unlike), uneven)))

    def _unlike(self, shares: np.ndarray, simulated: np.ndarray) -> np.ndarray:
        """(N, F) how the mean's error, which follows what a scene shows and where, scatters from scene to
        scene: the variance of its mean over a half. 0 for the noise's, and where scenes are few."""
        scenes = self.measure.scenes(range(len(shares)))
        if len(set(scenes)) < _FEWEST:
            return np.zeros_like(shares)
        apart = shares * (self.measure.real - simulated)
        variance = ((apart - apart.mean(0)) ** 2).sum(0) / (len(apart) - 1) * (1 - noise_only())
        return np.stack([variance / len({scenes[k] for k in self._half(i)}) for i in range(len(scenes))])

    def _uneven(self, shares: np.ndarray, model: Model, z: np.ndarray) -> np.ndarray:
        """(N, F) how the noise's statistics differ from quarter to quarter of the frame: the variance of
        their mean over a half. Hot pixels are few, and the same in all pictures. 0 for the mean's."""
        simulated = self.measure.quarters(self.measure.picture(model, z), self.measure.again)
        found = [self._mean(shares * own) for own in self.measure.real_quarters - simulated]
        return np.asarray(np.var(found, 0, ddof=1) / len(found) * by_place())

    def _half(self, pair: int) -> list[int]:
        return list(self.split.fit if pair in self.split.fit else self.split.held_out)

    def compute(self, point: Point, which: Sequence[int], steps: Mapping[int, float] | None = None) -> Point:
        def column(i: int) -> np.ndarray:
            behind, ahead, step = point.model.probe(point.z, i, (steps or {}).get(i))
            here = (behind == point.z).all()
            before = point.shown if here else self.measure.shown(point.model, behind)
            change, moved = (a - b for a, b in zip(self.measure.shown(point.model, ahead), before))
            own = self._mean(self.scale * self.counted * change)
            return np.asarray(np.concatenate([own, moved], 1) / step)

        new = sorted(set(which) - set(point.columns))
        return point.with_columns({**point.columns, **dict(zip(new, parallel_map(column, new)))})

    def normal(self, point: Point, which: Sequence[int]) -> NormalEquations:
        if not which:
            n = len(point.errors)
            return NormalEquations(np.zeros((n, 0, 0)), np.zeros((n, 0)))
        difference = self.difference(point)
        spoiled = self.spoiled(difference)
        count = spoiled.shape[1]
        columns = np.stack([point.columns[i] for i in which], 1)
        stacked = columns[..., :count] * spoiled[:, None]
        gram = stacked @ stacked.transpose(0, 2, 1) / count
        slope = np.einsum("nkf,nf->nk", stacked, difference * spoiled) / count
        found = NormalEquations(gram, slope)
        if self.before is not None:
            error = float(((difference * spoiled) ** 2).mean())
            off = self.measure.tones - point.shown[1]
            found = tones.with_excess(found, error, columns[..., count:], off, self.before)
        return NormalEquations(*map(self._reported, found))

    def follow(self, point: Point, to: Point) -> Point:
        """`to` with the columns taken along, each turned so that together they say what the way there did
        (Broyden 1965): a step then costs one set of pictures, not one a coordinate."""
        way = {i: to.z[i] - point.z[i] for i in point.columns if to.z[i] != point.z[i]}
        if not way:
            return to
        columns, steps = point.columns, to.model.steps
        off = self._state(to) - self._state(point) - sum(columns[i] * step for i, step in way.items())
        length = sum((step / steps[i]) ** 2 for i, step in way.items())
        turned = {i: columns[i] + off * (way[i] / steps[i] ** 2 / length) for i in way}
        return to.with_columns({**columns, **turned})

    def _state(self, point: Point) -> np.ndarray:
        """(N, F + T) what columns are the changes of, but for what does not change."""
        return np.concatenate([-self.difference(point), point.shown[1]], 1)

    def fitted(self, point: Point) -> tuple["StatisticsObjective", Point]:
        """The fitted pairs alone take half as long to move; what blocks are off by counts from this point
        on."""
        index, own = list(self.split.fit), self.measure.fitted
        shown = own.shown(point.model, point.z)
        part = dataclasses.replace(
            self, measure=own, scale=self.scale[index], before=own.tones - shown[1], reported=None
        )
        columns = {i: column[index] for i, column in point.columns.items()}
        return part, part._point(point.model, point.z, shown, columns)

    def held_out(self, point: Point) -> tuple["StatisticsObjective", Point]:
        """What repeats is looked for in all pairs; the held-out ones are reported."""
        part = dataclasses.replace(self, reported=self.split.held_out)
        return part, part.at(point.model, point.z)

    def units(self, point: Point) -> np.ndarray:
        """(N, 1) each pair's part in the error of its half."""
        return point.errors[:, None]

    def changes(self, one: Point, other: Point) -> np.ndarray:
        """(N, 1) each pair's part in the mean square of the change of its half's statistics."""
        own = self.scale * self.counted * (other.shown[0] - one.shown[0])
        return self._reported((own * self._mean(own)).mean(1))[:, None]

    def distances(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """(N,) mean squares of what the real pictures differ in from what is simulated on average; of two
        draws, so that only the real noise is in it."""
        off = (self.measure.target - self.measure.picture(model, z, k) for k in (0, 1))
        return self._reported(self.measure.product(*off))

    def scatter(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """(N,) likewise of what one simulated picture differs in from their average: the noise."""
        one, other, third = (self.measure.picture(model, z, k) for k in (0, 1, 2))
        return self._reported(self.measure.product(third - one, third - other))

    def scenes(self, which: Sequence[int]) -> int | None:
        return len(set(self.measure.scenes(which)))

    def located(self, point: Point) -> tuple[Rows, Rows]:
        """The axes by their share of what the gap has above what is harmless and chance; as reported, what
        stands in one place in all pictures is looked at without what it does to other statistics."""
        measure = self.measure
        simulated = measure.picture(point.model, point.z)
        place = in_one_place(measure.target - simulated, measure.scenes(range(len(measure.real))))
        return self.located_with(point, place)

    def sized(self, point: Point) -> Rows:
        index = list(self.split.held_out)
        difference, apart = self.difference(point)[index].mean(0), self._apart(point, self.measure.real)
        return located(difference, self.weights, apart[index], self.measure.scenes(index))

    def located_with(self, point: Point, place: np.ndarray) -> tuple[Rows, Rows]:
        """Likewise, where (h, w) bool says what stands in one place."""
        rows = self.sized(point)
        if not place.any():
            return rows, rows
        measure, index = self.measure, list(self.split.held_out)
        scenes, difference = measure.scenes(index), self.difference(point)[index].mean(0)
        apart = self._apart(point, measure.real)
        simulated = measure.picture(point.model, point.z)
        without = measure.measured_real(np.where(place[..., None], simulated, measure.target))
        left = self._apart(point, without)
        both = [apart[index], left[index]]
        return rows, reattributed(
            rows, difference, self._mean(left)[index].mean(0), self.weights, both, scenes
        )

    def left_by_shift(self, point: Point) -> float:
        """The held-out gap at the point, were statistics moved by what the fitted pairs differ in."""
        apart = self._apart(point, self.measure.real)
        return left_by_shift(apart, self.scale, self.weights, self.split.fit, self.split.held_out)

    def _apart(self, point: Point, real: np.ndarray) -> np.ndarray:
        """(N, F) what these statistics of each pair differ in from the simulated ones, in units."""
        return np.asarray(self.scale * self.counted * (real - point.shown[0]))
