"""Pixel errors: what the simulator's pictures lack, and how they change with each move.

Least squares on residuals in Y'CbCr, in 8-bit steps. Columns are secants, differences of two pictures: they
exist where a derivative does not (medians, choices, roundings).
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import uniform_filter

from jaxisp.gap.axes import Rows
from jaxisp.gap.axes.regression import DRAWS, where
from jaxisp.gap.objective.protocol import NormalEquations, Point
from jaxisp.gap.pairs.pairs import INNER, Pairs, to_steps
from jaxisp.gap.pairs.scenes import Split, scene_name
from jaxisp.gap.pairs.stored import as_stored
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.simulator.choices import unsampled
from jaxisp.gap.simulator.model import Model, Variant
from jaxisp.io import Jpeg

_TILE = 60  # px a side of what intervals are drawn from, about
_PART, _ROWS = 2**15, 16
"""Numbers of a picture that are multiplied at once, and of how many columns a multiple."""
_MOST = 400_000_000
"""Bytes of columns of `InParts`."""


@dataclasses.dataclass(frozen=True, eq=False)
class PixelObjective:
    """Mean square errors of pictures, pixel by pixel.

    Attributes:
        pairs: light, and the pictures that are wanted.
        split: which are fitted and which held out.
        target: (N, h, w, 3) the wanted pictures in steps, their border cut off.
        counts: (N,) the sum of what pixels count.
        weight: (N, h, w, 3) root of what a pixel counts.
        choices, rival, references: see `Evidence`.
        earlier: row and column where 8x8 blocks of an earlier compression began, (0, 0) of none.
        begun: (N, h, w, 3) the simulator's pictures in steps whose residual gave the weights; None where all
            pixels count alike.
    """

    pairs: Pairs
    split: Split
    target: np.ndarray
    counts: np.ndarray
    weight: np.ndarray
    choices: Sequence[Variant] = ()
    rival: Variant | None = None
    references: Mapping[int, float] = dataclasses.field(default_factory=dict)
    earlier: tuple[int, int] = (0, 0)
    begun: np.ndarray | None = None

    follows = False
    compact = False

    @classmethod
    def of(
        cls,
        pairs: Pairs,
        split: Split | None = None,
        choices: Sequence[Variant] = (),
        rival: Variant | None = None,
    ) -> "PixelObjective":
        """Of pairs whose pixels all count alike; all pairs are fitted unless a split is given."""
        target = to_steps(pairs.pictures[INNER])
        split = Split(tuple(range(len(target))), ()) if split is None else split
        counts, weight = _weights(np.ones(target.shape[:-1]), pairs, target)
        return cls(pairs, split, target, counts, weight, tuple(choices), rival)

    @property
    def names(self) -> tuple[str, ...]:
        return self.pairs.names

    def weighed(self, weights: np.ndarray) -> "PixelObjective":
        """With (N, h, w) what each pixel counts, beside the mask."""
        counts, weight = _weights(weights, self.pairs, self.target)
        return dataclasses.replace(self, counts=counts, weight=weight)

    def robust(self, point: Point) -> "PixelObjective":
        """Weighed by `robust_weights` of the residual at a point."""
        weighed = self.weighed(self.robust_weights(self.target - point.shown[0]))
        return dataclasses.replace(weighed, begun=point.shown[0])

    def robust_weights(self, difference: np.ndarray) -> np.ndarray:
        """(N, h, w) weights that fall where the difference (N, h, w, 3) around a pixel is large against what
        is usual.

        Another demosaicker leaves large errors at few edges, which would hide all else.
        """
        around = uniform_filter((difference**2).sum(-1), (0, 5, 5))
        usual = np.median(around[self.pairs.mask[INNER]])
        return 1 / (1 + around / (4 * usual + 1e-9)).astype(np.float32)

    def picture(self, model: Model, z: np.ndarray) -> np.ndarray:
        """(N, h, w, 3) Y'CbCr in steps, its border cut off."""
        return model.in_steps(z, self.pairs.light)

    def rendered(self, model: Model, z: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) encoded."""
        return model.render(z, self.pairs.light)

    def at(self, model: Model, z: np.ndarray) -> Point:
        z = np.asarray(z, float)
        return self._point(model, z, self.picture(model, z))

    def _point(
        self,
        model: Model,
        z: np.ndarray,
        current: np.ndarray,
        columns: Mapping[int, np.ndarray] | None = None,
    ) -> Point:
        errors = self.mean_squares((self.target - current) * self.weight)
        return Point(model, z, errors, (current,), columns or {})

    def residual(self, point: Point) -> np.ndarray:
        """(N, h, w, 3) target less picture, weighed; masked pixels 0."""
        return np.asarray((self.target - point.shown[0]) * self.weight)

    def mean_squares(self, residual: np.ndarray) -> np.ndarray:
        """(N,) of weighed residuals, all channels together."""
        flat = residual.reshape(len(residual), -1)
        return np.asarray(np.einsum("np,np->n", flat, flat, dtype=np.float64) / self.counts)

    def compute(self, point: Point, which: Sequence[int], steps: Mapping[int, float] | None = None) -> Point:
        def column(i: int) -> np.ndarray:
            behind, ahead, step = point.model.probe(point.z, i, (steps or {}).get(i))
            before = point.shown[0] if (behind == point.z).all() else self.picture(point.model, behind)
            return np.asarray((self.picture(point.model, ahead) - before) * (self.weight / np.float32(step)))

        new = sorted(set(which) - set(point.columns))
        return point.with_columns({**point.columns, **dict(zip(new, parallel_map(column, new)))})

    def normal(self, point: Point, which: Sequence[int]) -> NormalEquations:
        n = len(self.target)
        if not which:
            return NormalEquations(np.zeros((n, 0, 0)), np.zeros((n, 0)))
        rows = [*(point.columns[i].reshape(n, -1) for i in which), self.residual(point).reshape(n, -1)]
        products = np.stack([_products([row[pair] for row in rows]) for pair in range(n)])
        products /= self.counts[:, None, None]
        return NormalEquations(products[:, :-1, :-1], products[:, :-1, -1])

    def follow(self, point: Point, to: Point) -> Point:
        """`to` as it is: columns of pixels are computed anew."""
        return to

    def take(self, which: Sequence[int]) -> "PixelObjective":
        """The objective of some of the pairs."""
        index = np.asarray(which)
        return dataclasses.replace(
            self,
            pairs=self.pairs.take(which),
            split=Split(tuple(range(len(index))), ()),
            target=self.target[index],
            counts=self.counts[index],
            weight=np.broadcast_to(self.weight[..., :1][index], (len(index), *self.target.shape[1:])),
            choices=tuple(choice.take(which) for choice in self.choices),
            rival=None if self.rival is None else self.rival.take(which),
            begun=None if self.begun is None else self.begun[index],
        )

    @functools.cached_property
    def _fitted(self) -> "PixelObjective":
        return self.take(self.split.fit)

    @functools.cached_property
    def _held_out(self) -> "PixelObjective":
        return self.take(self.split.held_out)

    def fitted(self, point: Point) -> tuple["PixelObjective", Point]:
        return self._fitted, self._fitted._taken(point, self.split.fit)

    def held_out(self, point: Point) -> tuple["PixelObjective", Point]:
        return self._held_out, self._held_out._taken(point.with_columns({}), self.split.held_out)

    def part(self, point: Point, which: Sequence[int]) -> tuple["PixelObjective", Point]:
        """The objective of some of the pairs, and a point of all as a point of these."""
        part = self.take(which)
        return part, part._taken(point, which)

    def _taken(self, point: Point, which: Sequence[int]) -> Point:
        """A point of all pairs as a point of these, which are some of them."""
        index = np.asarray(which)
        columns = {i: column[index] for i, column in point.columns.items()}
        return self._point(point.model.take(which), point.z, point.shown[0][index], columns)

    def units(self, point: Point) -> np.ndarray:
        """(N, U) mean square residual of each tile, scaled so that the mean over tiles is the pair's."""
        return self.tiled((self.residual(point) ** 2).sum(-1))

    def changes(self, one: Point, other: Point) -> np.ndarray:
        """(N, U) mean squares of the difference of two points' pictures, by tile, scaled likewise."""
        return self.tiled((((other.shown[0] - one.shown[0]) * self.weight) ** 2).sum(-1))

    def tiled(self, square: np.ndarray) -> np.ndarray:
        """(N, U) means over tiles of (N, h, w) weighted squares, scaled likewise."""
        return tiled(square, self.counts)

    def distances(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """None: the errors are those of pixels."""
        return None

    def scatter(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """None: what is simulated is the same each time."""
        return None

    def scenes(self, which: Sequence[int]) -> int | None:
        """None: tiles are drawn beside pairs."""
        return None

    def located(self, point: Point) -> tuple[Rows, Rows]:
        """The axes by their share of the residual, twice the same; all pairs teach what is explained."""
        rows = self._where(point, DRAWS)
        return rows, rows

    def sized(self, point: Point) -> Rows:
        return self._where(point, 0)

    def _where(self, point: Point, draws: int) -> Rows:
        held = list(self.split.held_out)
        order = [*held, *(i for i in range(len(self.target)) if i not in set(held))]
        weight = self.weight[order][..., 0]
        residual = self.residual(point)[order] / np.maximum(weight[..., None], 1e-6)
        scenes = [scene_name(self.names[i]) for i in order]
        return where(
            residual, point.shown[0][order], weight**2, scenes=scenes, scored=len(held), earlier=self.earlier,
            draws=draws, rng=np.random.default_rng(0),
        )  # fmt: skip

    def floor_difference(self, point: Point, files: Sequence[Jpeg | None]) -> np.ndarray:
        """(N, h, w, 3) what rounding and the files' own compression do to the simulator's pictures, in
        steps.

        Files sample chroma themselves: they are made of what the simulator has before its own sampling.
        """
        whole = self.rendered(unsampled(point.model, files[0]), point.z)
        stored = np.stack([as_stored(p, f) for p, f in zip(whole, files)])
        return np.asarray(to_steps(stored[INNER]) - point.shown[0])

    def floor_errors(self, point: Point, difference: np.ndarray) -> np.ndarray:
        """(N,) the errors that rounding and compression would leave were the simulator right at a point."""
        return np.asarray(np.nanmean(self.floor_units(point, difference), 1))

    def floor_units(self, point: Point, difference: np.ndarray) -> np.ndarray:
        """(N, U) parts that each of `floor_errors` is the mean of, by tile.

        Pixels count as they would if the real pictures were the point's, stored: weights come from the
        residual before effects were added.
        """
        counted = np.asarray(self.pairs.mask[INNER], np.float32)
        if self.begun is not None:
            counted = counted * self.robust_weights(difference + (point.shown[0] - self.begun))
        return tiled((difference**2).sum(-1) * counted, counted.sum((1, 2)))


def _weights(weights: np.ndarray, pairs: Pairs, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) counts and (N, h, w, 3) roots of what pixels count."""
    counted = weights * pairs.mask[INNER]
    counts = counted.reshape(len(counted), -1).sum(1)
    return counts, np.broadcast_to(np.sqrt(counted, dtype=np.float32)[..., None], target.shape)


def tiled(square: np.ndarray, counts: np.ndarray, side: int = _TILE) -> np.ndarray:
    """(N, U) means over tiles of (N, h, w) weighted squares, scaled so that their mean is the sum over the
    (N,) counts."""
    h, w = square.shape[1:]
    rows, columns = max(h // side, 1), max(w // side, 1)
    tiles = [np.array_split(r, columns, 2) for r in np.array_split(square, rows, 1)]
    sums = np.stack([t.sum((1, 2), dtype=np.float64) for row in tiles for t in row], 1)
    return sums * (rows * columns / counts)[:, None]


def _products(rows: Sequence[np.ndarray]) -> np.ndarray:
    """(K, K) of K rows (P,), summed over parts of them: a stack of whole rows would be another copy."""
    count = len(rows)
    part = np.zeros((-(-count // _ROWS) * _ROWS, _PART), np.float32)  # few shapes: each is a program
    found = np.zeros((len(part), len(part)))
    for start in range(0, len(rows[0]), _PART):
        for own, row in zip(part, rows):
            piece = row[start : start + _PART]
            own[: len(piece)], own[len(piece) :] = piece, 0
        found += np.asarray(_squared(part))
    return found[:count, :count]


@jax.jit
def _squared(rows: jax.Array) -> jax.Array:
    """(K, K) of (K, P).

    By XLA: OpenBLAS' threads wait by spinning, which takes fifty times as long on a busy machine.
    """
    return jnp.einsum("kp,lp->kl", rows, rows, precision=jax.lax.Precision.HIGHEST)


@dataclasses.dataclass(frozen=True)
class InParts:
    """Pixels for a fit over so many coordinates that the columns of all pairs would not fit in memory.

    Columns are computed for some pairs at a time, and only their products are kept.
    """

    pixels: PixelObjective

    follows = False
    compact = False

    def at(self, model: Model, z: np.ndarray) -> Point:
        return self.pixels.at(model, z)

    def compute(self, point: Point, which: Sequence[int], steps: Mapping[int, float] | None = None) -> Point:
        """The point as it is."""
        return point

    def normal(self, point: Point, which: Sequence[int]) -> NormalEquations:
        count, found = len(self.pixels.target), []
        at_once = max(1, _MOST // max(len(which) * self.pixels.target[0].nbytes, 1))
        for first in range(0, count, at_once):
            index = range(first, min(first + at_once, count))
            part, there = self.pixels.part(point, index)
            found.append(part.normal(part.compute(there, which), which))
        return NormalEquations(*map(np.concatenate, zip(*found)))

    def follow(self, point: Point, to: Point) -> Point:
        return self.pixels.follow(point, to)
