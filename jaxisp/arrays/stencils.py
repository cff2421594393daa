"""Stencils on (H, W) planes: padding, shifted views, separable filters.

The form that is fast: pad once, a barrier, then static slices. Convolutions through `lax.conv` are
40 to 60 times slower on a CPU.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero

from jaxisp.arrays.barriers import barrier_on_cpu, materialize, store
from jaxisp.arrays.linear import inner_product, linear_call, total
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.safe_math import safe_divide
from jaxisp.arrays.varying import alike

Margin = int | tuple[int, int]
_NARROW = 256  # px: beyond, a frame is wide
_MOST_ROWS = 13  # that a CPU's kernel reads: of more, its nearest cache loses some before the next row
_MOST_TAPS = 2 * _MOST_ROWS  # of a fused kernel: beyond some 40 XLA's CPU code is 10 times slower


def pad(
    plane: jax.Array, radius: int | tuple[Margin, Margin], mode: str = "reflect", *, whole: bool = False
) -> jax.Array:
    """Pad by (rows, columns) on each side and store the result.

    Args:
        plane: (H, W), or (H, W, C).
        radius: one number, or (rows, columns), each a number or (before, after).
        mode: "reflect" (the edge pixel is not repeated: keeps the phase of a mosaic), "edge",
            "symmetric", "constant" (0). Any size works, also one smaller than the radius; an axis of one
            pixel has nothing to reflect and repeats it.
        whole: True where several kernels read the result, or one reads it many times: else, of a wide frame,
            a CPU stores the columns alone, and the readers look the rows up.
    """
    margins = (radius, radius) if isinstance(radius, int) else radius
    rows, columns = ((m, m) if isinstance(m, int) else m for m in margins)
    return _bordered(plane, rows, columns, mode, whole)


@partial(jax.jit, static_argnums=(1, 2, 3, 4))
def _bordered(
    plane: jax.Array, rows: tuple[int, int], columns: tuple[int, int], mode: str, whole: bool
) -> jax.Array:
    # a function of its own: a stage pads many planes alike, and each kind is traced and written down once
    widths, wide = (rows, columns), plane.shape[1] > _NARROW
    shape, dtype = plane.shape, plane.dtype
    if mode == "constant" or not any(rows) or (whole and wide and any(columns)):
        return lax.optimization_barrier(_joined(plane, widths, mode))

    # the rows looked up, as XLA's CPU code takes longer to join them; in narrow frames before the columns
    # are joined, so that all is stored
    def looked_up(_: Any, x: jax.Array) -> jax.Array:
        if wide:
            return _rows(barrier_on_cpu(_joined(x, [(0, 0), columns], mode)), rows, mode)
        return _joined(_rows(x, rows, mode), [(0, 0), columns], mode)

    def joined_back(_: Any, y: jax.Array) -> jax.Array:
        like = alike(jnp.zeros(shape, dtype), y)
        return jax.linear_transpose(lambda x: _joined(x, widths, mode), like)(y)[0]

    return lax.optimization_barrier(linear_call(looked_up, joined_back, (), plane))


def _joined(plane: jax.Array, widths: Sequence[tuple[int, int]], mode: str) -> jax.Array:
    for axis, width in enumerate(widths):
        if any(width):
            each = [width if a == axis else (0, 0) for a in range(plane.ndim)]
            plane = jnp.pad(plane, each, mode=_of_size(plane.shape[axis], mode))
    return plane


def _rows(plane: jax.Array, width: tuple[int, int], mode: str) -> jax.Array:
    height = len(plane)
    found = _at_places(plane.reshape(height, -1), width, 0, mode)
    return found.reshape(len(found), *plane.shape[1:])


def _at_places(plane: jax.Array, width: tuple[int, int], axis: int, mode: str) -> jax.Array:
    """Padded along an axis, each place looked up."""
    size = plane.shape[axis]
    place = np.pad(np.arange(size, dtype=np.int32), width, mode=_of_size(size, mode))
    return jnp.take(plane, place, axis=axis, mode="clip")


def _of_size(size: int, mode: str) -> Any:
    return "edge" if mode == "reflect" and size == 1 else mode


def views(
    padded: jax.Array, offsets: Sequence[tuple[int, int]], radius: int | tuple[int, int]
) -> list[jax.Array]:
    """The (H, W) views of a padded plane moved by (dy, dx): view[y, x] = plane[y + dy, x + dx]."""
    ry, rx = (radius, radius) if isinstance(radius, int) else radius
    h, w = padded.shape[0] - 2 * ry, padded.shape[1] - 2 * rx
    return [lax.slice(padded, (ry + dy, rx + dx), (ry + dy + h, rx + dx + w)) for dy, dx in offsets]


def edge_counts(shape: tuple[int, ...], dtype: Any, edge: float = 2) -> jax.Array:
    """(H, W): `edge` on the first and last row, times `edge` on the first and last column, else 1.

    With 0.5 in place of 2 it is the inverse, without a division, whose result XLA would store.

    It turns the adjoint of a reflected window into a reflected window. With `out_p = sum_q f(q, p)`
    over the window of p, an interior q meets p directly and through its own mirror image, which is as
    often as q meets p and the mirror image of p. A pixel on the mirror line has no second image, so
    `sum_p f(q, p) = sum_p f(q, p) counts_p / counts_q` over the reflected window of q.
    """

    def line(axis: int) -> jax.Array:
        index = lax.broadcasted_iota(jnp.int32, shape, axis)
        last = shape[axis] - 1
        return jnp.where(((index == 0) | (index == last)) & (last > 0), jnp.asarray(edge, dtype), 1)

    return line(0) * line(1)


def square(radius: int) -> list[tuple[int, int]]:
    """All (dy, dx) of the window of that radius, row by row."""
    span = range(-radius, radius + 1)
    return [(dy, dx) for dy in span for dx in span]


def filter_rows_columns(
    image: jax.Array,
    taps_y: Sequence[Any] | jax.Array,
    taps_x: Sequence[Any] | jax.Array,
    mode: str = "reflect",
) -> jax.Array:
    """Correlate an (H, W) plane or (H, W, C) image with the outer product of two odd-length tap vectors.

    An interleaved image is filtered as it is, which is faster than plane by plane.

    Gradient: exact, to the image and to the taps.
    """
    taps_y, taps_x = (jnp.asarray(taps, image.dtype) for taps in (taps_y, taps_x))
    return _filtered(image, taps_y, taps_x, mode)


@partial(jax.jit, static_argnums=3)  # as `_bordered`
def _filtered(image: jax.Array, taps_y: jax.Array, taps_x: jax.Array, mode: str) -> jax.Array:
    return _filter(store(_filter(image, taps_x, 1, mode)), taps_y, 0, mode)


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def _filter(image: jax.Array, taps: jax.Array, axis: int, mode: str) -> jax.Array:
    """`y[i] = sum_k taps[k] x[i + k - r]` along an axis."""
    r = taps.shape[0] // 2

    def from_padded(image: jax.Array, taps: jax.Array) -> jax.Array:
        return _weighted(_padded(image, r, axis, mode), taps, axis)

    def looked_up(image: jax.Array, taps: jax.Array) -> jax.Array:
        # a GPU looks rows up as fast as it reads them in order, which saves a copy of the image; not columns
        return _weighted(_at_places(lax.optimization_barrier(image), (r, r), axis, mode), taps, axis)

    default = looked_up if axis == 0 and mode != "constant" else from_padded
    return by_platform(image, taps, cpu=from_padded, default=default)


def _filter_jvp(axis: int, mode: str, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """Both transposes are written as reads: autodiff of the slices is many times slower on a CPU."""
    image, taps = primals
    image_change, taps_change = tangents
    y = _filter(image, taps, axis, mode)
    change = jnp.zeros_like(y)
    if not isinstance(image_change, SymbolicZero):
        change = _filter_linearly(image_change, taps, axis, mode)
    if not isinstance(taps_change, SymbolicZero):
        padded = _padded(image, taps.shape[0] // 2, axis, mode)
        change += linear_call(
            lambda p, t: _weighted(p, t, axis), lambda p, y: _products(p, y, axis), padded, taps_change
        )
    return y, change


_filter.defjvp(_filter_jvp, symbolic_zeros=True)


def _filter_linearly(image: jax.Array, taps: jax.Array, axis: int, mode: str) -> jax.Array:
    """`_filter`, as a linear map of the image."""
    return linear_call(
        lambda t, x: _filter(x, t, axis, mode), lambda t, y: _spread(y, t, axis, mode), taps, image
    )


def _spread(cotangent: jax.Array, taps: jax.Array, axis: int, mode: str) -> jax.Array:
    """The transpose of `_filter`: the flipped taps over a wider frame, then its border folded back."""
    r = taps.shape[0] // 2
    wide = _weighted(_padded(cotangent, 2 * r, axis, "constant"), taps[::-1], axis)
    return jax.linear_transpose(lambda x: _padded(x, r, axis, mode), cotangent)(store(wide))[0]


def _products(padded: jax.Array, cotangent: jax.Array, axis: int) -> jax.Array:
    """The inner product of each shifted view with the cotangent."""
    taps = padded.shape[axis] - cotangent.shape[axis] + 1
    flat = cotangent.reshape(cotangent.shape[0], -1)
    return jnp.stack([inner_product(flat, v) for v in _shifts(padded, taps, axis)])


def _padded(image: jax.Array, radius: int, axis: int, mode: str) -> jax.Array:
    return pad(image, (radius, 0) if axis == 0 else (0, radius), mode)


def _shifts(padded: jax.Array, taps: int, axis: int) -> list[jax.Array]:
    """The views of a padded image that the taps weigh, as rows of interleaved pixels."""
    flat = padded.reshape(padded.shape[0], -1)
    step = 1 if axis == 0 else flat.shape[1] // padded.shape[1]
    length = flat.shape[axis] - (taps - 1) * step
    return [lax.slice_in_dim(flat, k * step, k * step + length, axis=axis) for k in range(taps)]


def _weighted(padded: jax.Array, taps: jax.Array, axis: int) -> jax.Array:
    """`sum_k taps[k] x[i + k]` along an axis."""
    count = taps.shape[0]
    # by `lax`: with operators a blur takes twice as long to trace
    taps = taps.astype(padded.dtype)
    each = [lax.index_in_dim(taps, k, keepdims=False) for k in range(count)]
    terms = [lax.mul(lax.broadcast(t, v.shape), v) for t, v in zip(each, _shifts(padded, count, axis))]
    some = _MOST_ROWS if axis == 0 else _MOST_TAPS
    parts = [reduce(lax.add, terms[k : k + some]) for k in range(0, count, some)]
    summed = parts[0]
    for i, part in enumerate(parts[1:], 1):
        keep = materialize if i * some % _MOST_TAPS else store
        summed = keep(summed) + part
    shape = list(padded.shape)
    shape[axis] -= count - 1
    return summed if summed.shape == tuple(shape) else materialize(summed).reshape(shape)


def gaussian_taps(sigma: Any, radius: int) -> jax.Array:
    """(2 radius + 1,) normalised Gaussian weights; sigma may be traced, and 0 gives a delta.

    Args:
        sigma: standard deviation in px.
        radius: where it is cut; at least 3 sigma for a faithful one.
    """
    sigma = jnp.asarray(sigma, jnp.result_type(sigma, 0.0))
    d2 = jnp.arange(-radius, radius + 1.0, dtype=sigma.dtype) ** 2
    exponent = safe_divide(-0.5, sigma**2)  # 0 for sigma 0, where only the delta is wanted
    weights = jnp.where((d2 == 0) | (exponent < 0), jnp.exp(exponent * d2), 0.0)
    return weights / weights.sum()


def gaussian_blur(image: jax.Array, sigma: Any, radius: int) -> jax.Array:
    """Separable Gaussian blur of an (H, W) plane or (H, W, C) image, borders reflected.

    Gradient: exact, to the image and to sigma.
    """
    return _gaussian(image, jnp.asarray(sigma, image.dtype), radius)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _gaussian(image: jax.Array, sigma: jax.Array, radius: int) -> jax.Array:
    taps = gaussian_taps(sigma, radius)
    return filter_rows_columns(image, taps, taps)


def _gaussian_jvp(radius: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """The slope to sigma is two more filters; through the taps it would be one sum a tap."""
    image, sigma = primals
    taps, slope = jax.jvp(lambda s: gaussian_taps(s, radius), (sigma,), (jnp.ones_like(sigma),))
    # along the rows first: that filter takes twice as long as along the columns, and is needed less often so
    rows = store(_filter(image, taps, 1, "reflect"))
    y = _filter(rows, taps, 0, "reflect")
    return y, linear_call(_gaussian_tangent, _gaussian_cotangent, (image, rows, taps, slope), tangents)


def _gaussian_tangent(saved: Any, change: Any) -> jax.Array:
    (image, rows, taps, slope), (d_image, d_sigma) = saved, change
    across = _filter(d_image, taps, 1, "reflect") + d_sigma * _filter(image, slope, 1, "reflect")
    return _filter(store(across), taps, 0, "reflect") + d_sigma * _filter(rows, slope, 0, "reflect")


def _gaussian_cotangent(saved: Any, cotangent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The transpose of `_gaussian_tangent`: as the taps are symmetric, the same filters, edges weighted."""
    image, rows, taps, slope = saved
    back = store(_symmetric_transpose(cotangent, taps, 0))
    by_rows, by_columns = _filter(rows, slope, 0, "reflect"), _filter(image, slope, 1, "reflect")
    by_sigma = store(cotangent * by_rows) + back * by_columns
    return _symmetric_transpose(back, taps, 1), total(by_sigma)


def _symmetric_transpose(cotangent: jax.Array, taps: jax.Array, axis: int) -> jax.Array:
    """The transpose of `_filter` by symmetric taps with borders reflected.

    On the reflected and so periodic plane the filter is its own transpose, and an edge pixel occurs half as
    often as any other.
    """
    shape = [-1 if a == axis else 1 for a in range(cotangent.ndim)]
    count = np.ones(cotangent.shape[axis])
    count[[0, -1]] = 2
    counts = jnp.asarray(count.reshape(shape), cotangent.dtype)
    return _filter(cotangent * counts, taps, axis, "reflect") / counts


_gaussian.defjvp(_gaussian_jvp)
