"""The blur of the bilateral grid along its three axes: discrete Gaussians (Lindeberg 1990), as products."""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import store
from jaxisp.arrays.linear import fused_sum, linear_call, scaled
from jaxisp.arrays.platforms import by_platform

Kernels = tuple[jax.Array, jax.Array]  # from the left and from the right

_AT_ONCE = 8  # planes, where memory is to be little
_ROWS = 16  # so many that XLA takes one way of multiplying for every batch
_times = partial(jnp.matmul, precision=lax.Precision.HIGHEST)  # a GPU would round to 10 bits


def blurred(
    grid: jax.Array, columns: int, by_space: jax.Array, by_range: jax.Array, *, little_memory: bool = False
) -> jax.Array:
    """Blur a grid along bins, rows and columns; borders are mirrored, and the bins go on as zeros.

    Args:
        grid: (bins, planes, rows * (columns + 2)); the last two columns of each row are dropped.
        columns: how many cells a row has.
        by_space: variance along rows and columns, in squared cells.
        by_range: variance along bins, in squared bins.
        little_memory: True has a CPU take some planes at a time, each where it was.

    Returns:
        (bins, planes, (rows + 3) * (columns + 2)): with a border of one cell, at the bottom of two.

    Gradient: exact, in both modes.
    """
    bins, count, _ = grid.shape
    along_bins = _times(_gaussian(bins, by_range), grid.reshape(bins, -1))
    cells = along_bins.reshape(bins, count, -1, columns + 2)
    return _blurred_in_space(cells, by_space, little_memory).reshape(bins, count, -1)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _blurred_in_space(grid: jax.Array, variance: jax.Array, little_memory: bool) -> jax.Array:
    """(bins, planes, rows, columns + 2) to (bins, planes, rows + 3, columns + 2), the last two dropped."""
    bins, count, rows, width = grid.shape
    down = jnp.pad(_mirrored_gaussian(rows, variance), ((1, 2), (0, 0)), "edge")
    across = jnp.pad(_mirrored_gaussian(width - 2, variance).T, ((0, 0), (1, 1)), "edge")
    across = jnp.pad(across, ((0, 2), (0, 0)))  # what the two columns more hold is dropped
    filtered = _filtered
    if little_memory:
        filtered = partial(by_platform, cpu=_in_groups, default=_filtered)

    def transposed(kernels: Kernels, cotangent: jax.Array) -> jax.Array:
        # fast on a CPU only with the matrices stored transposed
        return filtered(store((kernels[0].T, kernels[1].T)), cotangent)

    kernels, planes = (down, across), grid.reshape(-1, rows, width)
    return linear_call(filtered, transposed, kernels, planes).reshape(bins, count, -1, width)


@_blurred_in_space.defjvp
def _blurred_in_space_jvp(little_memory: bool, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """The slope to the variance is half the Laplacian of the result, mirrored as its border is."""
    (grid, variance), (d_grid, d_variance) = primals, tangents
    y = _blurred_in_space(grid, variance, little_memory)
    change = _blurred_in_space(d_grid, variance, little_memory)
    inner = y[..., 1:-2, 1:-1]
    vertical, horizontal = y[..., :-3, 1:-1] + y[..., 2:-1, 1:-1], y[..., 1:-2, :-2] + y[..., 1:-2, 2:]
    slope = 0.5 * (vertical + horizontal) - 2 * inner
    # stored first, or each part of the border would work it out
    bordered = jnp.pad(store(slope), ((0, 0), (0, 0), (1, 2), (1, 1)), "edge")
    return y, change + scaled(d_variance, store(bordered))


def _filtered(kernels: Kernels, grid: jax.Array) -> jax.Array:
    """`down @ plane @ across` for each of (planes, rows, columns)."""
    down, across = kernels
    turned = _times(grid.reshape(-1, grid.shape[2]), across).reshape(*grid.shape[:2], -1)

    def by_plane(m: jax.Array, g: jax.Array) -> jax.Array:
        # for a single product XLA transposes the grid, before and after
        return _times(jnp.broadcast_to(m, (len(g), *m.shape)), g)

    def summed(m: jax.Array, g: jax.Array) -> jax.Array:
        # a product would store the matrix once for each plane
        return fused_sum(m.T[:, :, None] * g[:, :, None], 1)

    return by_platform(down, turned, cpu=by_plane, default=summed)


def _in_groups(kernels: Kernels, grid: jax.Array) -> jax.Array:
    """`_filtered`, some planes at a time, each where it was: in half of the memory."""
    height, (count, rows, width) = kernels[0].shape[0], grid.shape
    some = math.gcd(count, _AT_ONCE)

    def body(i: jax.Array, planes: jax.Array) -> jax.Array:
        own = lax.dynamic_slice(planes, (i * some, 0, 0), (some, rows, width))
        return lax.dynamic_update_slice_in_dim(planes, _filtered(kernels, own), i * some, 0)

    room = jnp.pad(grid, ((0, 0), (0, max(height - rows, 0)), (0, 0)))
    return lax.fori_loop(0, count // some, body, room)[:, :height]


def _mirrored_gaussian(n: int, variance: jax.Array) -> jax.Array:
    """(n, n): the discrete Gaussian over n samples, mirrored at both ends (half-sample)."""
    k = np.arange(n)
    cosines = np.sqrt((2 - (k == 0)) / n)[:, None] * np.cos(np.pi / n * np.outer(k, k + 0.5))
    decay = jnp.exp(variance * jnp.asarray(np.cos(np.pi / n * k) - 1, variance.dtype))
    basis = jnp.asarray(cosines, variance.dtype)
    return _times(basis.T * decay, basis)


def _gaussian(n: int, variance: jax.Array) -> jax.Array:
    """(n, n): the discrete Gaussian over n samples of a longer row."""
    k = np.arange(n + 1)
    share = np.where(k % n == 0, 1, 2) / (2 * n)
    lags = np.cos(np.pi / n * np.outer(k[:n], k)) * share
    decay = jnp.exp(variance * jnp.asarray(np.cos(np.pi / n * k) - 1, variance.dtype))
    # of sixteen rows that are the same, as XLA sums a product of few in another order; with the barrier it
    # does not see that one would do
    rows = jnp.broadcast_to(decay, (_ROWS, n + 1))
    products = _times(rows, lax.optimization_barrier(jnp.asarray(lags, variance.dtype)).T)
    return products[0][np.abs(k[:n, None] - k[:n])]
