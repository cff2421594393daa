"""The fixed-point DCT of libjpeg and its quantisation, on rows of 8 x 8 blocks.

Values are exact integers held in floats of at least 32 bits, and sums stay below 2**24 there; the
transform along columns, which needs more, is int32.
"""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.numerics import materialize, nearest_int


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
    return shifted(total + (1 << 10), 11)


def _rows_inverse(blocks: jax.Array) -> jax.Array:
    """Along the rows of (R, 8, W), undone; the matrix is split in two so that each sum is below 2**24."""
    basis = _fixed_basis()
    coarse = (basis + 64) // 128
    high, low = (_product(blocks, m) for m in (coarse, basis - 128 * coarse))
    return shifted(high + shifted(low + (1 << 17), 7), 11)


def _product(blocks: jax.Array, matrix: np.ndarray) -> jax.Array:
    """Each run of 8 along the last axis times an (8, 8) matrix, exact on every device."""

    def product(runs: jax.Array) -> jax.Array:
        return jnp.dot(runs, matrix.astype(runs.dtype), precision=lax.Precision.HIGHEST)

    runs = blocks.reshape(-1, 8)
    products = lax.platform_dependent(runs, cpu=product, default=partial(_summed, matrix.T, 1))
    return products.reshape(blocks.shape)


def _summed(matrix: np.ndarray, axis: int, x: jax.Array) -> jax.Array:
    """A matrix times an axis of 8, as a sum: off a CPU it becomes one kernel with what is around it."""
    weights = matrix.T.astype(x.dtype).reshape(8, 8, *[1] * (x.ndim - 1 - axis))
    return lax.reduce(jnp.expand_dims(x, axis + 1) * weights, np.zeros((), x.dtype), lax.add, (axis,))


def _columns(fn: Callable[[Rows], Rows], blocks: jax.Array, bits: int, dtype: Any) -> jax.Array:
    """A 1-D transform down the columns of int32 (R, 8, W), shifted down by `bits`, rounded, as `dtype`."""

    def rounded(x: jax.Array) -> jax.Array:
        return ((x + (1 << (bits - 1))) >> bits).astype(dtype)

    def line_by_line(blocks: jax.Array) -> jax.Array:
        lines = fn([lax.index_in_dim(blocks, i, 1, keepdims=False) for i in range(8)])
        return jnp.stack([rounded(line) for line in lines], 1)

    def at_once(blocks: jax.Array) -> jax.Array:
        return rounded(_summed(np.stack(fn(list(np.eye(8, dtype=int)))), 1, blocks))

    return lax.optimization_barrier(lax.platform_dependent(blocks, cpu=line_by_line, default=at_once))


def _by_block(blocks: jax.Array) -> jax.Array:
    rows, _, width = blocks.shape
    return blocks.reshape(rows, 8, width // 8, 8)


class _Steps(NamedTuple):
    """What the quantiser needs of its tables, each (R, 8, 1, 8): the step q, 4 q + 1/2 and 1 / (8 q)."""

    step: jax.Array
    half: jax.Array
    inverse: jax.Array

    @classmethod
    def of(cls, tables: jax.Array, first: int, rows: int) -> "_Steps":
        # stored, or a CPU would divide once for each coefficient
        each = materialize((tables, 4 * tables + 0.5, 1 / (8 * tables)))
        return cls(*(_of_rows(values, first, rows) for values in each))


def _of_rows(tables: jax.Array, first: int, rows: int) -> jax.Array:
    """(rows, 8, 1, 8) from two tables: the first for so many rows of blocks, the second for the rest."""
    is_first = (np.arange(rows) < first)[:, None, None, None]
    return jnp.where(is_first, tables[0, :, None], tables[1, :, None])


def _quantize(blocks: jax.Array, steps: _Steps) -> tuple[jax.Array, jax.Array]:
    """The forward DCT: coefficients times 8 and whole-numbered levels, (R, 8, W / 8, 8), in floats."""
    lines = lax.optimization_barrier(nearest_int(_rows_forward(blocks - 128)))
    scaled = _by_block(_columns(_forward_1d, lines, 15, blocks.dtype))
    # rounds half away from zero; the extra half keeps floor() clear of the division's own rounding
    level = jnp.floor((jnp.abs(scaled) + steps.half) * steps.inverse)
    return scaled, jnp.where(scaled < 0, -level, level)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def through_blocks(blocks: jax.Array, tables: jax.Array, first: int) -> jax.Array:
    """Code and decode rows of blocks, (R, 8, W), with one of two whole-numbered tables.

    Args:
        blocks: whole numbers in 0..255.
        tables: (2, 8, 8) whole numbers in 1..255.
        first: how many rows of blocks go by the first table; the others go by the second.

    Gradient: surrogate. The samples pass straight through. A table entry q has the derivative
    `round(t) - t s'(t)`, t = c / q, of a staircase with soft edges, `s' = 128/35 sin(pi t)**8`: how far
    each level moves, and which coefficients are about to drop one. (With `s' = 1`, straight through,
    a fitter is driven towards finer tables wherever it starts.)
    """
    steps = _Steps.of(tables, first, len(blocks))
    return _dequantize(_quantize(blocks, steps)[1], steps)


def _dequantize(level: jax.Array, steps: _Steps) -> jax.Array:
    restored = nearest_int(level * steps.step)
    restored = restored.reshape(*restored.shape[:2], -1)
    return jnp.clip(_rows_inverse(_columns(_inverse_1d, restored, 11, level.dtype)) + 128, 0, 255)


def _through_blocks_jvp(first: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (blocks, tables), (d_blocks, d_tables) = primals, tangents
    steps = _Steps.of(tables, first, len(blocks))
    scaled, level = _quantize(blocks, steps)
    t = scaled * steps.inverse
    slope = level - t * (128 / 35) * _sine(t) ** 8
    basis = _basis().astype(blocks.dtype)
    moved = _of_rows(d_tables, first, len(blocks)) * slope
    change = jnp.einsum("ui,vj,ruxv->rixj", basis, basis, moved, precision=lax.Precision.HIGHEST)
    return _dequantize(level, steps), d_blocks + change.reshape(blocks.shape)


through_blocks.defjvp(_through_blocks_jvp)


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
def _basis() -> np.ndarray:
    """The orthonormal 8-point DCT, frequency by sample."""
    u, i = np.mgrid[:8, :8]
    return np.where(u, 0.5, np.sqrt(0.125)) * np.cos((2 * i + 1) * u * np.pi / 16)
