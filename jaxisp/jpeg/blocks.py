"""The fixed-point DCT of libjpeg and its quantisation, on rows of 8 x 8 blocks.

Two forms of the same integers. On a CPU they are int32 within a transform and stored in 16 bits; elsewhere
they are held in floats of at least 32 bits, where sums stay below 2**24, but for the transform along columns,
which needs more and is int32.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.safe_math import nearest_int


def fixed(value: float, bits: int = 16) -> int:
    """A constant in fixed point."""
    return round(value * 2**bits)


def shifted(x: jax.Array, bits: int) -> jax.Array:
    """`x >> bits` of whole numbers held in floats; exact, as the scale is a power of two."""
    return jnp.floor(x * 2.0**-bits)


_C = {name: fixed(value, 13) for name, value in {
    "0.298": 0.298631336, "0.390": 0.390180644, "0.541": 0.541196100, "0.765": 0.765366865,
    "0.899": 0.899976223, "1.175": 1.175875602, "1.501": 1.501321110, "1.847": 1.847759065,
    "1.961": 1.961570560, "2.053": 2.053119869, "2.562": 2.562915447, "3.072": 3.072711026,
}.items()}  # fmt: skip
"""Constants of the Loeffler, Ligtenberg and Moschytz DCT, 13 bits."""

Rows = Sequence[Any]
Ends = tuple[int, ...]


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
def _matrix(fn: Callable[[Rows], Rows]) -> np.ndarray:
    """(8, 8) of a 1-D transform, output by input, times 2**13."""
    return np.stack(fn(list(np.eye(8, dtype=np.int32))))


class _Steps(NamedTuple):
    """What the quantiser needs of its tables: the step q, 4 q + 1/2 and 1 / (8 q)."""

    step: jax.Array
    half: jax.Array
    inverse: jax.Array

    @classmethod
    def of(cls, tables: jax.Array) -> "_Steps":
        return cls(tables, 4 * tables + 0.5, 1 / (8 * tables))


def _level(scaled: jax.Array, steps: _Steps) -> jax.Array:
    """The whole-numbered level of coefficients times 8, in floats."""
    # rounds half away from zero; the extra half keeps floor() clear of the division's own rounding
    level = jnp.floor((jnp.abs(scaled) + steps.half) * steps.inverse)
    return jnp.where(scaled < 0, -level, level)


def _restored(scaled: jax.Array, steps: _Steps) -> jax.Array:
    return nearest_int(_level(scaled, steps) * steps.step)


def _slope(scaled: jax.Array, steps: _Steps) -> jax.Array:
    """Of restored coefficients to their step: see `through_blocks`."""
    t = scaled * steps.inverse
    return _level(scaled, steps) - t * (128 / 35) * _sine(t) ** 8


def _rounded(x: jax.Array, bits: int) -> jax.Array:
    return (x + (1 << (bits - 1))) >> bits


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def through_blocks(blocks: jax.Array, tables: jax.Array, ends: Ends) -> jax.Array:
    """Code and decode rows of blocks, (R, 8, W), each with one of some whole-numbered tables.

    Args:
        blocks: whole numbers in 0..255.
        tables: (N, 8, 8) whole numbers in 1..65535.
        ends: the row of blocks where each table but the last gives way to the next.

    Gradient: surrogate. The samples pass straight through. A table entry q has the derivative
    `round(t) - t s'(t)`, t = c / q, of a staircase with soft edges, `s' = 128/35 sin(pi t)**8`: how far
    each level moves, and which coefficients are about to drop one. (With `s' = 1`, straight through,
    a fitter is driven towards finer tables wherever it starts.)
    """
    return _coded(blocks, tables, ends)[0]


def _through_blocks_jvp(ends: Ends, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (blocks, tables), (d_blocks, d_tables) = primals, tangents
    coded, slope = _coded(blocks, tables, ends, slopes=True)
    basis = dct_matrix().astype(blocks.dtype)
    moved = _of_rows(d_tables, ends, len(blocks)) * slope
    change = jnp.einsum("ui,vj,ruxv->rixj", basis, basis, moved, precision=lax.Precision.HIGHEST)
    return coded, d_blocks + change.reshape(blocks.shape)


through_blocks.defjvp(_through_blocks_jvp)


def _coded(
    blocks: jax.Array, tables: jax.Array, ends: Ends, *, slopes: bool = False
) -> tuple[jax.Array, ...]:
    """The coded blocks, and the slopes of their coefficients, (R, 8, W / 8, 8), where they are wanted."""
    by_lines, by_sums = partial(_by_lines, ends, slopes), partial(_by_sums, ends, slopes)
    return by_platform(blocks, tables, cpu=by_lines, default=by_sums)


# On a CPU: sample by sample of a block, so that what is added lies in planes as long as there are blocks


def _by_lines(ends: Ends, slopes: bool, blocks: jax.Array, tables: jax.Array) -> tuple[jax.Array, ...]:
    rows, _, width = blocks.shape
    each, dtype = materialize(_Steps.of(tables)), blocks.dtype  # or each coefficient would divide
    count = rows * width // 8
    across = _down(_forward_1d, _planes(blocks), 1, 11)
    # bound to what is coded, or a loop over strips would have the steps of each block stored before it
    bounds = [jnp.int32(end * width // 8) for end in ends]
    across, bounds = lax.optimization_barrier((across, bounds))
    before = [jnp.arange(count, dtype=jnp.int32) < bound for bound in bounds]

    def quantized(fn: Callable[[jax.Array, _Steps], jax.Array], scaled: jax.Array) -> jax.Array:
        steps = (_by_end(before, [own[:, :, None] for own in s]) for s in each)
        return fn(scaled.astype(dtype), _Steps(*steps))

    def sample(x: jax.Array) -> jax.Array:
        return jnp.clip(x + 128, 0, 255)

    restored = _down(_forward_1d, across, 0, 15, partial(quantized, _restored))
    samples = _down(_inverse_1d, _down(_inverse_1d, restored, 0, 11), 1, 18, sample)
    coded = _blocks(samples, rows, dtype)
    if not slopes:
        return (coded,)
    slope = _down(_forward_1d, across, 0, 15, partial(quantized, _slope), dtype)
    return coded, _blocks(slope, rows, dtype).reshape(rows, 8, -1, 8)


def _by_end(before: Sequence[Any], values: Sequence[jax.Array]) -> jax.Array:
    """Of values in a row the first whose end a place is before."""
    chosen = values[-1]
    for own, value in zip(before[::-1], values[-2::-1], strict=True):
        chosen = jnp.where(own, value, chosen)
    return chosen


def _planes(blocks: jax.Array) -> jax.Array:
    """(R, 8, W) samples about 0 as a plane for each place in a block, (8, 8, R W / 8), in 16 bits."""
    lines = blocks.swapaxes(0, 1)[:, None]
    # joined from slices: a transposition is stored twice
    places = lax.concatenate([lines[..., j::8] for j in range(8)], 1)
    return materialize(nearest_int(places - 128).astype(jnp.int16)).reshape(8, 8, -1)


def _blocks(planes: jax.Array, rows: int, dtype: Any) -> jax.Array:
    """The way back; stored, as what reads from 64 planes is not vectorised."""
    blocks = planes.reshape(8, 8, rows, -1).transpose(2, 0, 3, 1).astype(dtype)
    return materialize(blocks.reshape(rows, 8, -1))


def _down(
    fn: Callable[[Rows], Rows],
    planes: jax.Array,
    axis: int,
    bits: int,
    then: Callable[[jax.Array], jax.Array] = lambda x: x,
    dtype: Any = jnp.int16,
) -> jax.Array:
    """A 1-D transform along an axis of 8, shifted down by `bits`, rounded, and what follows.

    All that is stored between transforms fits 16 bits: at most 2**13, the coefficients times 8. A sum with a
    matrix, as butterflies compile one after the other, for each of the eight.
    """
    shape = [8 if a == axis else 1 for a in range(planes.ndim)]
    lines = [lax.slice_in_dim(planes, i, i + 1, axis=axis).astype(jnp.int32) for i in range(8)]
    weighted = [line * column.reshape(shape) for line, column in zip(lines, _matrix(fn).T)]
    return materialize(then(_rounded(functools.reduce(operator.add, weighted), bits)).astype(dtype))


# Elsewhere: sums over 8, each one kernel with what is around it


def _by_sums(ends: Ends, slopes: bool, blocks: jax.Array, tables: jax.Array) -> tuple[jax.Array, ...]:
    rows, _, width = blocks.shape
    steps = _Steps(*(_of_rows(each, ends, rows) for each in _Steps.of(tables)))
    across = lax.optimization_barrier(nearest_int(_rows_forward(blocks - 128)))
    scaled = _columns(_forward_1d, across, 15, blocks.dtype).reshape(rows, 8, width // 8, 8)
    restored = _restored(scaled, steps).reshape(blocks.shape)
    samples = _rows_inverse(_columns(_inverse_1d, restored, 11, blocks.dtype))
    coded = jnp.clip(samples + 128, 0, 255)
    return (coded, _slope(scaled, steps)) if slopes else (coded,)


def _of_rows(tables: jax.Array, ends: Ends, rows: int) -> jax.Array:
    """(rows, 8, 1, 8): the table of each row of blocks."""
    before = [(np.arange(rows) < end)[:, None, None, None] for end in ends]
    return _by_end(before, [table[:, None] for table in tables])


def _rows_forward(blocks: jax.Array) -> jax.Array:
    """Along the rows of (R, 8, W) blocks of samples about 0, times 4; exact in floats."""
    return shifted(_along_rows(_matrix(_forward_1d), blocks) + (1 << 10), 11)


def _rows_inverse(blocks: jax.Array) -> jax.Array:
    """Along the rows of (R, 8, W), undone; the matrix is split in two so that each sum is below 2**24."""
    basis = _matrix(_forward_1d).T
    coarse = (basis + 64) // 128
    high, low = (_along_rows(m, blocks) for m in (coarse, basis - 128 * coarse))
    return shifted(high + shifted(low + (1 << 17), 7), 11)


def _along_rows(matrix: np.ndarray, blocks: jax.Array) -> jax.Array:
    return _summed(matrix, 1, blocks.reshape(-1, 8)).reshape(blocks.shape)


def _columns(fn: Callable[[Rows], Rows], blocks: jax.Array, bits: int, dtype: Any) -> jax.Array:
    """A 1-D transform down the columns of int32 (R, 8, W), shifted down by `bits`, rounded, as `dtype`."""
    lines = _summed(_matrix(fn), 1, blocks)
    return lax.optimization_barrier(_rounded(lines, bits).astype(dtype))


def _summed(matrix: np.ndarray, axis: int, x: jax.Array) -> jax.Array:
    """A matrix times an axis of 8, as a sum."""
    weights = matrix.T.astype(x.dtype).reshape(*[1] * axis, 8, 8, *[1] * (x.ndim - 1 - axis))
    return lax.reduce(jnp.expand_dims(x, axis + 1) * weights, np.zeros((), x.dtype), lax.add, (axis,))


_SINE = (3.141592654, -5.167712765, 2.550163318, -0.5992521865, 0.08205035015, -0.00702830379)
"""sin(pi x) / x on [-0.5, 0.5], a polynomial of x**2, lowest power first."""


def _sine(x: jax.Array) -> jax.Array:
    """sin(pi x) up to its sign, within 1e-6; XLA's own takes ten times as long on a CPU."""
    part = x - jnp.round(x)
    square, value = part * part, jnp.full_like(part, _SINE[-1])
    for coefficient in _SINE[-2::-1]:
        value = value * square + coefficient
    return value * part


@functools.cache
def dct_matrix() -> np.ndarray:
    """(8, 8), the orthonormal 8-point DCT, frequency by sample."""
    u, i = np.mgrid[:8, :8]
    return np.where(u, 0.5, np.sqrt(0.125)) * np.cos((2 * i + 1) * u * np.pi / 16)
