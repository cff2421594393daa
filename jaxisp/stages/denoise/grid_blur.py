"""The blur of the bilateral grid along its three axes: discrete Gaussians (Lindeberg 1990).

Each sum has its terms one after the other. So a grid has the same bits in a larger array, which a product of
matrices does not give: a library orders its sums by the size.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap

from jaxisp.arrays.barriers import on_all_cores, store, unknown_zeros
from jaxisp.arrays.extents import Extent, whole
from jaxisp.arrays.linear import linear_call, scaled
from jaxisp.arrays.platforms import by_platform

Kernels = tuple[jax.Array, jax.Array, jax.Array]  # along rows, along columns, and how far they reach
Filter = Callable[[Kernels, jax.Array], jax.Array]

_AT_ONCE = 8  # planes, where memory is to be little
_UNROLLED = 32  # terms of a sum in one kernel; of more there is a loop
_TERMS = 8  # in each of its turns
_TILE, _WHOLE = 16, 96  # cells along an axis that are summed together, of more than so many
_LANES = 8  # floats of a CPU's vector
_VECTOR = 32  # XLA's CPU code for exp gives other bits where an array is shorter than a register or two
_times = partial(jnp.matmul, precision=lax.Precision.HIGHEST)  # a GPU would round to 10 bits


def blurred(
    grid: jax.Array,
    columns: int,
    by_space: jax.Array,
    by_range: jax.Array,
    cells: Extent | None = None,
    *,
    little_memory: bool = False,
) -> jax.Array:
    """Blur a grid along bins, rows and columns; borders are mirrored, and the bins go on as zeros.

    Args:
        grid: (bins, planes, rows * (columns + 2)); the last two columns of each row are dropped.
        columns: how many cells a row has.
        by_space: variance along rows and columns, in squared cells.
        by_range: variance along bins, in squared bins.
        cells: rows and columns at the top left that the picture has, where those are not all.
        little_memory: True has a CPU take some planes at a time, each where it was.

    Returns:
        (bins, planes, (rows + 3) * (columns + 2)): with a border of one cell, at the bottom of two. Beyond
        the border of the picture it has no meaning.

    Gradient: exact, in both modes.
    """
    bins, count, length = grid.shape
    rows = length // (columns + 2)
    cells = cells or whole((rows, columns))
    sides = jnp.stack([jnp.int32(bins), *cells])
    variances = jnp.stack([by_range, *[lax.stop_gradient(by_space)] * 2])
    along, *lags = jax.vmap(partial(_periodic_gaussian, max(bins, rows, columns) + 1))(sides, variances)
    apart = np.abs(np.arange(bins)[:, None] - np.arange(bins))
    planes = _along_bins(along[apart], grid).reshape(bins, count, rows, columns + 2)
    return _blurred_in_space(planes, by_space, lags, cells, little_memory).reshape(bins, count, -1)


@jax.custom_jvp
def _along_bins(weights: jax.Array, grid: jax.Array) -> jax.Array:
    return _weighted(weights, grid, 0)


@_along_bins.defjvp
def _along_bins_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    # as products: here the order of the terms is free, and the weights are few
    (weights, grid), (d_weights, d_grid) = primals, (t.reshape(len(t), -1) for t in tangents)
    change = _times(d_weights, grid.reshape(len(grid), -1)) + _times(weights, d_grid)
    return _along_bins(weights, grid), change.reshape(grid.shape)


@partial(jax.custom_jvp, nondiff_argnums=(4,))
def _blurred_in_space(
    grid: jax.Array, variance: jax.Array, lags: list[jax.Array], cells: Extent, little_memory: bool
) -> jax.Array:
    """(bins, planes, rows, columns + 2) to (bins, planes, rows + 3, columns + 2), the last two dropped."""
    bins, count, rows, width = grid.shape
    reach = _reach(variance)
    down, across = (_mirrored(*axis, reach) for axis in zip(lags, cells, (rows, width - 2)))
    across = across[:, :width]
    apart = _of_batch(reach + 1)

    def filtered(kernels: Kernels, planes: jax.Array) -> jax.Array:
        down, across, apart = kernels
        # of whole vectors, as what is left of a row would be summed number by number
        across = jnp.pad(across, ((0, 0), (0, width - across.shape[1] + -width % _LANES)))
        wide = _weighted(down, store(_weighted(across, planes, 2, apart)), 1, apart)
        return store(wide)[..., :width]

    def transposed(kernels: Kernels, cotangent: jax.Array) -> jax.Array:
        down, across, apart = kernels
        return filtered(store((down.T, across.T, apart)), cotangent)

    run = filtered
    if little_memory:
        run = partial(by_platform, cpu=partial(_in_groups, filtered), default=filtered)
    planes = grid.reshape(-1, rows, width)
    return linear_call(run, transposed, (down, across, apart), planes).reshape(bins, count, -1, width)


@_blurred_in_space.defjvp
def _blurred_in_space_jvp(little_memory: bool, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """The slope to the variance is half the Laplacian, of what is blurred as well as of the result."""
    (grid, variance, lags, cells), (d_grid, d_variance, *_) = primals, tangents
    change = d_grid + scaled(d_variance, store(_half_laplacian(grid, cells)))
    blur = partial(_blurred_in_space, little_memory=little_memory)
    return blur(grid, variance, lags, cells), blur(change, variance, lags, cells)


def _half_laplacian(grid: jax.Array, cells: Extent) -> jax.Array:
    """Of rows and columns, mirrored at the borders of the picture's cells; beyond them without a meaning."""
    total = -2 * grid
    for axis, n in zip((2, 3), cells):
        wide = jnp.pad(grid, [(1, 1) if a == axis else (0, 0) for a in range(grid.ndim)])
        before, after = (lax.slice_in_dim(wide, at, at + grid.shape[axis], axis=axis) for at in (0, 2))
        place = lax.broadcasted_iota(jnp.int32, grid.shape, axis)
        total += 0.5 * (jnp.where(place == 0, grid, before) + jnp.where(place == n - 1, grid, after))
    return total


def _in_groups(filtered: Filter, kernels: Kernels, grid: jax.Array) -> jax.Array:
    """`filtered(kernels, grid)`, some planes at a time, each where it was: in half of the memory."""
    height, (count, rows, width) = kernels[0].shape[1], grid.shape
    some = math.gcd(count, _AT_ONCE)

    def body(i: jax.Array, planes: jax.Array) -> jax.Array:
        own = lax.dynamic_slice(planes, (i * some, 0, 0), (some, rows, width))
        return lax.dynamic_update_slice_in_dim(planes, filtered(kernels, own), i * some, 0)

    room = jnp.pad(grid, ((0, 0), (0, max(height - rows, 0)), (0, 0)))
    return lax.fori_loop(0, count // some, body, room)[:, :height]


def _weighted(weights: jax.Array, x: jax.Array, axis: int, apart: jax.Array | None = None) -> jax.Array:
    """`y[i] = sum_k weights[k, i] x[k]` along an axis, k after k.

    Args:
        weights: (x's size along the axis, n).
        x: any shape.
        axis: of x, and of the result.
        apart: weights are 0 where |k - i| is more, the same for a whole batch; None: nowhere.
    """
    count, n = weights.shape
    column = [-1 if a == axis else 1 for a in range(x.ndim)]

    @jax.jit  # traced for one term, and called for the others
    def term(total: jax.Array, weights: jax.Array, x: jax.Array, at: jax.Array) -> jax.Array:
        own = lax.dynamic_index_in_dim(weights, at, keepdims=False).reshape(column)
        return total + own * lax.dynamic_slice_in_dim(x, at, 1, axis)

    def added(total: jax.Array, weights: jax.Array, first: Any, terms: int) -> jax.Array:
        for k in range(terms):
            total = term(total, weights, x, first + np.uint32(k))  # unsigned, or it is tested for its sign
        return total

    zero = unknown_zeros([n if a == axis else size for a, size in enumerate(x.shape)], x, weights)
    if count <= _UNROLLED:
        return added(zero, weights, np.uint32(0), count)
    # beyond the last term the weight is 0, and x is its last
    weights, turns = jnp.pad(weights, ((0, -count % _TERMS), (0, 0))), -(-count // _TERMS)

    def looped(total: jax.Array, weights: jax.Array, low: Any, high: Any) -> jax.Array:
        def turn(i: jax.Array, total: jax.Array) -> jax.Array:
            return added(total, weights, (on_all_cores(i) * _TERMS).astype(jnp.uint32), _TERMS)

        return lax.fori_loop(low, high, turn, total)

    if apart is None or n <= _WHOLE:
        return looped(zero, weights, 0, turns)

    def tile(t: jax.Array, y: jax.Array) -> jax.Array:
        start = jnp.minimum(t * _TILE, n - _TILE)
        low = jnp.maximum(start - apart, 0) // _TERMS
        high = jnp.minimum((start + _TILE + apart) // _TERMS + 1, turns)
        own = lax.dynamic_slice_in_dim(weights, start, _TILE, 1)
        total = lax.slice_in_dim(zero, 0, _TILE, axis=axis)
        return lax.dynamic_update_slice_in_dim(y, looped(total, own, low, high), start, axis)

    return lax.fori_loop(0, -(-n // _TILE), tile, zero)


def _mirrored(lags: jax.Array, n: jax.Array, size: int, reach: jax.Array) -> jax.Array:
    """(size, size + 3): the weights of the first n cells, mirrored at both ends (half-sample), 0 beyond them.

    In the cells from -1 to size + 1; the lags are those of a period of 2 n.
    """
    cells = np.arange(size, dtype=np.int32)[:, None]
    to = np.arange(-1, size + 2, dtype=np.int32)[None]
    apart, mirrored = np.abs(cells - to), lax.rem(cells + to + 1, 2 * n)
    both = (lags.at[i].get(mode="clip") for i in (apart, jnp.minimum(mirrored, 2 * n - mirrored)))
    return jnp.where((cells < n) & (apart <= reach), sum(both), 0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _periodic_gaussian(count: int, n: jax.Array, variance: jax.Array) -> jax.Array:
    """The discrete Gaussian with a period of 2 n samples, n < count, at `count` lags and some more."""
    k = lax.iota(jnp.int32, -(-count // _VECTOR) * _VECTOR)
    half, period = n.astype(variance.dtype), jnp.full_like(k, 2 * n)
    ends = jnp.where(k < n, jnp.where(k == 0, 0.5, 1.0), jnp.where(k == n, 0.5, 0.0)).astype(half.dtype)
    # the exponent is cos(pi k / n) - 1, without what that would lose
    decay = jnp.exp(-2 * variance * jnp.sin(k.astype(half.dtype) / half * (np.pi / 2)) ** 2)
    shares = ends / half * decay

    def add(i: jax.Array, total: jax.Array) -> jax.Array:
        turn = lax.rem(i * k, period).astype(half.dtype) / half
        return total + lax.dynamic_index_in_dim(shares, i, keepdims=False) * jnp.cos(turn * np.pi)

    return lax.fori_loop(0, count, add, jnp.zeros_like(shares))


@_periodic_gaussian.defjvp
def _periodic_gaussian_jvp(count: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """The slope to the variance is half the Laplacian."""
    lags = _periodic_gaussian(count, *primals)
    near = jnp.concatenate([lags[1:2], lags, lags[-1:]])
    return lags, tangents[1] * (0.5 * (near[:-2] + near[2:]) - lags)


def _reach(variance: jax.Array) -> jax.Array:
    """The lag beyond which the discrete Gaussian is lost in the rounding of its dtype; int32."""
    widths, least = (5.5, 4) if variance.dtype == jnp.float32 else (8.5, 12)
    return jnp.ceil(widths * jnp.sqrt(variance) + least).astype(jnp.int32)


@custom_vmap
def _of_batch(most: jax.Array) -> jax.Array:
    """The largest of a batch, as the bound of a loop has to be."""
    return most


@_of_batch.def_vmap
def _of_batch_vmap(size: int, batched: list[bool], most: jax.Array) -> tuple[jax.Array, bool]:
    return _of_batch(most.max(initial=0)), False
