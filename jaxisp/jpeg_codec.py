"""What libjpeg does to pixels, in JAX: integer colour, chroma sampling, DCT and quantisation.

Values are exact integers held in the image's float type between steps; inside a step they are
int32. Each step pairs libjpeg's integer arithmetic with a smooth surrogate for the gradient.
"""

import functools
from collections.abc import Sequence
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


def _fixed(value: float, bits: int) -> int:
    return round(value * 2**bits)


def _rounded_shift(x: jax.Array, bits: int) -> jax.Array:
    return (x + (1 << (bits - 1))) >> bits


def _hard(fn: Any, soft: jax.Array, *arrays: jax.Array) -> jax.Array:
    """The integer function `fn` of int32 `arrays`, with the gradient of `soft`."""
    whole = fn(*(lax.stop_gradient(a).astype(jnp.int32) for a in arrays))
    return straight_through(whole.astype(soft.dtype), soft)


def rgb_to_ycbcr(rgb: Planes) -> Planes:
    """Whole-numbered R'G'B' planes in 0..255 to Y'CbCr with chroma about 128 (16-bit fixed point)."""
    fix = functools.partial(_fixed, bits=16)
    half, centre = 1 << 15, (128 << 16) + (1 << 15) - 1

    def weighted(red: int, green: int, blue: int, bias: int, soft: jax.Array) -> jax.Array:
        return _hard(lambda r, g, b: (red * r + green * g + blue * b + bias) >> 16, soft, *rgb)

    y, cb, cr = rgb_to_ycbcr_planes(*rgb)
    return (
        weighted(fix(0.299), fix(0.587), fix(0.114), half, y),
        weighted(-fix(0.16874), -fix(0.33126), half, centre, cb + 128),
        weighted(half, -fix(0.41869), -fix(0.08131), centre, cr + 128),
    )


def ycbcr_to_rgb(y: jax.Array, cb: jax.Array, cr: jax.Array) -> Planes:
    """The way back, clipped to 0..255."""
    fix = functools.partial(_fixed, bits=16)
    red, green, blue = (jnp.clip(p, 0, 255) for p in ycbcr_to_rgb_planes(y, cb - 128, cr - 128))
    limited = functools.partial(jnp.clip, min=0, max=255)
    shift = functools.partial(_rounded_shift, bits=16)
    return (
        _hard(lambda y, v: limited(y + shift(fix(1.402) * (v - 128))), red, y, cr),
        _hard(
            lambda y, u, v: limited(y + shift(-fix(0.34414) * (u - 128) - fix(0.71414) * (v - 128))),
            green,
            y,
            cb,
            cr,
        ),
        _hard(lambda y, u: limited(y + shift(fix(1.772) * (u - 128))), blue, y, cb),
    )


def _pad_end(plane: jax.Array, rows: int, columns: int) -> jax.Array:
    return jnp.pad(plane, ((0, rows), (0, columns)), mode="edge")


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
        bias = np.arange(columns, dtype=np.int32) % 2 + (1 if sy == 2 else 0)
        total = functools.reduce(jnp.add, parts)
        plane = _hard(lambda t: (t + bias) >> (len(parts) // 2), total / len(parts), total)
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
    left, right = 3 * plane + near[:, :-2], 3 * plane + near[:, 2:]
    (bias_left, bias_right), bits = ((8, 7), 4) if sy == 2 else ((1, 2), 2)
    halves = (
        _hard(lambda t: (t + bias_left) >> bits, left / 2**bits, left),
        _hard(lambda t: (t + bias_right) >> bits, right / 2**bits, right),
    )
    return _interleave(*halves, axis=1)[: shape[0], : shape[1]]


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

Rows = Sequence[jax.Array]


def _odd_part(a: jax.Array, b: jax.Array, c: jax.Array, d: jax.Array) -> list[jax.Array]:
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


def _forward_1d(x: Rows, shift: int) -> list[jax.Array]:
    """Eight samples to eight frequencies, times 2**13 and then shifted down by `shift`, rounded."""
    s = [x[i] + x[7 - i] for i in range(4)]
    d = [x[i] - x[7 - i] for i in range(4)]
    e0, e3, e1, e2 = s[0] + s[3], s[0] - s[3], s[1] + s[2], s[1] - s[2]
    z = (e2 + e3) * _C["0.541"]
    f7, f5, f3, f1 = _odd_part(d[3], d[2], d[1], d[0])
    even = [(e0 + e1) << 13, z + e3 * _C["0.765"], (e0 - e1) << 13, z - e2 * _C["1.847"]]
    out = [even[0], f1, even[1], f3, even[2], f5, even[3], f7]
    return [_rounded_shift(v, shift) for v in out]


def _inverse_1d(x: Rows, shift: int) -> list[jax.Array]:
    """Eight frequencies to eight samples, times 2**13 and then shifted down by `shift`, rounded."""
    z = (x[2] + x[6]) * _C["0.541"]
    e2, e3 = z - x[6] * _C["1.847"], z + x[2] * _C["0.765"]
    e0, e1 = (x[0] + x[4]) << 13, (x[0] - x[4]) << 13
    even = [e0 + e3, e1 + e2, e1 - e2, e0 - e3]
    odd = _odd_part(x[7], x[5], x[3], x[1])[::-1]
    out = [e + o for e, o in zip(even, odd)] + [e - o for e, o in zip(even[::-1], odd[::-1])]
    return [_rounded_shift(v, shift) for v in out]


def _along(fn: Any, blocks: jax.Array, axis: int, shift: int) -> jax.Array:
    """Apply a 1-D transform along axis 0 (rows of a block) or 1 (columns) of (8, 8, N) blocks."""
    lines = [lax.index_in_dim(blocks, i, axis, keepdims=False) for i in range(8)]
    return lax.optimization_barrier(jnp.stack(fn(lines, shift), axis))


def _to_blocks(plane: jax.Array) -> jax.Array:
    """(H, W) to (8, 8, N): the blocks run along the last axis, where the CPU's vectors run."""
    h, w = plane.shape
    return plane.reshape(h // 8, 8, w // 8, 8).transpose(1, 3, 0, 2).reshape(8, 8, -1)


def _from_blocks(blocks: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    h, w = shape
    return blocks.reshape(8, 8, h // 8, w // 8).transpose(2, 0, 3, 1).reshape(h, w)


def _quantize(plane: jax.Array, table: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The forward DCT: coefficients times 8, and the whole-numbered levels, both (8, 8, N) int32."""
    blocks = lax.optimization_barrier(_to_blocks(plane.astype(jnp.int32) - 128))
    scaled = _along(_forward_1d, _along(_forward_1d, blocks, 1, 11), 0, 15)
    step = table[..., None].astype(jnp.float32)
    # rounds half away from zero; the extra half keeps floor() clear of the division's own rounding
    level = jnp.floor((jnp.abs(scaled) + 4 * step + 0.5) * (1 / (8 * step)))
    return scaled, jnp.where(scaled < 0, -level, level).astype(jnp.int32)


@jax.custom_jvp
def through_blocks(plane: jax.Array, table: jax.Array) -> jax.Array:
    """Code and decode one plane of whole blocks with a whole-numbered (8, 8) table.

    Gradient: surrogate. The plane passes straight through. A table entry q has the derivative
    `round(t) - t s'(t)`, t = c / q, of a staircase with soft edges, `s' = 128/35 sin(pi t)**8`: how far
    each level moves, and which coefficients are about to drop one. (With `s' = 1`, straight through,
    a fitter is driven towards finer tables wherever it starts.)
    """
    return _dequantize(_quantize(plane, table)[1], plane, table)


def _dequantize(level: jax.Array, plane: jax.Array, table: jax.Array) -> jax.Array:
    restored = level * table[..., None].astype(jnp.int32)
    pixels = _along(_inverse_1d, _along(_inverse_1d, restored, 0, 11), 1, 18)
    return jnp.clip(_from_blocks(pixels, plane.shape) + 128, 0, 255).astype(plane.dtype)


@through_blocks.defjvp
def _through_blocks_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (plane, table), (d_plane, d_table) = primals, tangents
    scaled, level = _quantize(plane, table)
    t = scaled.astype(plane.dtype) / (8 * table[..., None])
    slope = level - t * (128 / 35) * jnp.sin(np.pi * t) ** 8
    basis = _basis().astype(plane.dtype)
    change = jnp.einsum("ui,vj,uvn->ijn", basis, basis, d_table[..., None] * slope)
    return _dequantize(level, plane, table), d_plane + _from_blocks(change, plane.shape)


@functools.cache
def _basis() -> np.ndarray:
    """The orthonormal 8-point DCT, frequency by sample."""
    u, i = np.mgrid[:8, :8]
    return np.where(u, 0.5, np.sqrt(0.125)) * np.cos((2 * i + 1) * u * np.pi / 16)


def compress(rgb: Planes, luma_table: jax.Array, chroma_table: jax.Array, subsampling: str) -> Planes:
    """Planes of whole numbers in 0..255 through JPEG and back.

    Args:
        rgb: three (H, W) planes.
        luma_table: (8, 8) whole numbers in 1..255.
        chroma_table: likewise.
        subsampling: a key of `SAMPLING`.
    """
    shape = rgb[0].shape
    coded = []
    for i, plane in enumerate(rgb_to_ycbcr(rgb)):
        step = SAMPLING[subsampling] if i else (1, 1)
        blocks = downsample(plane, step)
        decoded = through_blocks(blocks, chroma_table if i else luma_table)
        coded.append(upsample(decoded, shape, step))
    return ycbcr_to_rgb(*coded)
