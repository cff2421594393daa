"""Displacements by an interpolation that is not known: from linear to Keys' cubic, and beyond.

A lens moves light and does not smooth it; cameras that correct one interpolate, each in its own way.
"""

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad
from jaxisp.domains import LinearRGB
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.optics.centre import from_centre, radius_squared
from jaxisp.stages.optics.displacement import displaced, picked

_SHARPNESS = "0 linear interpolation, 1 Keys' cubic with a = -1/2, in proportion between and beyond"


@parameters
class RadialWarp:
    """Radial distortion with a change of scale, and how it is interpolated."""

    k1: Leaf = param(0.0, (-0.2, 0.2), "1", doc="coefficient of r**2; positive is barrel distortion")
    k0: Leaf = param(0.0, (-0.1, 0.1), "1", doc="constant coefficient; positive shows more of the scene")
    k2: Leaf = param(0.0, (-0.07, 0.07), "1", doc="coefficient of r**4")
    sharpness: Leaf = param(1.0, (0.0, 2.0), "1", doc=_SHARPNESS)


@register
def radial_warp(params: RadialWarp, image: LinearRGB) -> LinearRGB:
    """`geometric_distortion` by interpolation that may be sharper.

    `y(p) = x(centre + (p - centre) * (1 + k0 + k1 r**2 + k2 r**4))`, r = 1 in the corner, where x is read
    between its pixels by `L - sharpness f (1 - f) / 2 L D` along each axis: L is linear interpolation at the
    fraction f, D the second difference. A corrected lens has all three: k0 keeps the frame filled.

    Args:
        params: coefficients, which at 0 leave the image as it is, bit for bit; sharpness.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, beyond the range of the image beside edges. Outside the image its border
        pixels go on.

    Gradient: exact (where a sample falls on a pixel, that of the side of larger coordinates).

    Source: Brown 1966, "Decentering distortion of lenses"; Keys 1981, "Cubic convolution interpolation for
    digital image processing".
    """
    y, x = from_centre(image.shape, image.dtype)
    k0, k1, k2 = (jnp.asarray(k, image.dtype) for k in (params.k0, params.k1, params.k2))
    squared = radius_squared(image.shape, image.dtype)
    change = k0 + squared * (k1 + squared * k2)
    return _read(image, change * y, change * x, params.sharpness)


@parameters
class RectilinearWarp:
    """The lens correction that a DNG states, for the image or a part of it."""

    radial: Leaf = param(
        ((0.0,) * 4,) * 3, (-2.0, 2.0), "1", doc="k0 less 1, k1, k2 and k3 of red, green and blue"
    )
    tangential: Leaf = param(((0.0,) * 2,) * 3, (-1.0, 1.0), "1", doc="t0 and t1 of red, green and blue")
    centre: Leaf = param(
        (0.5, 0.5),
        (-2.0, 3.0),
        "1",
        doc="its row and column, 0 at the first pixel's centre and 1 at the last's",
    )
    farthest: Leaf = param(
        1.0, (0.2, 50.0), "1", log=True, doc="from it to where r = 1, in halves of the image's diagonal"
    )
    sharpness: Leaf = param(1.0, (0.0, 2.0), "1", doc=_SHARPNESS)


@register
def rectilinear_warp(params: RectilinearWarp, image: LinearRGB) -> LinearRGB:
    """Correct a lens by the polynomials that a DNG has for each colour, radial and tangential.

    `y_c(p) = x_c(centre + d (k0 + k1 r**2 + k2 r**4 + k3 r**6) + t)`, where d = p - centre, r is its length
    in units of m, the distance to the farthest corner of the whole frame, and, down and across, with
    (v, u) = d / m, `t = m (2 t1 v u + t0 (r**2 + 2 v**2), 2 t0 v u + t1 (r**2 + 2 u**2))`; x is read between
    its pixels as in `radial_warp`.

    Args:
        params: polynomials, which at 0 leave the image as it is, bit for bit; where they are centred, and how
            far they reach; sharpness.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, beyond the range of the image beside edges. Outside the image its border
        pixels go on.

    Gradient: exact (where a sample falls on a pixel, that of the side of larger coordinates).

    Source: Digital Negative specification 1.4, WarpRectilinear; Keys 1981.
    """
    size = jnp.array(image.shape[:2], image.dtype)
    reach = jnp.asarray(params.farthest, image.dtype) * jnp.maximum(jnp.hypot(*(size - 1)) / 2, 1)
    row, column = jnp.asarray(params.centre, image.dtype) * (size - 1)
    v = ((jnp.arange(image.shape[0], dtype=image.dtype) - row) / reach)[:, None]
    u = ((jnp.arange(image.shape[1], dtype=image.dtype) - column) / reach)[None]
    r2 = v * v + u * u

    def corrected(plane: jax.Array, k: jax.Array, t: jax.Array) -> jax.Array:
        change = k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3]))
        dy = change * v + 2 * t[1] * v * u + t[0] * (r2 + 2 * v * v)
        dx = change * u + 2 * t[0] * v * u + t[1] * (r2 + 2 * u * u)
        return _read(plane[..., None], reach * dy, reach * dx, params.sharpness)[..., 0]

    polynomials = (jnp.asarray(p, image.dtype) for p in (params.radial, params.tangential))
    return interleaved([corrected(*own) for own in zip(planes(image), *polynomials)])


def _read(image: jax.Array, dy: jax.Array, dx: jax.Array, sharpness: Leaf) -> jax.Array:
    """(H, W, C) read at each pixel's own place plus (dy, dx), (H, W) both."""
    sharpness = jnp.asarray(sharpness, image.dtype)
    down, across = (_overshoot(d, axis, sharpness)[..., None] for axis, d in ((0, dy), (1, dx)))
    by_row, by_column = _second_difference(image, 0), _second_difference(image, 1)
    whole = jnp.concatenate([image, by_row, by_column, _second_difference(by_row, 1)], -1)
    plain, rows, columns, both = jnp.split(displaced(whole, dy, dx), 4, -1)
    return materialize(plain - down * rows - across * columns + down * across * both)


@parameters
class ColorMagnification:
    """Magnification of red and blue against green, and how they are interpolated."""

    red_scale: Leaf = param(1.0, (0.97, 1.03), "1", doc="above 1 red is larger than green")
    blue_scale: Leaf = param(1.0, (0.97, 1.03), "1", doc="above 1 blue is larger than green")
    sharpness: Leaf = param(1.0, (0.0, 2.0), "1", doc=_SHARPNESS)


@register
def color_magnification(params: ColorMagnification, image: LinearRGB) -> LinearRGB:
    """`lateral_chromatic_aberration` by interpolation that may be sharper.

    `y_c(p) = x_c(centre + (p - centre) / scale_c)` for red and blue, read between pixels as in `radial_warp`.

    Args:
        params: scales, which at 1 leave a channel as it is, bit for bit; sharpness.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, beyond the range of the image beside edges. Outside the image its border
        pixels go on.

    Gradient: exact (where a sample falls on a pixel, that of the side of larger coordinates).

    Source: Kang 2007, "Automatic removal of chromatic aberration from a single image"; Keys 1981.
    """
    sharpness = jnp.asarray(params.sharpness, image.dtype)
    r, g, b = planes(image)
    red, blue = (_magnified(p, s, sharpness) for p, s in ((r, params.red_scale), (b, params.blue_scale)))
    return interleaved([red, g, blue])


def _magnified(plane: jax.Array, scale: Leaf, sharpness: jax.Array) -> jax.Array:
    change = 1 / jnp.asarray(scale, plane.dtype) - 1
    for axis, place in enumerate(from_centre(plane.shape, plane.dtype)):
        offset = change * place
        more = _overshoot(offset, axis, sharpness)
        line, bends = offset.reshape(-1), _second_difference(plane, axis)
        plane = picked(plane, line, axis) - more * picked(bends, line, axis)
    return plane


def _overshoot(offset: jax.Array, axis: int, sharpness: jax.Array) -> jax.Array:
    """What the second difference counts where pixels are read at an offset along an axis, (H, W) or one of
    them 1; nothing beyond the border."""
    n = offset.shape[axis]
    shape = (-1, 1) if axis == 0 else (1, -1)
    place = jnp.arange(n, dtype=offset.dtype).reshape(shape) + offset
    share = place - lax.stop_gradient(jnp.floor(place))
    within = (place > 0) & (place < n - 1)
    return jnp.where(within, sharpness * share * (1 - share) / 2, 0)


def _second_difference(image: jax.Array, axis: int) -> jax.Array:
    """x[i - 1] - 2 x[i] + x[i + 1] along rows or columns; borders are replicated."""
    n = image.shape[axis]
    wide = pad(image, (1, 0) if axis == 0 else (0, 1), "edge")
    before, after = (lax.slice_in_dim(wide, k, k + n, axis=axis) for k in (0, 2))
    return before - 2 * image + after
