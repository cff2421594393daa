"""Stencils on (H, W) planes: padding, shifted views, separable filters.

The form that is fast: pad once, a barrier, then static slices. Convolutions through `lax.conv` are
40 to 60 times slower on a CPU.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.numerics import safe_divide


def pad(plane: jax.Array, radius: int | tuple[int, int], mode: str = "reflect") -> jax.Array:
    """Pad by (rows, columns) on each side and store the result.

    Args:
        plane: (H, W).
        radius: one number, or (rows, columns).
        mode: "reflect" (the edge pixel is not repeated: keeps the phase of a mosaic), "edge",
            "symmetric". Any size works, also one smaller than the radius.
    """
    ry, rx = (radius, radius) if isinstance(radius, int) else radius
    if mode == "reflect" and any(n < 2 and r for n, r in zip(plane.shape, (ry, rx))):
        mode = "edge"  # a single row or column has nothing to reflect
    return lax.optimization_barrier(jnp.pad(plane, ((ry, ry), (rx, rx)), mode=mode))


def views(
    padded: jax.Array, offsets: Sequence[tuple[int, int]], radius: int | tuple[int, int]
) -> list[jax.Array]:
    """The (H, W) views of a padded plane moved by (dy, dx): view[y, x] = plane[y + dy, x + dx]."""
    ry, rx = (radius, radius) if isinstance(radius, int) else radius
    h, w = padded.shape[0] - 2 * ry, padded.shape[1] - 2 * rx
    return [lax.slice(padded, (ry + dy, rx + dx), (ry + dy + h, rx + dx + w)) for dy, dx in offsets]


def square(radius: int) -> list[tuple[int, int]]:
    """All (dy, dx) of the window of that radius, row by row."""
    span = range(-radius, radius + 1)
    return [(dy, dx) for dy in span for dx in span]


def filter_rows_columns(
    plane: jax.Array,
    taps_y: Sequence[Any] | jax.Array,
    taps_x: Sequence[Any] | jax.Array,
    mode: str = "reflect",
) -> jax.Array:
    """Correlate an (H, W) plane with the outer product of two odd-length tap vectors.

    Gradient: exact, to the plane and to the taps (reverse mode only).
    """
    taps_y, taps_x = (jnp.asarray(taps, plane.dtype) for taps in (taps_y, taps_x))
    return _filter_columns(_filter_columns(plane, taps_y, mode).T, taps_x, mode).T


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def _filter_columns(plane: jax.Array, taps: jax.Array, mode: str) -> jax.Array:
    """`y[i] = sum_k taps[k] x[i + k - r]` down each column."""
    r = taps.shape[0] // 2
    return _weighted(pad(plane, (r, 0), mode), taps, plane.shape[0])


def _filter_forward(plane: jax.Array, taps: jax.Array, mode: str) -> tuple[jax.Array, Any]:
    return _filter_columns(plane, taps, mode), (plane, taps)


def _filter_backward(mode: str, saved: Any, cotangent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The adjoint, written as reads: autodiff of the slices is hundreds of times slower on a CPU."""
    plane, taps = saved
    n, r = plane.shape[0], taps.shape[0] // 2
    padded = pad(plane, (r, 0), mode)
    to_taps = jnp.stack([jnp.vdot(cotangent, padded[k : k + n]) for k in range(2 * r + 1)])
    if mode != "reflect" or not 0 < r < n:  # rare or small: leave the folding of the border to autodiff
        (to_plane,) = jax.vjp(lambda x: _weighted(pad(x, (r, 0), mode), taps, n), plane)[1](cotangent)
        return to_plane, to_taps
    spread = lax.optimization_barrier(jnp.pad(cotangent, ((2 * r, 2 * r), (0, 0))))
    whole = _weighted(spread, taps[::-1], n + 2 * r)
    top = jnp.pad(whole[:r][::-1], ((1, n - r - 1), (0, 0)))
    bottom = jnp.pad(whole[n + r :][::-1], ((n - r - 1, 1), (0, 0)))
    return whole[r : r + n] + top + bottom, to_taps


_filter_columns.defvjp(_filter_forward, _filter_backward)


def _weighted(padded: jax.Array, taps: jax.Array, length: int) -> jax.Array:
    return reduce(jnp.add, [taps[k] * padded[k : k + length] for k in range(taps.shape[0])])


def gaussian_taps(sigma: Any, radius: int) -> jax.Array:
    """(2 radius + 1,) normalised Gaussian weights; sigma may be traced, and 0 gives a delta.

    Args:
        sigma: standard deviation in px.
        radius: where it is cut; at least 3 sigma for a faithful one.
    """
    d2 = jnp.arange(-radius, radius + 1.0) ** 2
    exponent = safe_divide(-0.5, jnp.asarray(sigma) ** 2)  # 0 for sigma 0, where only the delta is wanted
    weights = jnp.where((d2 == 0) | (exponent < 0), jnp.exp(exponent * d2), 0.0)
    return weights / weights.sum()


def gaussian_blur(plane: jax.Array, sigma: Any, radius: int) -> jax.Array:
    """Separable Gaussian blur of an (H, W) plane, borders reflected.

    Gradient: exact, to the plane and to sigma (reverse mode only).
    """
    taps = gaussian_taps(sigma, radius).astype(plane.dtype)
    return filter_rows_columns(plane, taps, taps)
