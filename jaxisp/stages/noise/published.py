"""Noise laws of the literature whose strengths depend on each other."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.extents import Extent
from jaxisp.arrays.safe_math import safe_sqrt, straight_through
from jaxisp.domains import Image
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.draws import uniform
from jaxisp.stages.noise.draws import normal
from jaxisp.stages.noise.light import poisson_excess


@parameters
class ShotReadLaw:
    """Shot noise, and the line that read noise follows in logarithms."""

    shot: Leaf = param(1e-3, (1e-5, 0.1), "level", log=True, doc="variance per unit of light")
    slope: Leaf = param(2.18, (0.0, 4.0), "1", doc="of log read variance over log shot")
    intercept: Leaf = param(1.2, (-5.0, 5.0), "1", doc="of that line")
    deviation: Leaf = param(0.0, (-2.0, 2.0), "1", doc="of log read variance from that line")


@register
def shot_read_law(
    params: ShotReadLaw, image: Image, *, key: jax.Array, extent: Extent | None = None
) -> Image:
    """Add signal-dependent Gaussian noise whose read noise follows from its shot noise.

    `y = x + sqrt(shot * max(x, 0) + read) * n`, n standard normal,
    `read = exp(slope * log(shot) + intercept + deviation)`, a variance.

    Args:
        params: shot, and the line; slope 2.18, intercept 1.20 and deviations of standard deviation 0.26
            are those of the cameras of the Darmstadt Noise Dataset.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", section 3.1; Ploetz & Roth
    2017, "Benchmarking Denoising Algorithms with Real Photographs" (the affine variance).
    """
    shot = params.shot.astype(image.dtype)
    read = _on_line(params.shot, params.slope, params.intercept, params.deviation).astype(image.dtype)
    return image + safe_sqrt(shot * jnp.maximum(image, 0) + read) * normal(key, image, extent=extent)


def _on_line(x: jax.Array, slope: jax.Array, intercept: jax.Array, deviation: jax.Array) -> jax.Array:
    return jnp.exp(slope * jnp.log(x) + intercept + deviation)


@parameters
class LowLightNoise:
    """System gain, and the lines that read and row noise follow in logarithms; all in DN."""

    gain: Leaf = param(1.0, (0.01, 100.0), "DN/e-", log=True, doc="DN of one electron")
    read_slope: Leaf = param(0.75, (0.0, 2.0), "1", doc="of log read scale over log gain")
    read_intercept: Leaf = param(0.0, (-3.0, 3.0), "1", doc="of that line; its exponential is in DN")
    read_deviation: Leaf = param(0.0, (-2.0, 2.0), "1", doc="from that line")
    read_shape: Leaf = param(0.0, (-0.4, 0.5), "1", doc="Tukey's lambda: below 0.14 heavier than a Gaussian")
    row_slope: Leaf = param(0.75, (0.0, 2.0), "1", doc="of log row noise over log gain")
    row_intercept: Leaf = param(-1.0, (-4.0, 3.0), "1", doc="of that line; its exponential is in DN")
    row_deviation: Leaf = param(0.0, (-2.0, 2.0), "1", doc="from that line")
    ratio: Leaf = param(100.0, (1.0, 400.0), "1", log=True, doc="by which the light is dimmed, and amplified")
    white: Leaf = param(15871.0, (255.0, 65535.0), "DN", log=True, doc="white less black")


@register
def low_light_noise(
    params: LowLightNoise, image: Image, *, key: jax.Array, extent: Extent | None = None
) -> Image:
    """Dim the light, add noise of photons, readout, rows and rounding in DN, and amplify it again.

    With K the gain, r the ratio and W white, `z = x W / r`,
    `y = (K N - max(z, 0) + z + s_read L + s_row n + q) r / W`: N Poisson of mean `max(z, 0) / K`; L Tukey's
    lambda distribution of scale 1, `(u**a - (1 - u)**a) / a`; n standard normal, one a row; q uniform on
    [-1/2, 1/2]; `s = exp(slope * log(K) + intercept + deviation)`.

    Args:
        params: gain, the two lines, the shape a, ratio and white.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.

    Returns:
        The same shape and domain, not clipped.

    Gradient: surrogate. 1 to the image; of the counts as if they were Gaussian, as in `poisson_noise`;
    exact to the scales of read and row noise.

    Source: Wei et al. 2020, "A Physics-based Noise Formation Model for Extreme Low-light Raw Denoising";
    Feng et al. 2022, "Learnability Enhancement for Low-light Raw Denoising".
    """
    p = jax.tree.map(lambda v: v.astype(image.dtype), params)
    counts, reading, rows, rounding = jax.random.split(key, 4)
    to_dn = p.white / p.ratio
    light = jnp.maximum(image, 0) * to_dn
    mean = jax.lax.stop_gradient(light / p.gain)
    excess = jax.lax.stop_gradient(p.gain * poisson_excess(counts, mean, extent))
    # the counts as Gaussian: their noise grows with the root of the gain, and of the light in DN
    growth = jnp.sqrt(p.gain * to_dn / jax.lax.stop_gradient(p.gain * to_dn))
    shot = straight_through(excess, excess * growth)
    read = _on_line(p.gain, p.read_slope, p.read_intercept, p.read_deviation)
    row = _on_line(p.gain, p.row_slope, p.row_intercept, p.row_deviation)
    tiny = float(jnp.finfo(image.dtype).eps)
    u = uniform(reading, image.shape, image.dtype, tiny, 1 - tiny, extent)
    offsets = normal(rows, image, (image.shape[0],) + (1,) * (image.ndim - 1))
    steps = uniform(rounding, image.shape, image.dtype, -0.5, 0.5, extent)
    noise = shot + read * _tukey_lambda(u, p.read_shape) + row * offsets + steps
    return image + noise / to_dn


def _tukey_lambda(u: jax.Array, shape: jax.Array) -> jax.Array:
    """The quantile function of Tukey's lambda distribution; that of the logistic at shape 0."""
    low, high = jnp.log(u), jnp.log1p(-u)
    near = jnp.abs(shape) < 1e-3
    safe = jnp.where(near, 1, shape)
    series = low - high + shape / 2 * (low * low - high * high)
    return jnp.where(near, series, (jnp.expm1(safe * low) - jnp.expm1(safe * high)) / safe)
