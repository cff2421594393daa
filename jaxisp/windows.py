"""Stencils on (H, W) planes: padding, shifted views, separable filters.

The form that is fast: pad once, a barrier, then static slices. Convolutions through `lax.conv` are
40 to 60 times slower on a CPU.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

from jaxisp.linear import inner_product, linear_call, scaled
from jaxisp.numerics import materialize, safe_divide

_MOST_TAPS = 32  # of a fused kernel: beyond some 40 XLA's CPU code is 10 times slower
_LARGE, _STRIP = 1 << 18, 1 << 17  # px: a frame that is worth strips, and one of them
ROWS = 64
"""Rows of a strip: few enough for the caches, many enough that the rows around it cost little."""


def pad(plane: jax.Array, radius: int | tuple[int, int], mode: str = "reflect") -> jax.Array:
    """Pad by (rows, columns) on each side and store the result.

    Args:
        plane: (H, W), or (H, W, C).
        radius: one number, or (rows, columns).
        mode: "reflect" (the edge pixel is not repeated: keeps the phase of a mosaic), "edge",
            "symmetric", "constant" (0). Any size works, also one smaller than the radius.
    """
    ry, rx = (radius, radius) if isinstance(radius, int) else radius
    if mode == "reflect" and any(n < 2 and r for n, r in zip(plane.shape, (ry, rx))):
        mode = "edge"  # a single row or column has nothing to reflect
    width = ((ry, ry), (rx, rx), *[(0, 0)] * (plane.ndim - 2))
    return lax.optimization_barrier(jnp.pad(plane, width, mode=mode))


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


def in_strips(fn: Callable[[Any], Any], image: Any, reach: int, *, rows: int = ROWS, unit: int = 2) -> Any:
    """`fn(image)`, strip of rows by strip, in the memory of a strip.

    Args:
        fn: from what `image` is to a pytree of arrays with the rows first. It may depend on a row's
            parity or on its place in a block, not on more of where it stands.
        image: (H, W) or (H, W, C), or a pytree of such.
        reach: how far from a row its result depends on the image [rows].
        rows: of a strip.
        unit: rows of a block, 2 for a mosaic: a strip begins where one does.
    """
    height, halo = jax.tree.leaves(image)[0].shape[0], -(-reach // unit) * unit
    step = -(-rows // unit) * unit
    core = step + height % unit  # the last strip ends with the frame, and has the same shape as the others
    window = core + 2 * halo
    if window >= height:
        return fn(image)

    def one(top: Any) -> Any:
        # stored before and after, or each read of a strip works out where it is: 2 to 4 times slower
        strip = jax.tree.map(lambda x: lax.dynamic_slice_in_dim(x, top, window), image)
        return materialize(fn(materialize(strip)))

    def body(i: jax.Array, frame: Any) -> Any:
        start = jnp.minimum(i * step, height - core)
        # within the frame: so borders are treated where the frame's are
        top = jnp.clip(start - halo, 0, height - window)
        done = jax.tree.map(lambda s: lax.dynamic_slice_in_dim(s, start - top, core), one(top))
        return jax.tree.map(lambda f, s: lax.dynamic_update_slice_in_dim(f, s, start, axis=0), frame, done)

    empty = jax.tree.map(lambda s: jnp.zeros((height, *s.shape[1:]), s.dtype), jax.eval_shape(one, 0))
    return lax.fori_loop(0, -(-(height - core) // step) + 1, body, empty)


def in_strips_on_cpu(
    fn: Callable[..., Any], image: Any, reach: int, others: tuple[Any, ...] = (), unit: int = 2
) -> Any:
    """`fn(image, *others)`; on a CPU `in_strips` where the frame is large.

    Its scratch memory would take longer to get than strips take more: the C library has blocks of over
    32 MB from the system anew at every call, page by page.

    Gradient: that of `fn` on the whole frame.
    """
    height, width = jax.tree.leaves(image)[0].shape[:2]
    if height < 4 * ROWS or height * width < _LARGE:
        return fn(image, *others)
    rows = max(ROWS, _STRIP // width, 12 * reach)
    leaves, tree = jax.tree.flatten((image, *others))

    def whole(*leaves: jax.Array) -> Any:
        return fn(*jax.tree.unflatten(tree, leaves))

    def strips(*leaves: jax.Array) -> Any:
        image, *others = jax.tree.unflatten(tree, leaves)
        return in_strips(lambda strip: fn(strip, *others), image, reach, rows=rows, unit=unit)

    return _stripped(whole, strips, *leaves)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _stripped(whole: Callable[..., Any], strips: Callable[..., Any], *leaves: Any) -> Any:
    return lax.platform_dependent(*leaves, cpu=strips, default=whole)


def _stripped_jvp(
    whole: Callable[..., Any], strips: Callable[..., Any], primals: Any, tangents: Any
) -> tuple[Any, Any]:
    moving = [i for i, t in enumerate(tangents) if not isinstance(t, SymbolicZero)]

    def of(*moved: Any) -> Any:
        return whole(*(moved[moving.index(i)] if i in moving else p for i, p in enumerate(primals)))

    return jax.jvp(of, [primals[i] for i in moving], [tangents[i] for i in moving])


_stripped.defjvp(_stripped_jvp, symbolic_zeros=True)


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
    return _filter(materialize(_filter(image, taps_x, 1, mode)), taps_y, 0, mode)


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def _filter(image: jax.Array, taps: jax.Array, axis: int, mode: str) -> jax.Array:
    """`y[i] = sum_k taps[k] x[i + k - r]` along an axis."""
    return _weighted(_padded(image, taps.shape[0] // 2, axis, mode), taps, axis)


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
    return jax.linear_transpose(lambda x: _padded(x, r, axis, mode), cotangent)(materialize(wide))[0]


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
    terms = [taps[k] * v for k, v in enumerate(_shifts(padded, count, axis))]
    parts = [reduce(jnp.add, terms[k : k + _MOST_TAPS]) for k in range(0, count, _MOST_TAPS)]
    shape = list(padded.shape)
    shape[axis] -= count - 1
    return reduce(lambda total, part: materialize(total) + part, parts).reshape(shape)


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
    """The slope to sigma is three more filters; through the taps it would be one sum a tap."""
    image, sigma = primals
    image_change, sigma_change = tangents
    taps, slope = jax.jvp(lambda s: gaussian_taps(s, radius), (sigma,), (jnp.ones_like(sigma),))
    # along the rows first: that filter takes twice as long as along the columns, and is needed less often so
    rows = materialize(_filter(image, taps, 1, "reflect"))
    y = _filter(rows, taps, 0, "reflect")
    change = jnp.zeros_like(y)
    if not isinstance(image_change, SymbolicZero):
        half = materialize(_filter_linearly(image_change, taps, 1, "reflect"))
        change = _filter_linearly(half, taps, 0, "reflect")
    if not isinstance(sigma_change, SymbolicZero):
        steep = materialize(_filter(image, slope, 1, "reflect"))
        by_sigma = _filter(rows, slope, 0, "reflect") + _filter(steep, taps, 0, "reflect")
        change += scaled(sigma_change, by_sigma)
    return y, change


_gaussian.defjvp(_gaussian_jvp, symbolic_zeros=True)
