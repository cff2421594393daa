"""Scores: the energy of a residual that a model explains on scenes, or parts of scenes, held out of its fit.

Each score keeps sums by tile, so that sign flips of a tile's residual are cheap.

Shapes: D draws of signs, N pictures, T tiles in a picture, B = N T tiles in all; 3 channels Y'CbCr. Energies
are sums of squared 8-bit steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

_ROWS = 16
"""Features are padded to a multiple of this: each number of them is a program."""
_RIDGE = 30  # pixels; the ridge of every coefficient equals this many observations of 0


@dataclass(frozen=True)
class Tiles:
    """The tiles of all pictures; a random sign is drawn for each.

    Attributes:
        slices: row and column slices of the tiles of a picture, row by row, the same for all pictures.
        across: number of tiles side by side.
        folds: (folds, 2, B) bool, picture by picture: tiles used for fitting, and tiles that are scored.
    """

    slices: list[tuple[slice, slice]]
    across: int
    folds: np.ndarray

    @property
    def count(self) -> int:
        """Number B of tiles in all pictures."""
        return self.folds.shape[-1]

    def of_scene(self, signs: np.ndarray, scene: int) -> np.ndarray:
        """Signs (D, down, across) of one picture, out of all signs (D, B)."""
        own = signs[:, scene * len(self.slices) : (scene + 1) * len(self.slices)]
        return own.reshape(len(signs), -1, self.across)

    def around(self, sums: np.ndarray) -> np.ndarray:
        """Sums over the up to eight tiles around each tile; `sums` and the result are (B, ...)."""
        grid = sums.reshape(-1, len(self.slices) // self.across, self.across, *sums.shape[1:])
        padded = np.pad(grid, [(0, 0), (1, 1), (1, 1), *[(0, 0)] * (sums.ndim - 1)])
        across = padded[:, :, :-2] + padded[:, :, 1:-1] + padded[:, :, 2:]
        return (across[:, :-2] + across[:, 1:-1] + across[:, 2:] - grid).reshape(sums.shape)

    def by_picture(self, scores: np.ndarray) -> np.ndarray:
        """Sums (N, 3) over the tiles of each picture, from scores (B, 3)."""
        return np.asarray(scores.reshape(-1, len(self.slices), scores.shape[-1]).sum(1))


def cut(shape: Sequence[int], rng: np.random.Generator, scenes: np.ndarray, scored: int) -> Tiles:
    """Cut pictures into tiles on the 8x8 grid, and assign the tiles to folds.

    A tile has a sixth of the picture's sides, at least 32 px; it has 32 px if there is one scene.

    Args:
        shape: (N, h, w) of the pictures.
        rng: for the order of the folds.
        scenes: (N,) number of each picture's scene, from 0. Frames of one of several scenes share a fold.
        scored: number of leading pictures that are scored; the others are only used for fitting.
    """
    h, w = shape[1:3]
    n = scenes.max() + 1
    edges = []
    for size in (h, w):
        step = 32 if n == 1 else max(32, size // 6 // 8 * 8)
        starts = list(range(0, max(size - step, 0) + 1, step))
        edges.append([slice(a, b) for a, b in zip(starts, [*starts[1:], size])])
    slices = [(rows, columns) for rows in edges[0] for columns in edges[1]]
    groups = np.repeat(scenes, len(slices)) if n > 1 else np.tile(np.arange(len(slices)), len(scenes))
    counted = np.arange(len(groups)) < scored * len(slices)
    every, many = groups.max() + 1, groups[counted].max() + 1
    count = max(min(4, many), 1 if every > many else 2)  # at least one group must remain for fitting
    fold = np.concatenate([rng.permutation(many) % count, np.full(every - many, -1)])[groups]
    folds = [(fold != f, (fold == f) & counted) for f in range(count)]
    return Tiles(slices, len(edges[1]), np.stack(folds))


@dataclass(frozen=True)
class Explained:
    """Explained energies by channel for each draw of signs; draw 0 flips no sign.

    Attributes:
        own: (D, 3) energy explained beyond `known`.
        own_by: (N, 3) contribution of each picture to draw 0 of `own`, with the fit of the other folds.
        known: (D, 3) energy explained by simpler axes, or 0.
        known_by: (N, 3) contribution of each picture to draw 0 of `known`, or 0.
    """

    own: np.ndarray
    own_by: np.ndarray
    known: np.ndarray | float = 0.0
    known_by: np.ndarray | float = 0.0


_Sums = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Gram matrices, slopes and support of pictures, as `_by_picture` returns them."""
_Score = Callable[[int, Sequence[int], _Sums, _Sums], tuple[np.ndarray, np.ndarray]]


class Regression:
    """Least squares on features, with some features left to simpler axes.

    The first `given` features of each channel belong to simpler axes. Their coefficients are fitted to each
    picture separately. The energy that they explain does not count for this axis.

    Args:
        given: number of such features, by channel.
    """

    def __init__(self, given: Sequence[int] = (0, 0, 0)) -> None:
        self.given = given
        self._gram: list[np.ndarray] = []
        self._slope: list[np.ndarray] = []
        self._support: list[np.ndarray] = []

    def add(
        self, features: Sequence[np.ndarray], target: np.ndarray, weight: np.ndarray, tiles: Tiles
    ) -> None:
        """Add one picture: features and weight (h, w), target (h, w, 3)."""
        stacked, count = np.stack(features), len(features)
        planes = _by_tile(stacked, tiles, -(-count // _ROWS) * _ROWS)
        wanted = _by_tile(np.moveaxis(target, -1, 0), tiles, 3)
        sums = _sums(planes, wanted, _by_tile(weight[None], tiles, 1)[:, 0])
        gram, slope, support = (np.asarray(a, np.float64) for a in sums)
        self._gram += [*gram[:, :count, :count]]
        self._slope += [*slope[:, :count]]
        self._support += [*support[:, :count]]

    def explained(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy explained by the features beyond the first `given`, for signs (D, B)."""
        return self._summed(signs, tiles, _scored)

    def shared(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Like `explained`, with common coefficients of the first features for all pictures."""
        return self._summed(signs, tiles, _scored_alike)

    def _summed(self, signs: np.ndarray, tiles: Tiles, score: _Score) -> Explained:
        pictures = tiles.count // len(tiles.slices)
        kept = np.stack(self._gram), np.stack(self._slope), np.stack(self._support)
        own, known = np.zeros((2, len(signs), 3))
        own_by, known_by = np.zeros((2, pictures, 3))
        for learn, test in tiles.folds:
            learnt, scored = (_by_picture(*kept, signs, part, pictures) for part in (learn, test))
            for given in set(self.given):
                channels = [c for c, count in enumerate(self.given) if count == given]
                gain, before = score(given, channels, learnt, scored)
                own[:, channels] += gain.sum(1)
                own_by[:, channels] += gain[0]
                known[:, channels] += before.sum(1)
                known_by[:, channels] += before[0]
        return Explained(own, own_by, known, known_by)

    def nearby(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy of each tile explained by a fit to the tiles around it.

        The coefficients may vary over the frame. Energy that the first features explain does not count.
        """
        counted = signs.shape[1]
        gram, slope, support = (np.stack(a)[:counted] for a in (self._gram, self._slope, self._support))
        by_tile = np.zeros((len(signs), counted, 3))
        for given in set(self.given):
            channels = [c for c, count in enumerate(self.given) if count == given]
            left, beyond, _, seen = _beyond(given, channels, gram, slope[None], support)
            learnt = _solved(tiles.around(left), np.eye(left.shape[-1]), tiles.around(seen))
            for draw, row in enumerate(signs):
                own = row[:, None, None] * beyond[0]
                by_tile[draw][:, channels] = _gained(learnt @ tiles.around(own), left, own)
        return Explained(by_tile.sum(1), tiles.by_picture(by_tile[0]))


def _by_tile(planes: np.ndarray, tiles: Tiles, count: int) -> np.ndarray:
    """The pixels (T, count, P) of planes (K, h, w) in each tile; missing planes and pixels are 0."""
    pixels = [planes[:, rows, columns].reshape(len(planes), -1) for rows, columns in tiles.slices]
    found = np.zeros((len(pixels), count, max(p.shape[1] for p in pixels)), np.float32)
    for own, piece in zip(found, pixels):
        own[: piece.shape[0], : piece.shape[1]] = piece
    return found


@jax.jit
def _sums(features: jax.Array, target: jax.Array, weight: jax.Array) -> tuple[jax.Array, ...]:
    """Gram matrices (T, F, F), slopes (T, F, 3) and support (T, F) of (T, F, P), (T, 3, P) and (T, P).

    By XLA: OpenBLAS cuts such small products into threads, which wait by spinning.
    """
    exact, weighted = jax.lax.Precision.HIGHEST, features * weight[:, None]
    return (
        jnp.einsum("tfp,tgp->tfg", features, weighted, precision=exact),
        jnp.einsum("tfp,tcp->tfc", weighted, target, precision=exact),
        jnp.einsum("tp,tfp->tf", weight, (features != 0).astype(weight.dtype), precision=exact),
    )


def _scored(
    given: int, channels: Sequence[int], learnt: _Sums, scored: _Sums
) -> tuple[np.ndarray, np.ndarray]:
    """Energies (D, P, C) of the scored tiles, explained by the last features and by the first `given`.

    The last features are fitted to `learnt`; the first are fitted to each scored picture.
    """
    gram, slope, _, support = _beyond(given, channels, *learnt)
    found = _solved(gram.sum(0), slope.sum(1), support.sum(0))
    gram, slope, before, _ = _beyond(given, channels, *scored)
    return _gained(found[:, None], gram, slope), before


def _scored_alike(
    given: int, channels: Sequence[int], learnt: _Sums, scored: _Sums
) -> tuple[np.ndarray, np.ndarray]:
    """Like `_scored`, with the first `given` features fitted to `learnt` too."""
    gram, slope, support = (a.sum(axis) for a, axis in zip(learnt, (0, 1, 0)))
    gains = []
    for count in (given, len(gram)):
        found = _solved(gram[:count, :count], slope[:, :count][..., channels], support[:count])
        own = scored[0][:, :count, :count], scored[1][:, :, :count][..., channels]
        gains.append(_gained(found[:, None], *own))
    return gains[1] - gains[0], gains[0]


def _by_picture(
    gram: np.ndarray,
    slope: np.ndarray,
    support: np.ndarray,
    signs: np.ndarray,
    part: np.ndarray,
    pictures: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum the tiles of a part by picture: Gram matrices (P, F, F), slopes (D, P, F, 3), support (P, F)."""
    counts = part.astype(float).reshape(pictures, -1)
    signed = signs.reshape(len(signs), pictures, -1) * counts
    gram, slope, support = (a.reshape(*counts.shape, *a.shape[1:]) for a in (gram, slope, support))
    slopes = signed.swapaxes(0, 1) @ slope.reshape(*counts.shape, -1)
    slopes = slopes.swapaxes(0, 1).reshape(len(signs), pictures, -1, 3)
    return np.einsum("pt,ptij->pij", counts, gram), slopes, np.einsum("pt,pti->pi", counts, support)


def _beyond(
    given: int, channels: Sequence[int], gram: np.ndarray, slope: np.ndarray, support: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project the first `given` features out of the others, picture by picture.

    Returns:
        of the U other features: Gram matrices (P, U, U) and slopes (D, P, U, C); then the energies (D, P, C)
        that the first features explain; then the support (P, U) of the others.
    """
    slope = slope[..., channels]
    if not given:
        return gram, slope, np.zeros((*slope.shape[:2], len(channels))), support
    inner, across = gram[:, :given, :given], gram[:, :given, given:]
    known = _solved(inner, slope[:, :, :given], support[:, :given])
    shared = _solved(inner, across, support[:, :given])
    back = across.swapaxes(1, 2)
    before = _gained(known, inner, slope[:, :, :given])
    left = gram[:, given:, given:] - back @ shared
    return left, slope[:, :, given:] - back @ known, before, support[:, given:]


def _solved(gram: np.ndarray, slope: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Ridge regression: coefficients (..., F, C) of Gram matrices (F, F) or (P, F, F)."""
    diagonal = np.einsum("...ff->...f", gram) + 1e-12
    ridge = diagonal * (1e-5 + _RIDGE / (support + _RIDGE))
    return np.linalg.solve(gram + ridge[..., None] * np.eye(gram.shape[-1]), slope)


def _gained(found: np.ndarray, gram: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Energy (..., C) that the coefficients explain."""
    return np.asarray((found * (2 * slope - gram @ found)).sum(-2))


class Bins:
    """A mean, or a slope, for each of K bins.

    Args:
        coarser: (K,) index of the coarser bin that contains each bin. Energy that the coarser bins explain is
            `known`. Default: no coarser bins.
    """

    def __init__(self, coarser: np.ndarray | None = None) -> None:
        self._merge = None if coarser is None else np.eye(coarser.max() + 1)[:, coarser]
        self._sums: list[np.ndarray] = []
        self._counts: list[np.ndarray] = []

    def add(self, sums: np.ndarray, counts: np.ndarray) -> None:
        """Add one tile: sums (K, 3) of target times feature, and sums (K, 3) of the squared feature."""
        self._sums.append(sums)
        self._counts.append(counts)

    def explained(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy explained by the bins beyond the coarser bins, for signs (D, B)."""
        sums, counts = np.stack(self._sums), np.stack(self._counts)
        total, total_by = _gain(signs, sums, counts, tiles)
        if self._merge is None:
            return Explained(total, total_by)
        known, known_by = _gain(signs, self._merge @ sums, self._merge @ counts, tiles)
        return Explained(total - known, total_by - known_by, known, known_by)


def _gain(
    signs: np.ndarray, sums: np.ndarray, counts: np.ndarray, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Explained energy (D, 3) by draw, and that of draw 0 by picture (N, 3)."""
    total, by_tile = np.zeros((len(signs), 3)), np.zeros((len(sums), 3))
    for learn, test in tiles.folds:
        learnt, scored = (np.tensordot(signs[:, part], sums[part], 1) for part in (learn, test))
        mean = learnt / (counts[learn].sum(0) + _RIDGE)
        total += (mean * (2 * scored - counts[test].sum(0) * mean)).sum(1)
        by_tile[test] = (mean[0] * (2 * sums[test] - counts[test] * mean[0])).sum(1)
    return total, tiles.by_picture(by_tile)


class Lines:
    """Offsets of rows: one half of a row predicts the other half, beyond the mean of 8 rows.

    The halves are the even and the odd tiles along the row.
    """

    def __init__(self) -> None:
        self._scenes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, target: np.ndarray, weight: np.ndarray, rows: np.ndarray, columns: Sequence[slice]) -> None:
        """Add one picture: target (h, w, 3), weight (h, w).

        Args:
            target: (h, w, 3) residual.
            weight: (h, w) weight of each pixel.
            rows: (h,) index of the tile row that contains each row.
            columns: column slices of the tiles.
        """
        weighted = target * weight[..., None]
        sums = np.stack([weighted[:, c].sum(1) for c in columns], 1)
        counts = np.stack([weight[:, c].sum(1) for c in columns], 1)
        self._scenes.append((sums.astype(np.float64), counts.astype(np.float64), rows))

    def explained(self, signs: np.ndarray, tiles: Tiles, *, transposed: bool = False) -> Explained:
        """Energy explained by offsets of rows, for signs (D, B).

        `transposed`: the pictures were added transposed, so that columns are measured.
        """
        total, by_picture = np.zeros((len(signs), 3)), []
        for scene, (sums, counts, rows) in enumerate(self._scenes):
            own = tiles.of_scene(signs, scene)
            own = (own.swapaxes(1, 2) if transposed else own)[:, rows]
            halves = [(own[:, :, i::2, None] * sums[:, i::2]).sum(2) for i in (0, 1)]
            pixels = [counts[:, i::2].sum(1)[:, None] for i in (0, 1)]
            starts = np.arange(0, len(rows), 8)
            coarse = [np.add.reduceat(a, starts, axis=-2) for a in (*halves, *pixels)]
            gain = _half_gain(*halves, *pixels) - _half_gain(*coarse)
            total += gain
            by_picture.append(gain[0])
        return Explained(total, np.stack(by_picture))


def _half_gain(a: np.ndarray, b: np.ndarray, pixels_a: np.ndarray, pixels_b: np.ndarray) -> np.ndarray:
    mean_a, mean_b = a / (pixels_a + _RIDGE), b / (pixels_b + _RIDGE)
    return (mean_a * (2 * b - pixels_b * mean_a) + mean_b * (2 * a - pixels_a * mean_b)).sum(1)


class Repeated:
    """Fixed pattern: the mean product of the residuals of two scenes.

    Args:
        scenes: (N,) number of each picture's scene.
    """

    def __init__(self, scenes: np.ndarray) -> None:
        self._apart = np.not_equal.outer(scenes, scenes)
        self._scenes: list[np.ndarray] = []

    def add(self, detail: np.ndarray) -> None:
        """Add one picture (h, w, 3); masked pixels are 0."""
        self._scenes.append(detail)

    def products(self, tiles: Tiles) -> np.ndarray:
        """Sums (T, 3, N, N) of the products of two pictures in each tile."""
        return np.stack([self._tile(rows, columns) for rows, columns in tiles.slices])

    def _tile(self, rows: slice, columns: slice) -> np.ndarray:
        flat = np.stack([d[rows, columns].reshape(-1, 3).T for d in self._scenes], 1)
        return (flat @ flat.swapaxes(1, 2)).astype(np.float64)

    def explained(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy explained by the pattern of the other scenes, for signs (D, N T)."""
        others = self._apart.sum(1, keepdims=True)
        products = self.products(tiles) * (self._apart / np.maximum(others, 1))
        own = signs.reshape(len(signs), len(others), -1)
        total = np.einsum("dit,tcij,djt->dc", own, products, own, optimize=True)
        return Explained(total, self._by_picture(products.sum(0)))

    @staticmethod
    def _by_picture(products: np.ndarray) -> np.ndarray:
        """Contribution (N, 3) of each picture to the sum of products (3, N, N), for the bootstrap.

        A product changes with the number of times that either picture is drawn. Each picture therefore gets
        all its products; half their mean is subtracted to keep the total.
        """
        twice = products.sum(1) + products.sum(2)
        return np.asarray((twice - twice.mean(1, keepdims=True) / 2).T)


class Changing:
    """Offset of a whole frame from the mean of its scene's frames.

    It is fitted on one half of the tiles, as on a chessboard, and scored on the other.

    Args:
        scenes: (N,) number of each picture's scene.
    """

    def __init__(self, scenes: np.ndarray) -> None:
        same = np.equal.outer(scenes, scenes).astype(float)
        self._apart = np.eye(len(same)) - same / same.sum(1, keepdims=True)
        self.repeated = bool(self._apart.any())
        self._sums: list[np.ndarray] = []
        self._counts: list[np.ndarray] = []

    def add(self, residual: np.ndarray, weight: np.ndarray, tiles: Tiles) -> None:
        """Add one frame: residual (h, w, 3), weight (h, w)."""
        weighted = residual * weight[..., None]
        self._sums.append(np.stack([weighted[t].sum((0, 1), dtype=np.float64) for t in tiles.slices]))
        self._counts.append(np.array([weight[t].sum(dtype=np.float64) for t in tiles.slices]))

    def means(self) -> np.ndarray:
        """Mean offset (N, 3) of each frame from its scene's mean, 8-bit steps."""
        counts = np.stack(self._counts).sum(1, keepdims=True)
        return np.asarray(self._apart @ (np.stack(self._sums).sum(1) / (counts + _RIDGE)))

    def explained(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy explained by offsets of whole frames, for signs (D, N T)."""
        sums, counts = np.stack(self._sums), np.stack(self._counts)
        own = signs.reshape(len(signs), *counts.shape)
        rows, columns = np.divmod(np.arange(counts.shape[1]), tiles.across)
        means, sizes = [], []
        for half in (0, 1):
            part = (rows + columns) % 2 == half
            sizes.append(counts[:, part].sum(1)[:, None])
            total = np.einsum("dnt,ntc->dnc", own[..., part], sums[:, part])
            means.append(self._apart @ (total / (sizes[-1] + _RIDGE)))
        gains = [sizes[1 - k] * means[k] * (2 * means[1 - k] - means[k]) for k in (0, 1)]
        return Explained(np.sum(gains, (0, 2)), np.sum([gain[0] for gain in gains], 0))


class Tail:
    """Energy beyond five robust standard deviations, where a Gaussian has almost none."""

    LIMIT = 5.0
    _USUAL = 1.2e-6  # share of a Gaussian's samples beyond the limit, if its deviation is wrong by 3 %

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._energies: list[tuple[int, np.ndarray]] = []
        self._one = np.zeros(3)
        self._expected = np.zeros(3)

    def add(self, values: np.ndarray, scale: np.ndarray, picture: int) -> None:
        """Add one tile.

        Args:
            values: (P, 3) detail of the residual in flat areas.
            scale: (3,) robust standard deviations.
            picture: index of the tile's picture.
        """
        far = np.abs(values) > self.LIMIT * scale
        self._energies.append((picture, (values**2 * far).sum(0)))
        self._one = np.maximum(self._one, (self.LIMIT * scale) ** 2)
        self._expected += self._USUAL * len(values)

    def explained(self, signs: np.ndarray, tiles: Tiles) -> Explained:
        """Energy beyond the limit; the null draws are Poisson counts of a Gaussian, so signs only give D."""
        draws = self._rng.poisson(self._expected, (len(signs), 3)) * self._one
        draws[0] = 0
        by_picture = np.zeros((tiles.count // len(tiles.slices), 3))
        for picture, energy in self._energies:
            draws[0] += energy
            by_picture[picture] += energy
        return Explained(draws, by_picture)
