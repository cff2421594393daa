"""The bilateral grid: a joint bilateral filter whose cost does not grow with its width.

Pixels are spread over a grid of square cells and of bins of the guide, the grid is blurred, and each
pixel reads it back at its own place and guide value. Tents stand for the bins, so that all of it is
dense: no gather, no scatter.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxisp.linear import linear_call
from jaxisp.numerics import materialize

Planes = tuple[jax.Array, ...]

_MOST_TERMS = 32  # in one fused kernel
_FINEST = 4.0  # bins to a sigma_range; more would not be more exact


def grid_planes(
    planes: Planes, guide: jax.Array, sigma_space: Any, sigma_range: Any, cell: int = 4, bins: int = 32
) -> Planes:
    """What `bilateral_planes` gives with a radius without end, within 40 dB PSNR, in a fraction of the time.

    The grid has a bin for each of `bins` equal steps between the least and the greatest of the guide. Box,
    tents and blur together have the variances sigma_space**2 and sigma_range**2; the blur is the discrete
    Gaussian (Lindeberg 1990), whose variance is exact at any width.

    Args:
        planes: (H, W) each; the weights are shared.
        guide: (H, W).
        sigma_space: [px]; below cell / 2 it acts as cell / 2.
        sigma_range: in the unit of the guide; below 0.58 steps between bins it acts as that.
        cell: side of a cell [px], even.
        bins: how many.

    Returns:
        The filtered planes. Borders are mirrored, at a multiple of the cell.

    Gradient: exact, of what is computed, in both modes.

    Source: Chen, Paris & Durand 2007; Paris & Durand 2006.
    """
    height, width = guide.shape
    low, high = guide.min(), guide.max()
    step = jnp.maximum((high - low) / (bins - 1), sigma_range / _FINEST)
    u, *v = (_to_phases(x, cell) for x in ((guide - low) / step, *planes))
    u, values = materialize((u, jnp.stack([jnp.ones_like(u), *v])))
    # in cells and bins; a box has 1/12 and a tent 1/6 of a squared side
    by_space = jnp.maximum((sigma_space / cell) ** 2 - 1 / 4, 0)
    by_range = jnp.maximum((sigma_range / step) ** 2 - 1 / 3, 0)
    grid = materialize(_blurred(_splat(u, values, bins), guide.shape, cell, by_space, by_range))
    weight, *sums = _sliced(u, grid, cell, -(-width // cell) + 2)
    return tuple(_from_phases(s / jnp.maximum(weight, 1e-12), cell, height, width) for s in sums)


# A plane is held as (cell**2, L): where in its cell, then the cells row by row. Each row of cells has two
# columns more on its right, so that neighbouring cells are static slices of one axis.


def _to_phases(plane: jax.Array, cell: int) -> jax.Array:
    for axis, n in enumerate(plane.shape):
        pads = [(0, -n % cell) if a == axis else (0, 0) for a in range(2)]
        plane = jnp.pad(plane, pads, mode="reflect" if n > 1 else "edge")
    rows, columns = (n // cell for n in plane.shape)
    phases = plane.reshape(rows, cell, columns, cell).transpose(1, 3, 0, 2)
    return jnp.pad(phases, ((0, 0), (0, 0), (0, 0), (0, 2))).reshape(cell * cell, -1)


def _from_phases(phases: jax.Array, cell: int, height: int, width: int) -> jax.Array:
    rows, columns = -(-height // cell), -(-width // cell)
    full = phases.reshape(cell, cell, rows, columns + 2)[..., :columns]
    return full.transpose(2, 0, 3, 1).reshape(rows * cell, columns * cell)[:height, :width]


def _blurred(grid: jax.Array, shape: tuple[int, ...], cell: int, by_space: Any, by_range: Any) -> jax.Array:
    """Blur (bins, planes, L) along all three axes; the result has a border of one cell, at the bottom two."""
    bins, count, _ = grid.shape
    rows, columns = (-(-n // cell) for n in shape)
    down = jnp.pad(_mirrored_gaussian(rows, by_space), ((1, 2), (0, 0)), "edge")
    across = jnp.pad(_mirrored_gaussian(columns, by_space), ((1, 1), (0, 0)), "edge")
    across = jnp.pad(across, ((0, 0), (0, 2)))  # what the two columns more hold is dropped
    grid = (_gaussian(bins, by_range) @ grid.reshape(bins, -1)).reshape(-1, columns + 2)
    grid = (grid @ across.T).reshape(bins * count, rows, columns + 2)
    return jnp.einsum("ij,kjx->kix", down, grid).reshape(bins, count, -1)


def _mirrored_gaussian(n: int, variance: jax.Array) -> jax.Array:
    """(n, n): the discrete Gaussian over n samples, mirrored at both ends (half-sample)."""
    k = np.arange(n)
    cosines = np.sqrt((2 - (k == 0)) / n)[:, None] * np.cos(np.pi / n * np.outer(k, k + 0.5))
    decay = jnp.exp(variance * jnp.asarray(np.cos(np.pi / n * k) - 1, variance.dtype))
    basis = jnp.asarray(cosines, variance.dtype)
    return (basis.T * decay) @ basis


def _gaussian(n: int, variance: jax.Array) -> jax.Array:
    """(n, n): the discrete Gaussian over n samples of a longer row."""
    k = np.arange(n + 1)
    share = np.where(k % n == 0, 1, 2) / (2 * n)
    lags = np.cos(np.pi / n * np.outer(k[:n], k)) * share
    decay = jnp.exp(variance * jnp.asarray(np.cos(np.pi / n * k) - 1, variance.dtype))
    return (jnp.asarray(lags, variance.dtype) @ decay)[np.abs(k[:n, None] - k[:n])]


# Splatting and slicing are linear in what they carry, and their slope to u is the same with the tent's
# slope for the tent. The transposes are written as reads: autodiff would scatter each slice.


def _tent(d: jax.Array, slope: bool) -> jax.Array:
    return jnp.where(jnp.abs(d) < 1, -jnp.sign(d), 0) if slope else jnp.maximum(1 - jnp.abs(d), 0)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _splat(u: jax.Array, values: jax.Array, bins: int) -> jax.Array:
    """(bins, planes, L) sums over each cell; values is (planes, cell**2, L)."""
    return _collect(u, values, bins, False)


def _splat_jvp(bins: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    u, values = primals
    u_change, values_change = tangents
    y = _splat(u, values, bins)
    change = jnp.zeros_like(y)
    if not isinstance(values_change, SymbolicZero):
        change += _collect_linearly(u, values_change, bins, False)
    if not isinstance(u_change, SymbolicZero):
        change += _collect_linearly(u, values * u_change, bins, True)
    return y, change


_splat.defjvp(_splat_jvp, symbolic_zeros=True)


def _collect_linearly(u: jax.Array, values: jax.Array, bins: int, slope: bool) -> jax.Array:
    return linear_call(
        lambda u, v: _collect(u, v, bins, slope), lambda u, g: _distribute(u, g, slope), u, values
    )


def _collect(u: jax.Array, values: jax.Array, bins: int, slope: bool) -> jax.Array:
    z = jnp.arange(bins, dtype=u.dtype)[:, None, None]
    terms = [_tent(u[p] - z, slope) * values[:, p] for p in range(len(u))]
    return _sum(terms)


def _distribute(u: jax.Array, grid: jax.Array, slope: bool) -> jax.Array:
    """The transpose of `_collect`."""
    return _sum([_tent(u - z, slope) * grid[z][:, None] for z in range(len(grid))])


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def _sliced(u: jax.Array, grid: jax.Array, cell: int, stride: int) -> jax.Array:
    """(planes, cell**2, L): the grid, bordered, interpolated at each pixel and at u."""
    return _interpolated(u, grid, cell, stride, False)


def _sliced_jvp(cell: int, stride: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    u, grid = primals
    u_change, grid_change = tangents
    y = _sliced(u, grid, cell, stride)
    change = jnp.zeros_like(y)
    if not isinstance(grid_change, SymbolicZero):
        change += linear_call(
            lambda u, g: _interpolated(u, g, cell, stride, False),
            lambda u, c: _spread(u, c, grid.shape, cell, stride),
            u,
            grid_change,
        )
    if not isinstance(u_change, SymbolicZero):
        change += u_change * materialize(_interpolated(u, grid, cell, stride, True))
    return y, change


_sliced.defjvp(_sliced_jvp, symbolic_zeros=True)


def _corners(cell: int, stride: int) -> list[tuple[list[int], list[tuple[int, np.ndarray]]]]:
    """Phases that lie between the same four cells, and for each cell its offset and each phase's weight."""
    centre = (np.arange(cell) + 0.5) / cell + 0.5
    halves = [np.arange(cell // 2), np.arange(cell // 2, cell)]
    weights = [[1 - np.abs(centre[half] - first - a) for a in range(2)] for first, half in enumerate(halves)]
    groups = []
    for first_y, first_x in ((0, 0), (0, 1), (1, 0), (1, 1)):
        phases = (halves[first_y][:, None] * cell + halves[first_x]).ravel().tolist()
        corners = [
            (
                (first_y + a) * stride + first_x + b,
                np.outer(weights[first_y][a], weights[first_x][b]).ravel(),
            )
            for a in range(2)
            for b in range(2)
        ]
        groups.append((phases, corners))
    return groups


def _interpolated(u: jax.Array, grid: jax.Array, cell: int, stride: int, slope: bool) -> jax.Array:
    length, dtype = u.shape[1], u.dtype
    parts, order = [], []
    for phases, corners in _corners(cell, stride):
        own = u[np.array(phases)]
        weighed = [(offset, jnp.asarray(w[:, None], dtype)) for offset, w in corners]
        terms = []
        for z, layer in enumerate(grid):
            near = sum(w * layer[:, None, offset : offset + length] for offset, w in weighed)
            terms.append(_tent(own - z, slope) * near)
        parts.append(materialize(_sum(terms)))
        order += phases
    return jnp.concatenate(parts, axis=1)[:, np.argsort(order)]


def _spread(u: jax.Array, cotangent: jax.Array, shape: tuple[int, ...], cell: int, stride: int) -> jax.Array:
    """The transpose of `_interpolated`."""
    length = shape[2]
    margin = length - u.shape[1]
    wide_u = jnp.pad(u, ((0, 0), (margin, margin)))
    wide = jnp.pad(cotangent, ((0, 0), (0, 0), (margin, margin)))
    wide_u, wide = materialize((wide_u, wide))
    z = jnp.arange(shape[0], dtype=u.dtype)[:, None, None]
    terms = []
    for phases, corners in _corners(cell, stride):
        for offset, weights in corners:
            there = slice(margin - offset, margin - offset + length)
            for p, w in zip(phases, weights):
                terms.append(_tent(wide_u[p, there] - z, False) * (w.astype(u.dtype) * wide[:, p, there]))
    return _sum(terms)


def _sum(terms: list[jax.Array]) -> jax.Array:
    """The sum, in kernels of a bearable size."""
    total = terms[0]
    for i, term in enumerate(terms[1:], 1):
        total = (total if i % _MOST_TERMS else materialize(total)) + term
    return total
