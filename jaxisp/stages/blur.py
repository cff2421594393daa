"""Blurs of linear light: motion, defocus, and the low-pass of lens and anti-alias filter.

Motion and defocus share a form: the point spread function (PSF) of a shape with a traced size is
what bilinear interpolation draws of it, in closed form along lines. So it is anti-aliased, sums to
1, keeps the centre of mass of the shape and has an exact gradient.
"""

import math
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import on_all_cores
from jaxisp.arrays.planes import per_plane, planes
from jaxisp.arrays.safe_math import safe_divide, straight_through
from jaxisp.arrays.stencils import gaussian_blur, pad
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.arrays.varying import alike
from jaxisp.color import luma
from jaxisp.domains import RGB, LinearRGB
from jaxisp.options import Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register

_CHORDS = 1024  # of a disc; its weights are then within 1e-4 of the largest
_SMALLEST_DISC = 0.05  # px; below, the PSF is linear in the radius


@parameters
class OpticalBlur:
    """Width of the low-pass."""

    sigma: Leaf = param(0.5, (0.0, 4.0), "px", doc="standard deviation; 0 leaves the image as it is")


@register(reach=lambda o: o["radius"], symmetric=True)
def optical_blur(params: OpticalBlur, image: LinearRGB, *, radius: Positive = 12) -> LinearRGB:
    """Low-pass by the lens or the anti-alias filter.

    `y = x * G(sigma)`, a sampled and normalised Gaussian.

    Args:
        params: sigma [px]. Below some 0.2 px the sampled Gaussian is a delta and has no slope.
        image: (H, W, 3) linear light, any range.
        radius: where the Gaussian is cut [px]; 3 times the largest sigma keeps it whole.

    Returns:
        (H, W, 3) linear light. Borders are reflected.

    Gradient: exact.

    Source: Zhang, Zerubia & Olivo-Marin 2007, "Gaussian approximations of fluorescence microscope
    point-spread function models", for the Airy disc.
    """

    def blurred(image: jax.Array, sigma: jax.Array) -> jax.Array:
        return gaussian_blur(image, sigma, radius)

    return in_strips_on_cpu(blurred, image, radius, (params.sigma,), forward=False)


@parameters
class Defocus:
    """Size of the circle of confusion."""

    disc_radius: Leaf = param(0.0, (0.0, 8.0), "px", doc="of the disc; 0 leaves the image as it is")


@register(reach=lambda o: o["radius"], symmetric=True)
def defocus(params: Defocus, image: LinearRGB, *, radius: Positive = 8) -> LinearRGB:
    """Blur with a disc, the image of a point that is out of focus.

    `y = x * D`, with D the uniform disc, drawn bilinearly (its edge is about a pixel soft).

    Args:
        params: radius of the disc [px].
        image: (H, W, 3) linear light, any range.
        radius: of the window [px]; at least the largest radius of the disc, which it cuts off.

    Returns:
        (H, W, 3) linear light. Borders are reflected.

    Gradient: exact.

    Source: Goodman, "Introduction to Fourier Optics", section 6.4, in the limit of geometrical optics.
    """
    psf = _disc(jnp.asarray(params.disc_radius, image.dtype), radius)
    return per_plane(lambda plane: _convolve(plane, psf), image)


def _disc(disc_radius: jax.Array, radius: int) -> jax.Array:
    """The PSF of a disc: a sum over its chords, each integrated in closed form."""
    dtype = disc_radius.dtype
    size = jnp.maximum(disc_radius, _SMALLEST_DISC)
    angle = (np.arange(_CHORDS) + 0.5) * (np.pi / _CHORDS) - np.pi / 2
    y, half = size * np.sin(angle).astype(dtype), size * np.cos(angle).astype(dtype)
    k = jnp.arange(-radius, radius + 1, dtype=dtype)[:, None]
    along = (_tent_integral(half[None] - k) - _tent_integral(-half[None] - k)) / (2 * half)[None]
    share = (np.cos(angle) ** 2 * (2 / _CHORDS)).astype(dtype)
    psf = _normalized(_drawn(_tents(y, radius), along, jnp.asarray(share)))
    delta = _delta(radius, dtype)
    return delta + jnp.minimum(disc_radius / _SMALLEST_DISC, 1) * (psf - delta)


def _tent_integral(u: jax.Array) -> jax.Array:
    """The integral of max(1 - |t|, 0) up to u."""
    u = jnp.clip(u, -1, 1)
    return 0.5 + u - 0.5 * u * jnp.abs(u)


@parameters
class MotionBlur:
    """A path of straight segments, as many as the vectors are long, and the boost of highlights."""

    lengths: Leaf = param(
        (0.0, 0.0, 0.0), (0.0, 8.0), "px", any_length=True, doc="of the segments; one of length 0 is absent"
    )
    directions: Leaf = param(
        (0.0, 0.0, 0.0), (-180.0, 180.0), "deg", any_length=True, doc="0 to the right, 90 down, one a segment"
    )
    threshold: Leaf = param(0.99, (0.0, 2.0), "level", doc="luma above which a pixel is a highlight")
    boost: Leaf = param(0.0, (0.0, 100.0), "1", doc="share by which a highlight is really brighter")


@register(reach=lambda o: o["radius"], symmetric=True)
def motion_blur(params: MotionBlur, image: LinearRGB, *, radius: Positive = 12) -> LinearRGB:
    """Blur along the path that a point of light draws while the camera shakes.

    `y = min((x * (1 + boost * [Y > threshold])) * P, 1)`, where Y is luma and P the PSF: the path,
    run through at constant speed, drawn bilinearly and moved so that its centre of mass is at 0.
    A clipped highlight was brighter than white, so it draws a bright streak: the boost gives that
    light back before the blur, and the result is clipped at white again. Where boost is 0 nothing is.

    Args:
        params: lengths [px] and directions [deg] of the segments, of equal number; threshold; boost.
            All lengths 0 and no boost leave the image as it is, bit for bit.
        image: (H, W, 3) linear light, any range. Negative values are kept.
        radius: of the window [px]; at least half the greatest sum of lengths. What a longer path
            draws outside is cut off.

    Returns:
        (H, W, 3) linear light, at most 1 where there is a boost. Borders are reflected.

    Raises:
        TypeError: lengths and directions differ in number.

    Gradient: surrogate for the highlight gate (a logistic one 5 % of the threshold wide), exact in all else.

    Source: Jaroensri et al. 2019, section 3.
    """
    lengths, directions = (jnp.asarray(v, image.dtype) for v in (params.lengths, params.directions))
    if lengths.shape != directions.shape:
        raise TypeError(f"motion_blur: {lengths.shape} lengths but {directions.shape} directions")
    psf = _path(lengths, directions * (np.pi / 180), radius)
    boost = jnp.asarray(params.boost, image.dtype)
    bright = image * (1 + boost * _highlights(image, jnp.asarray(params.threshold, image.dtype)))[..., None]
    blurred = per_plane(lambda plane: _convolve(plane, psf), bright)
    return jnp.where(boost > 0, jnp.minimum(blurred, 1), blurred)


@parameters
class IsotropicBlur:
    """Width of the blur."""

    sigma: Leaf = param(1.0, (0.0, 8.0), "px", doc="standard deviation; 0 leaves the image as it is")


@register(reach=lambda o: o["radius"], symmetric=True)
def isotropic_blur(params: IsotropicBlur, image: RGB, *, radius: Positive = 10) -> RGB:
    """Blur with a Gaussian in whatever encoding the image has: `optical_blur` is the one for light.

    `y = x * G(sigma)`, G sampled at the taps of the window and summing to 1.

    Args:
        params: sigma.
        image: (H, W, 3), any range.
        radius: of the window [px], which cuts the Gaussian off.

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Gradient: exact.

    Source: Zhang et al. 2021, "Designing a Practical Degradation Model for Deep Blind Image Super-Resolution"
    (BSRGAN), section 3.1.
    """
    return gaussian_blur(image, params.sigma.astype(image.dtype), radius)


@parameters
class AnisotropicBlur:
    """Widths along two axes at right angles, and where they point."""

    along: Leaf = param(1.0, (0.1, 8.0), "px", log=True, doc="standard deviation along the axis")
    across: Leaf = param(1.0, (0.1, 8.0), "px", log=True, doc="standard deviation across it")
    angle: Leaf = param(0.0, (-180.0, 180.0), "deg", doc="of the axis: 0 to the right, 90 down")


@register(reach=lambda o: o["radius"], symmetric=True)
def anisotropic_blur(params: AnisotropicBlur, image: RGB, *, radius: Positive = 10) -> RGB:
    """Blur with a Gaussian that is wider in one direction.

    `y = x * G`, G the Gaussian at the taps of the window, summing to 1:
    `exp(-(a**2 / along**2 + b**2 / across**2) / 2)`, a and b the place of a tap along and across the axis.

    Args:
        params: along, across and angle.
        image: (H, W, 3), any range.
        radius: of the window [px], which cuts the Gaussian off.

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Gradient: exact.

    Source: Zhang et al. 2021, "Designing a Practical Degradation Model for Deep Blind Image Super-Resolution"
    (BSRGAN), section 3.1.
    """
    angle = jnp.asarray(params.angle, image.dtype) * (np.pi / 180)
    y, x = (jnp.asarray(v, image.dtype) for v in np.mgrid[-radius : radius + 1, -radius : radius + 1])
    a, b = x * jnp.cos(angle) + y * jnp.sin(angle), y * jnp.cos(angle) - x * jnp.sin(angle)
    along, across = (jnp.asarray(v, image.dtype) for v in (params.along, params.across))
    taps = jnp.exp(-((a / along) ** 2 + (b / across) ** 2) / 2)  # 1 in the middle: the sum is never 0
    psf = taps / taps.sum()
    return per_plane(lambda plane: _convolve(plane, psf), image)


def _highlights(image: jax.Array, threshold: jax.Array) -> jax.Array:
    """(H, W): 1 where the luma is above the threshold, else 0."""
    excess = luma(*planes(image)) - threshold
    soft = jax.nn.sigmoid(excess / (0.05 * threshold + 1e-4))
    return straight_through((excess > 0).astype(image.dtype), soft)


def _path(lengths: jax.Array, angles: jax.Array, radius: int) -> jax.Array:
    """The PSF of a polyline, run through at constant speed, about its centre of mass."""
    moves = lengths.sum() > 0
    # without a path its shape is undefined: a short one lends its slope, and the value is a delta
    lengths = lengths + jnp.where(moves, 0, 1e-3).astype(lengths.dtype)
    share = lengths / lengths.sum()
    steps = lengths[None] * jnp.stack([jnp.sin(angles), jnp.cos(angles)])
    starts = jnp.cumsum(steps, axis=1) - steps
    starts = starts - (share[None] * (starts + steps / 2)).sum(axis=1, keepdims=True)
    nodes, weights = _quadrature(starts, steps, radius)
    y, x = (starts[..., None] + steps[..., None] * nodes[None]).reshape(2, -1)
    drawn = _drawn(_tents(y, radius), _tents(x, radius), (share[:, None] * weights).ravel())
    psf = _normalized(drawn)
    return straight_through(jnp.where(moves, psf, _delta(radius, psf.dtype)), psf)


def _quadrature(starts: jax.Array, steps: jax.Array, radius: int) -> tuple[jax.Array, jax.Array]:
    """Nodes in [0, 1] on each segment, and weights, that integrate what bilinear interpolation gives.

    Between the lines of the pixel grid that is a quadratic, for which two Gauss nodes are exact, and
    so is the gradient with the nodes held where they are.
    """
    lines = jnp.arange(-radius - 1, radius + 2, dtype=starts.dtype)
    crossings = safe_divide(
        lines[None, None] - starts[..., None], jnp.broadcast_to(steps[..., None], (*steps.shape, 1))
    )
    ends = jnp.broadcast_to(jnp.array([0, 1], starts.dtype), (steps.shape[1], 2))
    knots = jnp.sort(jnp.concatenate([*jnp.clip(crossings, 0, 1), ends], axis=1), axis=1)
    half = (knots[:, 1:] - knots[:, :-1]) / 2
    middle = (knots[:, 1:] + knots[:, :-1]) / 2
    off = half / math.sqrt(3)  # NumPy's is a float64, which counts in double precision
    nodes = jnp.concatenate([middle - off, middle + off], axis=1)
    return lax.stop_gradient((nodes, jnp.concatenate([half, half], axis=1)))


def _tents(position: jax.Array, radius: int) -> jax.Array:
    """(2 radius + 1, N): the bilinear weight that each tap has in a point."""
    k = jnp.arange(-radius, radius + 1, dtype=position.dtype)
    return jnp.maximum(1 - jnp.abs(position[None] - k[:, None]), 0)


def _drawn(tents_y: jax.Array, tents_x: jax.Array, weights: jax.Array) -> jax.Array:
    """The weighted sum of outer products of columns."""
    return jnp.matmul(tents_y * weights[None], tents_x.T, precision=lax.Precision.HIGHEST)


def _normalized(psf: jax.Array) -> jax.Array:
    return safe_divide(psf, psf.sum())


def _delta(radius: int, dtype: jnp.dtype) -> jax.Array:
    tap = np.eye(2 * radius + 1)[radius]
    return jnp.asarray(np.outer(tap, tap), dtype)


def _convolve(plane: jax.Array, psf: jax.Array) -> jax.Array:
    """`plane` convolved with an odd square PSF; borders are reflected."""
    return _correlate(pad(plane, psf.shape[0] // 2), psf[::-1, ::-1])


@jax.custom_jvp
def _correlate(padded: jax.Array, taps: jax.Array) -> jax.Array:
    """The sum over taps of `taps[i, j] * padded[i:, j:]`, where the window is whole."""
    rows, columns = taps.shape
    h, w = padded.shape[0] - rows + 1, padded.shape[1] - columns + 1

    def add_row(i: jax.Array, total: jax.Array) -> jax.Array:
        # one row of taps a kernel: unrolled altogether they take 8 times as long
        i = on_all_cores(i)
        strip = lax.dynamic_slice(padded, (i, 0), (h, padded.shape[1]))
        weights = lax.dynamic_slice(taps, (i, 0), (1, columns))[0]
        return total + reduce(jnp.add, (weights[j] * strip[:, j : j + w] for j in range(columns)))

    empty = alike(jnp.zeros((h, w), padded.dtype), padded, taps)
    return lax.fori_loop(0, rows, add_row, empty)


@_correlate.defjvp
def _correlate_jvp(
    primals: tuple[jax.Array, jax.Array], tangents: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """The derivative by FFT: that towards hundreds of taps would be as many sums over the image."""
    padded, taps = primals
    change = _spectrum_product(tangents[0], taps) + _spectrum_product(padded, tangents[1])
    rows, columns = taps.shape
    return _correlate(padded, taps), jnp.fft.irfft2(change, s=padded.shape)[rows - 1 :, columns - 1 :]


def _spectrum_product(padded: jax.Array, taps: jax.Array) -> jax.Array:
    return jnp.fft.rfft2(padded) * jnp.fft.rfft2(taps[::-1, ::-1], s=padded.shape)
