"""Where the lens puts the light: chromatic aberration and distortion."""

import math
from functools import partial, reduce
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import inner_product, linear_call
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.safe_math import clip
from jaxisp.arrays.stencils import pad, views
from jaxisp.arrays.varying import alike
from jaxisp.domains import LinearRGB
from jaxisp.options import at_least
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.optics.centre import from_centre, radius_squared

Places = tuple[jax.Array, jax.Array, jax.Array]  # an image, and rows and columns in it
_STRIP = 1 << 16  # px whose gradient goes back at once: the memory of a large frame's would take long to get
_MOST_SHIFTS = 3  # px; beyond this displacement gathers cost less than sums over shifted views


@parameters
class LateralChromaticAberration:
    """Magnification of red and blue against green."""

    red_scale: Leaf = param(1.0, (0.99, 1.01), "1", doc="above 1 red is larger than green")
    blue_scale: Leaf = param(1.0, (0.99, 1.01), "1", doc="above 1 blue is larger than green")


@register
def lateral_chromatic_aberration(
    params: LateralChromaticAberration, image: LinearRGB, *, most: Annotated[float, at_least(0)] = 0.01
) -> LinearRGB:
    """Magnify red and blue about the image centre; green stays.

    `y_c(p) = x_c(centre + (p - centre) / scale_c)`, bilinear.

    Args:
        params: scales of red and blue; 1 leaves the channel as it is, bit for bit.
        image: (H, W, 3) linear light, any range.
        most: the largest |scale - 1| there is, which says how far a sample may lie; small crops of a picture
            need more than a lens's bounds.

    Returns:
        (H, W, 3) linear light. Outside the image its border pixels go on.

    Gradient: exact. Where a sample falls on a pixel, as at scale 1, it is the mean of both sides
    (above some 600 px that of one side).

    Source: Jaroensri et al. 2019, section 3; Kang 2007, "Automatic removal of chromatic
    aberration from a single image".
    """
    r, g, b = planes(image)
    red, blue = _magnified(r, params.red_scale, most), _magnified(b, params.blue_scale, most)
    return interleaved([red, g, blue])


def _magnified(plane: jax.Array, scale: jax.Array, most: float) -> jax.Array:
    """The plane scaled about its centre."""
    largest = most / (1 - most) + 1e-4  # of |1 / scale - 1|, and rounding
    reach_y, reach_x = (math.ceil(largest * (n - 1) / 2) for n in plane.shape)
    # only out of bounds does clipping change anything
    change = clip(1 / jnp.asarray(scale, plane.dtype) - 1, -largest, largest)
    if max(reach_y, reach_x) > _MOST_SHIFTS:
        rows = materialize(_scaled(plane, change, 0, reach_y, largest))
        return materialize(_scaled(rows, change, 1, reach_x, largest))
    y, x = from_centre(plane.shape, plane.dtype)
    return _shifted(_shifted(plane, change * y, 0, reach_y), change * x, 1, reach_x)


def picked(plane: jax.Array, offset: jax.Array, axis: int) -> jax.Array:
    """Linear interpolation at `offset` px from each row, or column; borders are replicated."""
    n = plane.shape[axis]
    place = jnp.clip(jnp.arange(n, dtype=offset.dtype) + offset, 0, n - 1)
    first = lax.stop_gradient(_first(place, n))
    share, index = jnp.expand_dims(place - first, 1 - axis), first.astype(jnp.int32)
    here, there = (jnp.take(plane, i, axis, mode="clip") for i in (index, index + 1))
    return here + share * (there - here)


@partial(jax.custom_jvp, nondiff_argnums=(2, 3, 4))
def _scaled(plane: jax.Array, change: jax.Array, axis: int, reach: int, largest: float) -> jax.Array:
    """Linear interpolation at `change` times the distance from the centre, whose gradient needs no scatter.

    Args:
        plane: (H, W).
        change: a scalar.
        axis: along which.
        reach: the farthest a sample may lie [px].
        largest: the largest |change|.
    """
    return picked(plane, _offset(plane, change, axis), axis)


def _offset(plane: jax.Array, change: jax.Array, axis: int) -> jax.Array:
    return change * from_centre(plane.shape, plane.dtype)[axis].ravel()


@_scaled.defjvp
def _scaled_jvp(axis: int, reach: int, largest: float, primals: Any, tangents: Any) -> Any:
    def read(change: jax.Array, plane: jax.Array) -> jax.Array:
        return _scaled(plane, change, axis, reach, largest)

    def slope(saved: Any) -> jax.Array:
        # bound anew, or XLA would store every sample that was read, to read it again
        plane, change = map(lax.optimization_barrier, saved)
        return jax.jvp(
            lambda c: picked(plane, _offset(plane, c, axis), axis), (change,), (jnp.ones_like(change),)
        )[1]

    plane, change = primals
    moved = linear_call(read, partial(_spread_scaled, axis, reach, largest), change, tangents[0])
    scaled = linear_call(
        lambda s, d: d * slope(s), lambda s, y: inner_product(slope(s), y), primals, tangents[1]
    )
    return read(change, plane), moved + scaled


def _spread_scaled(axis: int, reach: int, largest: float, change: jax.Array, y: jax.Array) -> jax.Array:
    """The transpose of `_scaled`: each pixel reads those that took of it."""
    n, dtype = y.shape[axis], y.dtype
    pixel, centre = jnp.arange(-reach, n + reach, dtype=dtype), (n - 1) / 2
    place = jnp.arange(n, dtype=dtype) + _offset(y, change, axis)
    first = jnp.floor((pixel - 1 - centre) / (1 + change) + centre).astype(jnp.int32)
    count = math.ceil(2 / (1 - largest)) + 1  # those within a pixel of it, and the one before
    takers = first + np.arange(count)[:, None]
    shares = _tent(jnp.take(place, takers, mode="clip") - pixel)
    shares = materialize(jnp.where((takers >= 0) & (takers < n), shares, 0))

    def along(line: jax.Array) -> jax.Array:
        each = (jnp.take(line, t, axis=0, mode="clip") for t in takers)
        return sum(s.reshape(-1, *[1] * (line.ndim - 1)) * v for s, v in zip(shares, each))

    # row by row where columns are looked up, or XLA would store them the other way round
    wide = jax.vmap(along)(y) if axis else along(y)
    return _folded(wide, axis, reach)


def _folded(wide: jax.Array, axis: int, border: int) -> jax.Array:
    """The transpose of a border that repeats the edge."""
    wide = materialize(wide)
    head, inside, tail = jnp.split(wide, (border, wide.shape[axis] - border), axis)
    index = lax.broadcasted_iota(jnp.int32, inside.shape, axis)
    for place, edge in ((0, head), (inside.shape[axis] - 1, tail)):
        inside += jnp.where(index == place, edge.sum(axis, keepdims=True), 0)
    return inside


def _shifted(plane: jax.Array, offset: jax.Array, axis: int, reach: int) -> jax.Array:
    """Linear interpolation at `offset` px along an axis, |offset| <= reach: its gradient needs no scatter."""
    return linear_call(
        lambda o, x: _read_shifted(x, o, axis, reach),
        lambda o, y: _spread_shifted(y, o, axis, reach),
        offset,
        plane,
    )


def _read_shifted(plane: jax.Array, offset: jax.Array, axis: int, reach: int) -> jax.Array:
    radius, steps = _along(axis, reach), range(-reach, reach + 1)
    moved = views(pad(plane, radius, "edge"), [_along(axis, d) for d in steps], radius)
    return reduce(jnp.add, (_tent(offset - d) * v for d, v in zip(steps, moved)))


def _spread_shifted(cotangent: jax.Array, offset: jax.Array, axis: int, reach: int) -> jax.Array:
    """The transpose of `_read_shifted`, as reads of a wider frame, whose border is then folded back."""
    values = pad(cotangent, _along(axis, 2 * reach), "constant")
    offsets = pad(offset, _along(axis, 2 * reach), "edge")
    size = cotangent.shape[axis] + 2 * reach

    def at(x: jax.Array, d: int) -> jax.Array:
        return lax.slice_in_dim(x, reach - d, reach - d + size, axis=axis)

    wide = reduce(jnp.add, (_tent(at(offsets, d) - d) * at(values, d) for d in range(-reach, reach + 1)))
    return _folded(wide, axis, reach)


def _along(axis: int, step: int) -> tuple[int, int]:
    return (step, 0) if axis == 0 else (0, step)


def _tent(u: jax.Array) -> jax.Array:
    """max(1 - |u|, 0), whose slope at each bend is the mean of both sides (that of jnp.abs is 1 at 0)."""
    return jnp.maximum(jnp.minimum(1 + u, 1 - u), 0)


@parameters
class GeometricDistortion:
    """Radial distortion; monotone over the whole range, so no part of the scene shows twice."""

    k1: Leaf = param(0.0, (-0.2, 0.2), "1", doc="coefficient of r**2; positive is barrel distortion")
    k2: Leaf = param(0.0, (-0.07, 0.07), "1", doc="coefficient of r**4")


@register
def geometric_distortion(params: GeometricDistortion, image: LinearRGB) -> LinearRGB:
    """Displace all channels along the radius.

    `y(p) = x(centre + (p - centre) * (1 + k1 r**2 + k2 r**4))`, bilinear, with r = 1 in the corner.

    Args:
        params: k1 and k2; both 0 leaves the image as it is, bit for bit.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light. Outside the image its border pixels go on.

    Gradient: exact (where a sample falls on a pixel, that of the side of larger coordinates).

    Source: Brown 1966, "Decentering distortion of lenses"; DNG Specification 1.6, WarpRectilinear
    with kr0 = 1, kr1 = k1, kr2 = k2 and the centre (0.5, 0.5).
    """
    y, x = from_centre(image.shape, image.dtype)
    r2 = radius_squared(image.shape, image.dtype)
    change = r2 * (jnp.asarray(params.k1, image.dtype) + jnp.asarray(params.k2, image.dtype) * r2)
    return displaced(image, change * y, change * x)


def displaced(image: jax.Array, dy: jax.Array, dx: jax.Array) -> jax.Array:
    """Bilinear samples of (H, W, C) at each pixel's own place plus (dy, dx); borders are replicated."""
    h, w = image.shape[:2]
    y = jnp.clip(jnp.arange(h, dtype=dy.dtype)[:, None] + dy, 0, h - 1)
    x = jnp.clip(jnp.arange(w, dtype=dx.dtype)[None] + dx, 0, w - 1)
    return _sampled(jnp.asarray(image), jnp.broadcast_to(y, (h, w)), jnp.broadcast_to(x, (h, w)))


@jax.custom_jvp
def _sampled(image: jax.Array, y: jax.Array, x: jax.Array) -> jax.Array:
    """Bilinear samples of (H, W, C) at rows y and columns x, which are within it."""
    a, right, down, across, fy, fx = _corners(image, y, x)
    return a + fx * right + fy * (down + fx * across)


@_sampled.defjvp
def _sampled_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    return _sampled(*primals), linear_call(_moved, _returned, primals, tangents)


def _corners(image: jax.Array, y: jax.Array, x: jax.Array) -> tuple[jax.Array, ...]:
    """Of the four pixels around each place: the first, the differences to the right and down from it and
    the second difference; and the place between them."""
    h, w, channels = image.shape
    top, left = _first(y, h), _first(x, w)
    down, right = min(h - 1, 1) * w, min(w - 1, 1)
    index = top.astype(jnp.int32) * w + left.astype(jnp.int32)
    flat = image.reshape(h * w, channels)
    a, b, c, d = (
        flat.at[index + step].get(mode="promise_in_bounds") for step in (0, right, down, down + right)
    )
    return a, b - a, c - a, (d - c) - (b - a), (y - top)[..., None], (x - left)[..., None]


def _first(place: jax.Array, size: int) -> jax.Array:
    # the last pixel is reached as the far end of an interval, or is the only one
    return jnp.clip(jnp.floor(place), 0, max(size - 2, 0))


def _slopes(image: jax.Array, y: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    _, right, down, across, fy, fx = _corners(image, y, x)
    return down + fx * across, right + fy * across


def _moved(primals: Places, tangents: Places) -> jax.Array:
    (image, y, x), (d_image, dy, dx) = primals, tangents
    by_y, by_x = _slopes(image, y, x)
    return _sampled(d_image, y, x) + by_y * dy[..., None] + by_x * dx[..., None]


def _returned(primals: Places, cotangent: jax.Array) -> Places:
    """The transpose of `_moved`; on a CPU in strips of a large frame, whose memory would take long to get."""
    h, w = cotangent.shape[:2]
    rows = max(1, _STRIP // w)

    def whole(image: jax.Array, y: jax.Array, x: jax.Array, cotangent: jax.Array) -> Places:
        return _returned_rows(jnp.zeros_like(image), image, y, x, cotangent)

    def strips(image: jax.Array, *full: jax.Array) -> Places:
        def body(i: jax.Array, results: Places) -> Places:
            start = jnp.minimum(i * rows, h - rows)  # so the last may begin within the one before
            y, x, slope = materialize([lax.dynamic_slice_in_dim(v, start, rows) for v in full])
            fresh = jnp.arange(rows)[:, None, None] >= i * rows - start
            total, *places = _returned_rows(results[0], image, y, x, slope, fresh)
            put = [lax.dynamic_update_slice_in_dim(v, p, start, 0) for v, p in zip(results[1:], places)]
            return total, put[0], put[1]

        plane = alike(jnp.zeros((h, w), image.dtype), image, full)
        return lax.fori_loop(0, -(-h // rows), body, (jnp.zeros_like(image), plane, plane))

    if h <= 2 * rows:
        return whole(*primals, cotangent)
    return by_platform(*primals, cotangent, cpu=strips, default=whole)


def _returned_rows(
    total: jax.Array, image: jax.Array, y: jax.Array, x: jax.Array, cotangent: jax.Array, fresh: Any = True
) -> Places:
    """`_returned` of some rows, those that are fresh added to the image's cotangent."""
    to_y, to_x = (jnp.sum(cotangent * slope, axis=-1) for slope in _slopes(image, y, x))
    return _spread(total, y, x, jnp.where(fresh, cotangent, 0)), to_y, to_x


def _spread(total: jax.Array, y: jax.Array, x: jax.Array, values: jax.Array) -> jax.Array:
    """Add values to the pixels they were sampled from: two of a row at once, 3 times as fast as singly."""
    h, w, channels = total.shape
    if min(h, w) < 2:
        back = jax.linear_transpose(lambda image: _sampled.fun(image, y, x), total)(values)[0]
        return total + back
    top, left = _first(y, h), _first(x, w)
    fy, fx = (y - top)[..., None], (x - left)[..., None]
    index = channels * (top.astype(jnp.int32) * w + left.astype(jnp.int32)).reshape(-1, 1)
    numbers = lax.ScatterDimensionNumbers((1,), (), (0,))
    flat = total.reshape(-1)
    for step, share in ((0, 1 - fy), (w * channels, fy)):
        pairs = (share * jnp.where(np.arange(2) == 0, 1 - fx, fx))[..., None] * values[..., None, :]
        updates, mode = pairs.reshape(-1, 2 * channels), lax.GatherScatterMode.PROMISE_IN_BOUNDS
        flat = lax.scatter_add(flat, index + step, materialize(updates), numbers, mode=mode)
    return flat.reshape(total.shape)
