"""What libjpeg does to pixels, in JAX: integer colour, chroma sampling, DCT and quantisation.

Values are exact integers held in floats of at least 32 bits, and sums stay below 2**24 there; the
transform along columns, which needs more, is int32. Each step pairs libjpeg's integer arithmetic with
a smooth surrogate for the gradient.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.numerics import straight_through

SAMPLING = {"4:4:4": (1, 1), "4:2:2": (1, 2), "4:2:0": (2, 2)}
"""Luma samples per chroma sample, (vertical, horizontal)."""

Planes = tuple[jax.Array, jax.Array, jax.Array]


def _fixed(value: float, bits: int = 16) -> int:
    return round(value * 2**bits)


def _shifted(x: jax.Array, bits: int) -> jax.Array:
    """`x >> bits` of whole numbers held in floats; exact, as the scale is a power of two."""
    return jnp.floor(x * 2.0**-bits)


def rgb_to_ycbcr(rgb: Planes) -> Planes:
    """Whole-numbered R'G'B' planes in 0..255 to Y'CbCr with chroma about 128 (16-bit fixed point)."""
    r, g, b = rgb
    half, centre = 1 << 15, (128 << 16) + (1 << 15) - 1
    # centre + half * 255 is 2**24 - 1, so the sums are exact
    hard = (
        _fixed(0.299) * r + _fixed(0.587) * g + _fixed(0.114) * b + half,
        (half * b + centre) - _fixed(0.16874) * r - _fixed(0.33126) * g,
        (half * r + centre) - _fixed(0.41869) * g - _fixed(0.08131) * b,
    )
    y, cb, cr = rgb_to_ycbcr_planes(*rgb)
    soft = (y, cb + 128, cr + 128)
    y, cb, cr = (straight_through(_shifted(h, 16), s) for h, s in zip(hard, soft))
    return y, cb, cr


def ycbcr_to_rgb(y: jax.Array, cb: jax.Array, cr: jax.Array) -> Planes:
    """The way back, clipped to 0..255."""
    half, u, v = 1 << 15, cb - 128, cr - 128
    shifts = (
        _shifted(_fixed(1.402) * v + half, 16),
        _shifted(half - _fixed(0.34414) * u - _fixed(0.71414) * v, 16),
        _shifted(_fixed(1.772) * u + half, 16),
    )
    soft = ycbcr_to_rgb_planes(y, u, v)
    r, g, b = (straight_through(jnp.clip(y + d, 0, 255), jnp.clip(s, 0, 255)) for d, s in zip(shifts, soft))
    return r, g, b


def _pad_end(plane: jax.Array, rows: int, columns: int) -> jax.Array:
    return jnp.pad(plane, ((0, rows), (0, columns)), mode="edge") if rows or columns else plane


def downsample(plane: jax.Array, step: tuple[int, int]) -> jax.Array:
    """Box means over `step`, then padded to whole blocks, as the encoder does it.

    The bias of the rounding alternates by column. Columns are padded before the mean, rows after it.
    """
    sy, sx = step
    height, width = plane.shape
    rows, columns = -(-height // sy), -(-width // (8 * sx)) * 8
    plane = _pad_end(plane, rows * sy - height, columns * sx - width)
    if step != (1, 1):
        parts = [plane[i::sy, j::sx] for i in range(sy) for j in range(sx)]
        bias = np.arange(columns) % 2 + (1 if sy == 2 else 0)
        total = functools.reduce(jnp.add, parts)
        hard = _shifted(total + bias.astype(plane.dtype), len(parts) // 2)
        plane = straight_through(hard, total / len(parts))
    return _pad_end(plane, -rows % 8, 0)


def upsample(plane: jax.Array, shape: tuple[int, ...], step: tuple[int, int]) -> jax.Array:
    """Triangle ("fancy") interpolation by `step`, cropped to `shape`; narrow planes are repeated."""
    sy, sx = step
    plane = plane[: -(-shape[0] // sy), : -(-shape[1] // sx)]  # block padding takes no part
    if step == (1, 1):
        return plane
    if plane.shape[1] <= 2:
        return jnp.repeat(jnp.repeat(plane, sy, 0), sx, 1)[: shape[0], : shape[1]]
    if sy == 2:
        near = jnp.pad(plane, ((1, 1), (0, 0)), mode="edge")
        plane = _interleave(3 * plane + near[:-2], 3 * plane + near[2:], axis=0)
    near = jnp.pad(plane, ((0, 0), (1, 1)), mode="edge")
    (bias_left, bias_right), bits = ((8, 7), 4) if sy == 2 else ((1, 2), 2)
    left, right = (
        straight_through(_shifted(total + bias, bits), total / 2**bits)
        for total, bias in ((3 * plane + near[:, :-2], bias_left), (3 * plane + near[:, 2:], bias_right))
    )
    return _interleave(left, right, axis=1)[: shape[0], : shape[1]]


def _interleave(a: jax.Array, b: jax.Array, axis: int) -> jax.Array:
    shape = list(a.shape)
    shape[axis] *= 2
    return jnp.stack([a, b], axis + 1).reshape(shape)


_C = {name: _fixed(value, 13) for name, value in {
    "0.298": 0.298631336, "0.390": 0.390180644, "0.541": 0.541196100, "0.765": 0.765366865,
    "0.899": 0.899976223, "1.175": 1.175875602, "1.501": 1.501321110, "1.847": 1.847759065,
    "1.961": 1.961570560, "2.053": 2.053119869, "2.562": 2.562915447, "3.072": 3.072711026,
}.items()}  # fmt: skip
"""Constants of the Loeffler, Ligtenberg and Moschytz DCT, 13 bits."""

Rows = Sequence[Any]


def _odd_part(a: Any, b: Any, c: Any, d: Any) -> list[Any]:
    """The rotations of the four odd terms, which forward and inverse share."""
    both = (a + b + c + d) * _C["1.175"]
    z1, z2 = -_C["0.899"] * (a + d), -_C["2.562"] * (b + c)
    z3, z4 = both - _C["1.961"] * (a + c), both - _C["0.390"] * (b + d)
    return [
        _C["0.298"] * a + z1 + z3,
        _C["2.053"] * b + z2 + z4,
        _C["3.072"] * c + z2 + z3,
        _C["1.501"] * d + z1 + z4,
    ]


def _forward_1d(x: Rows) -> list[Any]:
    """Eight samples to eight frequencies, times 2**13."""
    s = [x[i] + x[7 - i] for i in range(4)]
    d = [x[i] - x[7 - i] for i in range(4)]
    e0, e3, e1, e2 = s[0] + s[3], s[0] - s[3], s[1] + s[2], s[1] - s[2]
    z = (e2 + e3) * _C["0.541"]
    f7, f5, f3, f1 = _odd_part(d[3], d[2], d[1], d[0])
    even = [(e0 + e1) << 13, z + e3 * _C["0.765"], (e0 - e1) << 13, z - e2 * _C["1.847"]]
    return [even[0], f1, even[1], f3, even[2], f5, even[3], f7]


def _inverse_1d(x: Rows) -> list[Any]:
    """Eight frequencies to eight samples, times 2**13."""
    z = (x[2] + x[6]) * _C["0.541"]
    e2, e3 = z - x[6] * _C["1.847"], z + x[2] * _C["0.765"]
    e0, e1 = (x[0] + x[4]) << 13, (x[0] - x[4]) << 13
    even = [e0 + e3, e1 + e2, e1 - e2, e0 - e3]
    odd = _odd_part(x[7], x[5], x[3], x[1])[::-1]
    return [e + o for e, o in zip(even, odd)] + [e - o for e, o in zip(even[::-1], odd[::-1])]


@functools.cache
def _fixed_basis() -> np.ndarray:
    """The matrix of the fixed-point 1-D DCT, frequency by sample, times 2**13."""
    return np.stack(_forward_1d(list(np.eye(8, dtype=int))))


def _rows_forward(blocks: jax.Array) -> jax.Array:
    """Along the rows of (R, 8, W) blocks of samples about 0, times 4; one exact matrix product."""
    total = _product(blocks, _fixed_basis().T)
    return _shifted(total + (1 << 10), 11)


def _rows_inverse(blocks: jax.Array) -> jax.Array:
    """Along the rows of (R, 8, W), undone; the matrix is split in two so that each sum is below 2**24."""
    basis = _fixed_basis()
    coarse = (basis + 64) // 128
    high, low = (_product(blocks, m) for m in (coarse, basis - 128 * coarse))
    return _shifted(high + _shifted(low + (1 << 17), 7), 11)


def _product(blocks: jax.Array, matrix: np.ndarray) -> jax.Array:
    """Each run of 8 along the last axis times an (8, 8) matrix, in full precision also on a GPU."""
    runs = blocks.reshape(-1, 8)
    return jnp.dot(runs, matrix.astype(runs.dtype), precision=lax.Precision.HIGHEST).reshape(blocks.shape)


def _columns(fn: Callable[[Rows], Rows], blocks: jax.Array, bits: int) -> jax.Array:
    """A 1-D transform down the columns of int32 (R, 8, W), shifted down by `bits`, rounded."""
    lines = fn([lax.index_in_dim(blocks, i, 1, keepdims=False) for i in range(8)])
    return lax.optimization_barrier(jnp.stack([(v + (1 << (bits - 1))) >> bits for v in lines], 1))


def _by_block(blocks: jax.Array) -> jax.Array:
    rows, _, width = blocks.shape
    return blocks.reshape(rows, 8, width // 8, 8)


def _quantize(blocks: jax.Array, table: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The forward DCT: coefficients times 8 and whole-numbered levels, (R, 8, W / 8, 8), in floats."""
    lines = lax.optimization_barrier(_rows_forward(blocks - 128).astype(jnp.int32))
    scaled = _by_block(_columns(_forward_1d, lines, 15)).astype(blocks.dtype)
    step = table[:, :, None]
    # rounds half away from zero; the extra half keeps floor() clear of the division's own rounding
    level = jnp.floor((jnp.abs(scaled) + 4 * step + 0.5) * (1 / (8 * step)))
    return scaled, jnp.where(scaled < 0, -level, level)


@jax.custom_jvp
def through_blocks(blocks: jax.Array, table: jax.Array) -> jax.Array:
    """Code and decode rows of blocks, (R, 8, W), with a whole-numbered table for each row, (R, 8, 8).

    Gradient: surrogate. The samples pass straight through. A table entry q has the derivative
    `round(t) - t s'(t)`, t = c / q, of a staircase with soft edges, `s' = 128/35 sin(pi t)**8`: how far
    each level moves, and which coefficients are about to drop one. (With `s' = 1`, straight through,
    a fitter is driven towards finer tables wherever it starts.)
    """
    return _dequantize(_quantize(blocks, table)[1], table)


def _dequantize(level: jax.Array, table: jax.Array) -> jax.Array:
    restored = (level * table[:, :, None]).astype(jnp.int32)
    restored = restored.reshape(*restored.shape[:2], -1)
    lines = _columns(_inverse_1d, restored, 11).astype(level.dtype)
    return jnp.clip(_rows_inverse(lines) + 128, 0, 255)


@through_blocks.defjvp
def _through_blocks_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (blocks, table), (d_blocks, d_table) = primals, tangents
    scaled, level = _quantize(blocks, table)
    t = scaled / (8 * table[:, :, None])
    slope = level - t * (128 / 35) * jnp.sin(np.pi * t) ** 8
    basis = _basis().astype(blocks.dtype)
    change = jnp.einsum("ui,vj,ruxv->rixj", basis, basis, d_table[:, :, None] * slope)
    return _dequantize(level, table), d_blocks + change.reshape(blocks.shape)


@functools.cache
def _basis() -> np.ndarray:
    """The orthonormal 8-point DCT, frequency by sample."""
    u, i = np.mgrid[:8, :8]
    return np.where(u, 0.5, np.sqrt(0.125)) * np.cos((2 * i + 1) * u * np.pi / 16)


def compress(rgb: Planes, luma_table: jax.Array, chroma_table: jax.Array, subsampling: str) -> Planes:
    """Planes of whole numbers in 0..255 through JPEG and back.

    The three planes go through the transform as one array, chroma below luma.

    Args:
        rgb: three (H, W) planes.
        luma_table: (8, 8) whole numbers in 1..255.
        chroma_table: likewise.
        subsampling: a key of `SAMPLING`.
    """
    step = SAMPLING[subsampling]
    pack, unpack = partial(_pack, step=step), partial(_unpack, shape=rgb[0].shape, step=step)
    return _compress(rgb, luma_table, chroma_table, pack, unpack)


def compress_full_or_half(
    rgb: Planes, luma_table: jax.Array, chroma_table: jax.Array, full: jax.Array
) -> Planes:
    """`compress` by 4:4:4 where `full`, else by 4:2:0, for little more than 4:4:4 takes.

    The smaller planes of chroma take a part of the larger ones' place in the transform.
    """
    whole, half = SAMPLING["4:4:4"], SAMPLING["4:2:0"]
    shape = rgb[0].shape
    rows = -(-shape[0] // 16) * 8  # of chroma in 4:2:0

    def pack(cb: jax.Array, cr: jax.Array) -> jax.Array:
        few, many = _pack(cb, cr, half), _pack(cb, cr, whole)
        few = jnp.pad(few, ((0, len(many) - len(few)), (0, 0)))
        return jnp.where(full, _pad_end(many, 0, few.shape[1] - many.shape[1]), few)

    def unpack(coded: jax.Array) -> list[jax.Array]:
        many, few = _unpack(coded, shape, whole), _unpack(coded[:rows], shape, half)
        return [jnp.where(full, m, f) for m, f in zip(many, few)]

    return _compress(rgb, luma_table, chroma_table, pack, unpack)


def _pack(cb: jax.Array, cr: jax.Array, step: tuple[int, int]) -> jax.Array:
    """Two planes half as wide side by side, others one below the other."""
    return jnp.concatenate([downsample(c, step) for c in (cb, cr)], step[1] - 1)


def _unpack(coded: jax.Array, shape: tuple[int, ...], step: tuple[int, int]) -> list[jax.Array]:
    return [upsample(c, shape, step) for c in jnp.split(coded, 2, step[1] - 1)]


def _compress(
    rgb: Planes,
    luma_table: jax.Array,
    chroma_table: jax.Array,
    pack: Callable[[jax.Array, jax.Array], jax.Array],
    unpack: Callable[[jax.Array], Sequence[jax.Array]],
) -> Planes:
    shape = rgb[0].shape
    y, cb, cr = rgb_to_ycbcr(rgb)
    chroma = pack(cb, cr)
    y = downsample(y, (1, 1))
    y = _pad_end(y, 0, chroma.shape[1] - y.shape[1])
    blocks = jnp.concatenate([y, chroma]).reshape(-1, 8, chroma.shape[1])
    is_luma = (np.arange(len(blocks)) < len(y) // 8)[:, None, None]
    tables = jnp.where(is_luma, luma_table, chroma_table)
    coded = through_blocks(lax.optimization_barrier(blocks), tables).reshape(-1, blocks.shape[2])
    y = coded[: shape[0], : shape[1]]
    cb, cr = unpack(coded[-len(chroma) :])
    return ycbcr_to_rgb(*lax.optimization_barrier((y, cb, cr)))  # or each colour upsamples for itself
