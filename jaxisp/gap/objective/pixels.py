"""RAW+JPEG pairs: what the simulator's picture lacks, and how it changes with each move.

Everything is least squares on residuals in Y'CbCr, in 8-bit steps. Columns are secants, differences of two
pictures: they exist where a derivative does not (medians, choices, roundings).
"""

import copy
import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import uniform_filter

from jaxisp.color import rgb_to_ycbcr_planes, srgb_to_linear
from jaxisp.encoder import encoder_of
from jaxisp.gap.axes.regression import where
from jaxisp.gap.case import Ladders, Rows
from jaxisp.gap.pairs.scenes import by_scene, scene_name
from jaxisp.gap.parallel import each
from jaxisp.gap.simulator.model import Choice, Model
from jaxisp.io import Jpeg
from jaxisp.pipeline import run

BORDER = 8


@dataclasses.dataclass(frozen=True)
class Pairs:
    """What is compared: `light` (N, H, W) mosaics or (N, H, W, 3) scenes, `pictures` (N, H, W, 3) encoded,
    and `mask` (N, H, W) of the pixels that count; `again` is a scene's light as the compression of its file
    leaves it once more, None where there was none."""

    names: tuple[str, ...]
    light: jax.Array
    pictures: np.ndarray
    mask: np.ndarray
    again: jax.Array | None = None

    def relit(self, change: Callable[[jax.Array], jax.Array]) -> "Pairs":
        """With this done to the light."""
        again = None if self.again is None else change(self.again)
        return dataclasses.replace(self, light=change(self.light), again=again)

    def take(self, which: Sequence[int]) -> "Pairs":
        index = np.asarray(which)
        names = tuple(self.names[i] for i in index)
        own = self.relit(lambda light: light[index])
        return dataclasses.replace(own, names=names, pictures=self.pictures[index], mask=self.mask[index])


def to_steps(pictures: np.ndarray) -> np.ndarray:
    """(..., 3) RGB in [0, 1] to (..., 3) Y'CbCr in 8-bit steps, float32."""
    return np.asarray(_to_steps(pictures))


@jax.jit
def _to_steps(pictures: jax.Array) -> jax.Array:
    return 255 * jnp.stack(rgb_to_ycbcr_planes(*jnp.moveaxis(jnp.asarray(pictures, jnp.float32), -1, 0)), -1)


class Problem:
    """A model before pairs, with the columns that have been computed at a point.

    Attributes:
        z: the point.
        residual: (N, P) target less picture there, masked pixels 0.
        weight: (N, P) 1 where a pixel counts.
        choices: what the base may be besides, that no number says.
        rival: that of the choices beside which effects are screened too, if there is one: what the base is
            explained by may be what an effect does.
        references: the values of coordinates at which an effect does what the file does anyway, so that
            its gain is counted from there.
        earlier: the row and column where blocks of an earlier compression began, (0, 0) of none.
    """

    def __init__(
        self, model: Model, pairs: Pairs, choices: Sequence[Choice] = (), rival: Choice | None = None
    ) -> None:
        self.model, self.pairs, self.choices, self.rival = model, pairs, tuple(choices), rival
        self.references: dict[int, float] = {}
        self.earlier = (0, 0)
        inner = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        self.inner = inner
        self.target = to_steps(pairs.pictures[inner])
        self.shape = self.target.shape
        self.weigh(np.ones(self.shape[:-1]))

    def take(self, which: Sequence[int]) -> "Problem":
        """The same problem, at the same point, of some of the pairs."""
        index = np.asarray(which)
        part = copy.copy(self)
        part.model, part.pairs = self.model.take(which), self.pairs.take(which)
        part.choices = tuple(choice.take(which) for choice in self.choices)
        part.rival = None if self.rival is None else self.rival.take(which)
        for name in ("target", "counts", "weight", "current", "residual"):
            setattr(part, name, getattr(self, name)[index])
        part.shape = part.target.shape
        part.columns = {i: column[index] for i, column in self.columns.items()}
        return part

    fresh: Sequence[int] = ()

    def placed(self, z: np.ndarray, i: int, value: float) -> np.ndarray:
        """The point with one coordinate elsewhere."""
        moved = z.copy()
        moved[i] = value
        return moved

    def starts(self, own: Sequence[int]) -> list[Ladders]:
        """Where to begin fitting these coordinates: where the problem is, if there is nothing to choose."""
        return []

    def noisier(self, z: np.ndarray, i: int) -> Ladders:
        """The point alone: there is no noise to imitate anything with."""
        return [[z]]

    def choose(self, choice: Choice) -> None:
        """Put a choice into the base, and stay at the same point."""
        self.model = self.model.chosen(choice)
        self.move_to(self.z)

    def weigh(self, weights: np.ndarray, z: np.ndarray | None = None) -> None:
        """Set how much each pixel (N, h, w) counts, beside the mask, and go to a point: z = 0 if None."""
        counted = weights * self.pairs.mask[self.inner]
        self.counts = counted.reshape(len(counted), -1).sum(1)
        self.weight = np.broadcast_to(np.sqrt(counted, dtype=np.float32)[..., None], self.shape)
        self.move_to(np.zeros(len(self.model.coordinates)) if z is None else z)

    def robust_weights(self, difference: np.ndarray | None = None) -> np.ndarray:
        """(N, h, w) weights that fall where the residual around a pixel is large against what is usual.

        Another demosaicker leaves large errors at few edges, which would hide all else.
        """
        difference = self.target - self.current if difference is None else difference
        around = uniform_filter((difference**2).sum(-1), (0, 5, 5))
        usual = np.median(around[self.pairs.mask[self.inner]])
        return 1 / (1 + around / (4 * usual + 1e-9)).astype(np.float32)

    def rendered(self, z: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) encoded."""
        return self.model.render(z, self.pairs.light)

    def picture(self, z: np.ndarray) -> np.ndarray:
        """(N, h, w, 3) Y'CbCr in steps, its border cut off."""
        return to_steps(self.rendered(z)[self.inner])

    def units(self, z: np.ndarray, side: int = 60) -> np.ndarray:
        """(N, U) mean square residual of each tile, scaled so that the mean over tiles is the pair's."""
        return self.tiled((((self.target - self.picture(z)) * self.weight) ** 2).sum(-1), side)

    def clustered(self, values: np.ndarray, which: Sequence[int]) -> np.ndarray:
        """(scenes, U) values of these pairs, for intervals over what is independent."""
        return by_scene(values, [self.pairs.names[i] for i in which])

    def scenes(self, which: Sequence[int]) -> int | None:
        """Not counted: that tiles are drawn beside pairs makes up for few of these."""
        return None

    def tiled(self, square: np.ndarray, side: int = 60) -> np.ndarray:
        """(N, U) means over tiles of (N, h, w) weighted squares, scaled likewise."""
        h, w = square.shape[1:]
        rows, columns = max(h // side, 1), max(w // side, 1)
        tiles = [np.array_split(r, columns, 2) for r in np.array_split(square, rows, 1)]
        sums = np.stack([t.sum((1, 2), dtype=np.float64) for row in tiles for t in row], 1)
        return sums * (rows * columns / self.counts)[:, None]

    def errors(self, z: np.ndarray) -> np.ndarray:
        """(N,) mean square residual of each pair, all channels together."""
        return self.mean_squares((self.target - self.picture(z)) * self.weight)

    def distances(self, z: np.ndarray) -> np.ndarray | None:
        """None: the errors are those of pixels already."""
        return None

    def scatter(self, z: np.ndarray) -> np.ndarray | None:
        """None: what is simulated is the same each time."""
        return None

    def located(self, held: Sequence[int]) -> list[dict[str, Any]]:
        """The axes by their share of the residual where the problem stands; see `where`. All pairs teach."""
        order = [*held, *(i for i in range(len(self.target)) if i not in set(held))]
        weight = self.weight[order][..., 0]
        residual = self.residual[order] / np.maximum(weight[..., None], 1e-6)
        scenes = [scene_name(self.pairs.names[i]) for i in order]
        return where(
            residual, self.current[order], weight**2, scenes=scenes, scored=len(held), earlier=self.earlier,
            rng=np.random.default_rng(0),
        )  # fmt: skip

    def credited(self, rows: Rows, held: Sequence[int]) -> Rows:
        """These: of a residual each axis has its own already."""
        return rows

    def mean_squares(self, residual: np.ndarray) -> np.ndarray:
        flat = residual.reshape(len(residual), -1)
        return np.einsum("np,np->n", flat, flat, dtype=np.float64) / self.counts

    def move_to(self, z: np.ndarray) -> None:
        """Go to a point; the columns there are yet to be computed."""
        self.z = np.asarray(z, float)
        self.current = self.picture(self.z)
        self.residual = (self.target - self.current) * self.weight
        self.columns: dict[int, np.ndarray] = {}

    def compute(self, which: Sequence[int], steps: Mapping[int, float] | None = None) -> None:
        """The columns of these coordinates at the point, as changes per unit.

        Args:
            which: the coordinates.
            steps: how far some are moved, where it is not the usual probe.
        """

        def column(i: int) -> np.ndarray:
            behind, ahead, step = self.model.probe(self.z, i, (steps or {}).get(i))
            before = self.current if (behind == self.z).all() else self.picture(behind)
            return np.asarray((self.picture(ahead) - before) * (self.weight / np.float32(step)))

        new = sorted(set(which) - set(self.columns))
        self.columns.update(zip(new, each(column, new)))

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """(N, K, K) and (N, K): each pair's normal equations for these columns, per pixel."""
        n = len(self.target)
        if not which:
            return np.zeros((n, 0, 0)), np.zeros((n, 0))
        stacked = np.stack([self.columns[i].reshape(n, -1) for i in which], 1)
        scale = 1 / self.counts[:, None]
        gram, right = map(np.asarray, _products(stacked, self.residual.reshape(n, -1)))
        return gram * scale[..., None], right * scale


@jax.jit
def _products(columns: jax.Array, residual: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(N, K, K) and (N, K) of (N, K, P) and (N, P).

    By XLA: OpenBLAS' threads wait by spinning, which takes fifty times as long on a busy machine.
    """
    product = functools.partial(jnp.einsum, precision=jax.lax.Precision.HIGHEST)
    return product("nkp,nlp->nkl", columns, columns), product("nkp,np->nk", columns, residual)


def start_matrix(light: np.ndarray, pictures: np.ndarray, mask: np.ndarray, block: int = 8) -> np.ndarray:
    """(3, 3) colour matrix by least squares in linear light over means of blocks.

    Args:
        light: (N, H, W, 3) white-balanced camera RGB.
        pictures: (N, H, W, 3) encoded.
        mask: (N, H, W).
    """
    linear = srgb_to_linear(pictures)

    def means(a: np.ndarray) -> np.ndarray:
        n, h, w, c = a.shape
        a = a[:, : h // block * block, : w // block * block]
        return a.reshape(n, h // block, block, w // block, block, c).mean((2, 4)).reshape(-1, c)

    whole = means(mask[..., None].astype(np.float32))[:, 0] == 1
    return np.linalg.lstsq(means(light)[whole], means(linear)[whole], rcond=None)[0].T


def floor_difference(problem: Problem, files: Sequence[Jpeg | None]) -> np.ndarray:
    """(N, h, w, 3) what rounding and the file's own compression do to the simulator's pictures, in steps."""
    whole = problem.model.render(problem.z, problem.pairs.light)
    stored = np.stack([as_stored(p, f) for p, f in zip(whole, files)])
    return to_steps(stored[problem.inner]) - to_steps(whole[problem.inner])


def floor_errors(problem: Problem, difference: np.ndarray) -> np.ndarray:
    """(N,) the errors that rounding and compression would leave were the simulator right."""
    # weighed by its own size, as the real residual is by its own
    counted = problem.robust_weights(difference) * problem.pairs.mask[problem.inner]
    return (difference**2 * counted[..., None]).sum((1, 2, 3)) / counted.sum((1, 2))


def as_stored(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """(H, W, 3) encoded, as a file with this one's header would have it; rounded where that says nothing."""
    own = encoder_of(file)
    return np.round(255 * picture) / 255 if own is None else np.asarray(run(*own, picture))
