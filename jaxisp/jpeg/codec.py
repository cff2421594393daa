"""What libjpeg does to pixels, in JAX: integer colour, chroma sampling, DCT and quantisation.

Values are exact integers held in floats of at least 32 bits, and sums stay below 2**24 there; how the
transforms hold theirs is told in `jpeg_blocks`. Each step pairs libjpeg's integer arithmetic with
a smooth surrogate for the gradient.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.extents import Extent, clamped, clamped_rows
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.safe_math import clip, straight_through
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.jpeg.blocks import fixed, shifted, through_blocks

SAMPLING = {"4:4:4": (1, 1), "4:2:2": (1, 2), "4:2:0": (2, 2)}
"""Luma samples per chroma sample, (vertical, horizontal)."""

Planes = tuple[jax.Array, jax.Array, jax.Array]


def rgb_to_ycbcr(rgb: Planes) -> Planes:
    """Whole-numbered R'G'B' planes in 0..255 to Y'CbCr with chroma about 128 (16-bit fixed point)."""
    r, g, b = rgb
    half, centre = 1 << 15, (128 << 16) + (1 << 15) - 1
    # centre + half * 255 is 2**24 - 1, so the sums are exact
    hard = (
        fixed(0.299) * r + fixed(0.587) * g + fixed(0.114) * b + half,
        (half * b + centre) - fixed(0.16874) * r - fixed(0.33126) * g,
        (half * r + centre) - fixed(0.41869) * g - fixed(0.08131) * b,
    )
    y, cb, cr = rgb_to_ycbcr_planes(*rgb)
    soft = (y, cb + 128, cr + 128)
    y, cb, cr = (straight_through(shifted(h, 16), s) for h, s in zip(hard, soft))
    return y, cb, cr


def ycbcr_to_rgb(y: jax.Array, cb: jax.Array, cr: jax.Array) -> Planes:
    """The way back, clipped to 0..255."""
    half, u, v = 1 << 15, cb - 128, cr - 128
    shifts = (
        shifted(fixed(1.402) * v + half, 16),
        shifted(half - fixed(0.34414) * u - fixed(0.71414) * v, 16),
        shifted(fixed(1.772) * u + half, 16),
    )
    soft = ycbcr_to_rgb_planes(y, u, v)
    r, g, b = (straight_through(jnp.clip(y + d, 0, 255), clip(s, 0, 255)) for d, s in zip(shifts, soft))
    return r, g, b


def _lower(plane: jax.Array, rows: int) -> jax.Array:
    """With the last row repeated below so many times."""
    return jnp.pad(plane, ((0, rows), (0, 0)), mode="edge") if rows else plane


def _wider(plane: jax.Array, last: jax.Array, columns: int) -> jax.Array:
    """With a column, (H, 1), so many times on the right."""
    if not columns:
        return plane
    width = plane.shape[1]

    def joined(_: None, parts: tuple[jax.Array, jax.Array]) -> jax.Array:
        plane, last = parts
        # selected, as XLA's CPU code takes two to three times as long to join columns
        wide = jnp.pad(plane, ((0, 0), (0, columns)))
        return jnp.where(np.arange(width + columns) < width, wide, last)

    def split(_: None, wide: jax.Array) -> tuple[jax.Array, jax.Array]:
        return wide[:, :width], wide[:, width:].sum(1, keepdims=True)

    return linear_call(joined, split, None, (plane, last))


def downsample(plane: jax.Array, step: tuple[int, int], extent: Extent | None = None) -> jax.Array:
    """Box means over `step`, then padded to whole blocks, as the encoder does it.

    The bias of the rounding alternates by column. Columns are padded before the mean, rows after it. Beyond
    the extent of a picture that is a part of the plane this padding goes on.
    """
    sy, sx = step
    if extent is not None:
        plane = clamped(plane, extent)
    height, width = plane.shape
    rows, columns = -(-height // sy), -(-width // (8 * sx)) * 8
    plane = _lower(plane, rows * sy - height)
    # the sums of the padding, in which the plane's last column stands sx times
    last, whole = sx * _sums(plane[:, -1:], (sy, 1)), width // sx
    total = _wider(_sums(plane[:, : whole * sx], step), last, columns - whole)
    if step != (1, 1):
        bias = np.arange(columns) % 2 + (1 if sy == 2 else 0)
        hard = shifted(total + bias.astype(plane.dtype)[None], sy * sx // 2)
        total = straight_through(hard, total / (sy * sx))
    if extent is not None and sy > 1:
        total = clamped_rows(total, extent.over(step).height)
    return _lower(total, -rows % 8)


# Sampling is linear but for its rounding. The transposes are written as reads: autodiff would pad each slice.


def _sums(plane: jax.Array, step: tuple[int, int]) -> jax.Array:
    return linear_call(partial(_box_sums, step), partial(_repeated, step), None, plane)


def _box_sums(step: tuple[int, int], _: None, plane: jax.Array) -> jax.Array:
    sy, sx = step
    return functools.reduce(jnp.add, [plane[i::sy, j::sx] for i in range(sy) for j in range(sx)])


def _repeated(step: tuple[int, int], _: None, plane: jax.Array) -> jax.Array:
    for axis, count in enumerate(step):
        plane = _interleave(plane, plane, axis) if count == 2 else plane
    return plane


def upsample(
    plane: jax.Array, shape: tuple[int, ...], step: tuple[int, int], extent: Extent | None = None
) -> jax.Array:
    """Triangle ("fancy") interpolation by `step`, cropped to `shape`; narrow planes are repeated.

    A picture that is a part of the plane ends where its extent does, and is not narrow.
    """
    sy, sx = step
    plane = plane[: -(-shape[0] // sy), : -(-shape[1] // sx)]  # block padding takes no part
    if step == (1, 1):
        return plane
    if plane.shape[1] <= 2:
        return jnp.repeat(jnp.repeat(plane, sy, 0), sx, 1)[: shape[0], : shape[1]]
    if extent is not None:
        plane = clamped(plane, extent.over(step))
    total = linear_call(partial(_triangles, step), partial(_triangles_transposed, step), None, plane)
    (even, odd), bits = ((8, 7), 4) if sy == 2 else ((1, 2), 2)
    bias = np.where(np.arange(total.shape[1]) % 2, odd, even).astype(plane.dtype)
    return straight_through(shifted(total + bias[None], bits), total / 2**bits)[: shape[0], : shape[1]]


def _triangles(step: tuple[int, int], _: None, plane: jax.Array) -> jax.Array:
    """3 of the nearer and 1 of the farther sample along each axis that is doubled, the cheaper one last."""
    for axis in (1, 0):
        if step[axis] == 2:
            plane = materialize(plane)
            before, after = (3 * plane + _moved(plane, by, axis) for by in (1, -1))
            plane = _interleave(before, after, axis)
    return plane


def _moved(plane: jax.Array, by: int, axis: int) -> jax.Array:
    """By one place forwards or backwards; the end that is left stays as it was."""
    index = lax.broadcasted_iota(jnp.int32, plane.shape, axis)
    end = 0 if by > 0 else plane.shape[axis] - 1
    pads = [(by, -by, 0) if a == axis else (0, 0, 0) for a in range(2)]
    return jnp.where(index == end, plane, lax.pad(plane, np.zeros((), plane.dtype), pads))


def _triangles_transposed(step: tuple[int, int], _: None, plane: jax.Array) -> jax.Array:
    for axis, count in enumerate(step):
        if count == 2:
            near = jnp.pad(plane, [(1, 1) if a == axis else (0, 0) for a in range(2)], mode="edge")
            n = plane.shape[axis]
            a, b, c, d = (lax.slice_in_dim(near, k, k + n - 1, stride=2, axis=axis) for k in range(4))
            plane = lax.optimization_barrier(a + 3 * (b + c) + d)
    return plane


def _interleave(a: jax.Array, b: jax.Array, axis: int) -> jax.Array:
    shape = list(a.shape)
    shape[axis] *= 2
    # stored, as a CPU's code would not be vectorised for the shape that comes next
    return materialize(jnp.stack([a, b], axis + 1)).reshape(shape)


def compress(
    rgb: Planes,
    luma_table: jax.Array,
    chroma_table: jax.Array,
    subsampling: str,
    extent: Extent | None = None,
) -> Planes:
    """Planes of whole numbers in 0..255 through JPEG and back; where one is NaN, all come back so.

    The three planes go through the transform as one array, chroma below luma.

    Args:
        rgb: three (H, W) planes.
        luma_table: (8, 8) whole numbers in 1..255.
        chroma_table: likewise.
        subsampling: a key of `SAMPLING`.
        extent: of the picture, where the planes are larger.
    """
    step = SAMPLING[subsampling]
    pack = partial(_pack, step=step, extent=extent)
    unpack = partial(_unpack, shape=rgb[0].shape, step=step, extent=extent)
    return _compress(rgb, luma_table, chroma_table, pack, unpack, extent)


def compress_full_or_half(
    rgb: Planes,
    luma_table: jax.Array,
    chroma_table: jax.Array,
    full: jax.Array,
    extent: Extent | None = None,
) -> Planes:
    """`compress` by 4:4:4 where `full`, else by 4:2:0, for little more than 4:4:4 takes.

    The smaller planes of chroma take a part of the larger ones' place in the transform.
    """
    whole, half = SAMPLING["4:4:4"], SAMPLING["4:2:0"]
    shape = rgb[0].shape
    rows = -(-shape[0] // 16) * 8  # of chroma in 4:2:0

    def pack(cb: jax.Array, cr: jax.Array) -> jax.Array:
        few, many = _pack(cb, cr, half, extent), _pack(cb, cr, whole, extent)
        few = jnp.pad(few, ((0, len(many) - len(few)), (0, 0)))
        return jnp.where(full, _wider(many, many[:, -1:], few.shape[1] - many.shape[1]), few)

    def unpack(coded: jax.Array) -> list[jax.Array]:
        many, few = _unpack(coded, shape, whole, extent), _unpack(coded[:rows], shape, half, extent)
        return [jnp.where(full, m, f) for m, f in zip(many, few)]

    return _compress(rgb, luma_table, chroma_table, pack, unpack, extent)


def _pack(cb: jax.Array, cr: jax.Array, step: tuple[int, int], extent: Extent | None) -> jax.Array:
    """Two planes half as wide side by side, others one below the other."""
    return jnp.concatenate([downsample(c, step, extent) for c in (cb, cr)], step[1] - 1)


def _unpack(
    coded: jax.Array, shape: tuple[int, ...], step: tuple[int, int], extent: Extent | None
) -> list[jax.Array]:
    return [upsample(c, shape, step, extent) for c in jnp.split(coded, 2, step[1] - 1)]


def _compress(
    rgb: Planes,
    luma_table: jax.Array,
    chroma_table: jax.Array,
    pack: Callable[[jax.Array, jax.Array], jax.Array],
    unpack: Callable[[jax.Array], Sequence[jax.Array]],
    extent: Extent | None,
) -> Planes:
    shape = rgb[0].shape
    y, cb, cr = materialize(rgb_to_ycbcr(rgb))  # or whatever reads one would make it anew
    lost = jnp.isnan(y)
    y, cb, cr = (jnp.where(lost, black, p) for black, p in ((0, y), (128, cb), (128, cr)))
    chroma = pack(cb, cr)
    y = downsample(y, (1, 1), extent)
    y = _wider(y, y[:, -1:], chroma.shape[1] - y.shape[1])
    blocks = jnp.concatenate([y, chroma]).reshape(-1, 8, chroma.shape[1])
    tables = jnp.stack([luma_table, chroma_table])
    coded = through_blocks(lax.optimization_barrier(blocks), tables, (len(y) // 8,))
    coded = coded.reshape(-1, blocks.shape[2])
    y = jnp.where(lost, jnp.nan, coded[: shape[0], : shape[1]])
    cb, cr = unpack(coded[-len(chroma) :])
    return ycbcr_to_rgb(*lax.optimization_barrier((y, cb, cr)))  # or each colour upsamples for itself


def compress_each(planes: Planes, tables: jax.Array, subsampling: str) -> Planes:
    """Components as they stand, each coded and decoded with a table of its own.

    They go through the transform as one array, one below the other; those half as wide in two halves side by
    side.

    Args:
        planes: three (H, W) planes of whole numbers in 0..255.
        tables: (3, 8, 8) whole numbers in 1..65535.
        subsampling: a key of `SAMPLING`: of the second and the third.
    """
    step, shape = SAMPLING[subsampling], planes[0].shape
    first, *others = (downsample(p, s) for p, s in zip(planes, ((1, 1), step, step)))
    small, parts = others[0].shape, step[1]
    folded = [jnp.concatenate(jnp.split(_lower(p, -len(p) % (8 * parts)), parts), 1) for p in others]
    width = folded[0].shape[1]
    first = _wider(first, first[:, -1:], width - first.shape[1])
    joined = materialize(jnp.concatenate([first, *folded]).reshape(-1, 8, width))
    ends = len(first), len(first) + len(folded[0])
    coded = through_blocks(joined, tables, (ends[0] // 8, ends[1] // 8)).reshape(-1, width)
    whole, *halves = jnp.split(coded, ends)
    second, third = (jnp.concatenate(jnp.split(half, parts, 1))[: small[0]] for half in halves)
    return whole[: shape[0], : shape[1]], upsample(second, shape, step), upsample(third, shape, step)
