"""Pairs made ready: aligned, split into tiles to fit and tiles to report, and the tiles that are fitted."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import LUMA_601
from jaxisp.errors import InputError
from jaxisp.fit import model, noise
from jaxisp.fit.align import Alignment
from jaxisp.fit.lens import STRAIGHT, Lens, covered
from jaxisp.fit.pair import Example, align, balanced, demosaicker
from jaxisp.fit.raw_noise import RawNoise, raw_noise
from jaxisp.fit.sharing import as_arrays
from jaxisp.fit.strips import in_strips
from jaxisp.io import Jpeg
from jaxisp.losses import border_mask, clip_mask
from jaxisp.pipeline import Chain, over_batch, run_batch, stage
from jaxisp.process.programs import QUICK

TILE = 64
HALO = 16  # px around a tile that the filters see: bilateral 8, median 2, unsharp mask 6
SIDE = TILE + 2 * HALO
MARGIN = 8  # more of the mosaic, for the warp and the demosaicker
SOURCE = SIDE + 2 * MARGIN
TILES = 4  # of one pair, in one call
BORDER = 8
HOW = f"a checkerboard of {TILE}x{TILE} tiles: half are fitted, the other half reported"
_PAD = 48


class Chunk(NamedTuple):
    """Tiles of one pair, TILES of them; unused ones have an empty mask.

    Args:
        source: (T, SOURCE, SOURCE) balanced mosaic, or with a last axis camera RGB.
        target: (T, TILE, TILE, 3).
        mask: (T, TILE, TILE).
        place: (T, 4): rows and columns of the first pixel from the centre of the picture, and of the
            source from the centre of the RAW.
        corner: squared distance of the RAW's corners from its centre.
        flat, edges: of `noise.Regions`, per tile.
    """

    source: Any
    target: Any
    mask: Any
    place: Any
    corner: Any
    flat: Any
    edges: Any


@dataclasses.dataclass(frozen=True)
class Shot:
    """One pair, ready to be fitted: its tiles and where it lies.

    `jpeg` is what its file states, without the pixels, which would fill the memory where pairs are many.
    """

    name: str
    cfa: str
    alignment: Alignment
    chunks: tuple[Chunk, ...]
    jpeg: Jpeg | None
    orientation: int = 1
    notes: tuple[str, ...] = ()
    sensor_noise: RawNoise | None = None
    """Of the sensor, stated by the RAW or measured in it."""
    lens: Lens = STRAIGHT
    """The distortion that the alignment found."""

    @property
    def geometry(self) -> np.ndarray:
        """Shift and scale as the alignment found them."""
        a = self.alignment
        return np.asarray([a.dy, a.dx, a.scale_y, a.scale_x], np.float32)


class Split(NamedTuple):
    """(H, W) boolean masks of the pixels that are fitted and of those that are reported."""

    fitted: np.ndarray
    held_out: np.ndarray


def with_source(chunk: Chunk, cfa: str, design: model.Design, *, once: bool = False) -> Chunk:
    """The chunk with its mosaic demosaicked; `once`: by programs that are soon compiled, and slow.

    These are one a demosaicker and one a pass of medians, which mixes and more passes share.
    """
    mosaics = jnp.asarray(chunk.source)
    if not once:
        shares = as_arrays(model.shares(design))
        return chunk._replace(source=run_batch(demosaicker(cfa, design), shares, mosaics))
    source = _once(demosaicker(cfa, model.Design(design.demosaic)), mosaics)
    if design.mixed is not None:
        name, share = design.mixed
        source += share * (_once(demosaicker(cfa, model.Design(name)), mosaics) - source)
    for _ in range(design.passes):
        source = _once(Chain((stage("color_difference_median"),), "medians"), source)
    return chunk._replace(source=source)


@functools.partial(jax.jit, static_argnums=0, compiler_options=QUICK)
def _once(chain: Chain, images: jax.Array) -> jax.Array:
    return over_batch(chain, {}, images, None)


# operation by operation they take longer to compile
_border_mask = jax.jit(border_mask, static_argnums=(0, 1), compiler_options=QUICK)
_clip_mask = jax.jit(clip_mask, static_argnums=(1, 2), compiler_options=QUICK)


def split(
    target: np.ndarray, alignment: Alignment, raw_shape: tuple[int, ...], lens: Lens = STRAIGHT
) -> Split:
    """A checkerboard of tiles. Clipped pixels are not fitted: they say only that a scene was brighter."""
    border = np.asarray(_border_mask(target.shape[:2], BORDER))
    inside = covered(alignment, lens, raw_shape, target.shape) & border
    unclipped = in_strips(lambda part: np.asarray(_clip_mask(part, 2 / 255, 253 / 255)), target)
    row, column = (np.arange(n) // TILE for n in target.shape[:2])
    even = (row[:, None] + column) % 2 == 0
    return Split(inside & unclipped & even, inside & ~even)


def prepare(example: Example, most: int = 32) -> Shot:
    """Align a pair and take the tiles that are fitted, at most `most` of them.

    Raises:
        InputError: the pair cannot be fitted.
    """
    example, alignment, lens, orientation, notes = align(example)
    masks = split(example.picture, alignment, example.raw.mosaic.shape, lens)
    if not masks.fitted.any() or not masks.held_out.any():
        raise InputError(
            f"{example.name}: nothing to fit: pictures are smaller than two tiles, or all clipped"
        )
    corners = _choose(example.picture, masks.fitted, most)
    mosaic = padded(example)
    tiles = [_tile(example, mosaic, alignment, lens, masks.fitted, corner) for corner in corners]
    flat = _regions(example.picture, masks.fitted)
    cuts = [_cut(flat, corner) for corner in corners]
    chunks = tuple(_chunks(tiles, cuts, _corner(example.raw.mosaic.shape)))
    sensor_noise = raw_noise(example.raw)
    jpeg = example.jpeg and dataclasses.replace(example.jpeg, pixels=np.empty((0, 0, 3), np.uint8))
    return Shot(
        example.name, example.raw.cfa, alignment, chunks, jpeg, orientation, notes, sensor_noise, lens
    )


def halved(shot: Shot) -> tuple[Shot, Shot]:
    """The left and the right half of a shot's tiles.

    Raises:
        InputError: one of them has nothing to fit.
    """
    stacked = Chunk(*(np.concatenate([np.atleast_1d(p) for p in part]) for part in zip(*shot.chunks)))
    columns = stacked.place[:, 1, None] + HALO + np.arange(TILE)
    halves = []
    for inside in (columns < 0, columns >= 0):
        mask = stacked.mask * inside[:, None]
        edges = stacked.edges * inside[:, None]
        flat = stacked.flat * inside.reshape(len(inside), 1, 1, -1, noise.BLOCK).all(-1)
        kept = np.flatnonzero(mask.any(axis=(1, 2)))
        if not len(kept):
            raise InputError(f"{shot.name}: one half has nothing to fit")
        tiles = [(stacked.source[i], stacked.target[i], mask[i], stacked.place[i]) for i in kept]
        chunks = _chunks(tiles, [(flat[i], edges[i]) for i in kept], stacked.corner[0])
        halves.append(dataclasses.replace(shot, chunks=tuple(chunks)))
    return halves[0], halves[1]


def padded(example: Example) -> np.ndarray:
    """The balanced mosaic with what lies beyond its border."""
    return np.pad(balanced(example.raw), _PAD, mode="reflect")


def blank(example: Example, mosaic: np.ndarray, shot: Shot, corners: Sequence[tuple[int, int]]) -> Chunk:
    """Tiles that are only to be rendered: nothing in them is fitted."""
    nowhere = np.zeros(example.picture.shape[:2], bool)
    tiles = [_tile(example, mosaic, shot.alignment, shot.lens, nowhere, corner) for corner in corners]
    rows = TILE // noise.BLOCK
    empty = np.zeros((noise.BINS, rows, rows), np.float32), np.zeros((TILE, TILE), np.float32)
    return next(_chunks(tiles, [empty] * len(tiles), _corner(example.raw.mosaic.shape)))


def no_chunk() -> Chunk:
    """One of zeros, demosaicked."""
    rows = TILE // noise.BLOCK
    shapes = (
        (SOURCE, SOURCE, 3), (TILE, TILE, 3), (TILE, TILE), (4,), (), (noise.BINS, rows, rows), (TILE, TILE)
    )  # fmt: skip
    source, target, mask, place, _, flat, edges = (np.zeros((TILES, *s), np.float32) for s in shapes)
    return Chunk(source, target, mask, place, np.float32(1), flat, edges)


def _choose(target: np.ndarray, fitted: np.ndarray, most: int) -> list[tuple[int, int]]:
    """Corners of the tiles to fit: all, or those that spread widest over brightness, detail and radius."""
    h, w = target.shape[:2]
    grid = [(y, x) for y in range(0, h, TILE) for x in range(0, w, TILE) if (y // TILE + x // TILE) % 2 == 0]
    shares = [fitted[y : y + TILE, x : x + TILE].sum() / TILE**2 for y, x in grid]
    grid = [corner for corner, share in zip(grid, shares) if share > 0.15] or [grid[int(np.argmax(shares))]]
    if len(grid) <= most:
        return grid
    luma = [target[y : y + TILE, x : x + TILE] @ np.asarray(LUMA_601, np.float32) for y, x in grid]
    detail = [np.abs(np.diff(tile, axis=0)).mean() + np.abs(np.diff(tile, axis=1)).mean() for tile in luma]
    radius = [np.hypot(y - h / 2, x - w / 2) for y, x in grid]
    features = np.stack([np.argsort(np.argsort(f)) for f in ([t.mean() for t in luma], detail, radius)], 1)
    chosen = [int(features[:, 0].argmin())]
    distance = np.full(len(grid), np.inf)
    for _ in range(most - 1):  # always the one that is least like those chosen
        distance = np.minimum(distance, np.abs(features - features[chosen[-1]]).sum(1))
        chosen.append(int(distance.argmax()))
    return [grid[i] for i in chosen]


def _tile(
    example: Example,
    mosaic: np.ndarray,
    alignment: Alignment,
    lens: Lens,
    fitted: np.ndarray,
    corner: tuple[int, int],
) -> tuple[np.ndarray, ...]:
    """(source, target, mask, place) of one tile."""
    y, x = corner
    center = (np.asarray(example.picture.shape[:2]) - 1) / 2
    raw_center = (np.asarray(example.raw.mosaic.shape) - 1) / 2
    first = np.asarray(corner) - HALO - center  # of the rendered tile, from the picture's centre
    scale = np.asarray([alignment.scale_y, alignment.scale_x], float)
    shift = np.asarray([alignment.dy, alignment.dx], float)
    middle = scale * (first + (SIDE - 1) / 2) + shift
    middle = raw_center + np.asarray(lens.bent(middle[0], middle[1], float((raw_center**2).sum())))
    origin = 2 * np.round((middle - (SOURCE - 1) / 2) / 2).astype(int)  # keeps the phase of the mosaic
    limit = np.asarray(mosaic.shape) - SOURCE - _PAD
    origin = np.clip(origin, -_PAD, limit - limit % 2)
    top, left = origin + _PAD
    source = mosaic[top : top + SOURCE, left : left + SOURCE]
    target, mask = np.zeros((TILE, TILE, 3), np.float32), np.zeros((TILE, TILE), np.float32)
    part = example.picture[y : y + TILE, x : x + TILE]
    target[: part.shape[0], : part.shape[1]] = part
    mask[: part.shape[0], : part.shape[1]] = fitted[y : y + TILE, x : x + TILE]
    return source, target, mask, np.concatenate([first, origin - raw_center]).astype(np.float32)


def _regions(target: np.ndarray, mask: np.ndarray) -> noise.Regions:
    """Regions of a whole picture, filled up to whole tiles."""
    found = noise.regions(target, mask)
    fill = [-(-n // TILE) * TILE for n in target.shape[:2]]
    edges = np.pad(found.edges, [(0, f - n) for f, n in zip(fill, found.edges.shape)])
    rows = [f // noise.BLOCK for f in fill]
    flat = np.pad(found.flat, [(0, 0), *((0, r - n) for r, n in zip(rows, found.flat.shape[1:]))])
    return noise.Regions(flat, edges, found.levels)


def _cut(found: noise.Regions, corner: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    y, x = corner
    per = TILE // noise.BLOCK
    top, left = y // noise.BLOCK, x // noise.BLOCK
    return found.flat[:, top : top + per, left : left + per], found.edges[y : y + TILE, x : x + TILE]


def _corner(raw_shape: tuple[int, ...]) -> np.float32:
    """Of `Chunk.corner`."""
    return np.float32(sum((n - 1) ** 2 for n in raw_shape) / 4)


def _chunks(tiles: list[Any], cuts: list[Any], corner: np.float32) -> Iterator[Chunk]:
    """The tiles in groups of one size, dealt out so that each group is like the whole."""
    count = -(-len(tiles) // TILES)
    for first in range(count):
        group = list(zip(tiles, cuts))[first::count]
        arrays = [np.stack(part) for part in zip(*[(*tile, *cut) for tile, cut in group])]
        short = TILES - len(group)
        source, target, mask, place, flat, edges = (
            np.concatenate([a, a[:1].repeat(short, 0)]) for a in arrays
        )
        if short:
            mask[-short:], flat[-short:], edges[-short:] = 0, 0, 0
        yield Chunk(source, target, mask, place, corner, flat, edges)
