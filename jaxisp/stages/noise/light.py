"""Noise of light and readout: each pixel for itself."""

import math

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.extents import Extent
from jaxisp.arrays.safe_math import safe_sqrt, straight_through
from jaxisp.domains import Image
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.draws import uniform
from jaxisp.stages.noise.draws import normal


@parameters
class GaussianNoise:
    """Strength."""

    std: Leaf = param(0.05, (0.0, 0.5), "level", doc="standard deviation")


@register
def gaussian_noise(
    params: GaussianNoise, image: Image, *, key: jax.Array, extent: Extent | None = None
) -> Image:
    """Add white Gaussian noise, the same strength everywhere and in all channels.

    `y = x + std * n`, n standard normal.

    Args:
        params: std, in the unit of the image.
        image: (H, W) or (H, W, 3), any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, table 1 ("AWGN").
    """
    return image + params.std.astype(image.dtype) * normal(key, image, extent=extent)


@parameters
class ShotReadNoise:
    """Variance as an affine function of light."""

    shot: Leaf = param(0.0004, (0.0, 0.1), "level", doc="variance per unit of light: sigma_p**2")
    read: Leaf = param(0.007, (0.0, 0.2), "level", doc="standard deviation in the dark")


@register
def shot_read_noise(
    params: ShotReadNoise, image: Image, *, key: jax.Array, extent: Extent | None = None
) -> Image:
    """Add signal-dependent Gaussian noise: photons and readout.

    `y = x + sqrt(shot * max(x, 0) + read**2) * n`, n standard normal.

    Args:
        params: shot and read. A Poisson factor sigma_p, as std = sigma_p sqrt(x), is shot = sigma_p**2;
            a DNG's NoiseProfile (S, O) is shot = S, read = sqrt(O).
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact (where the variance is 0, that of the noise is taken as 0).

    Source: Foi et al. 2008; Jaroensri et al. 2019, section 3 ("AMWGN").
    """
    shot, read = params.shot.astype(image.dtype), params.read.astype(image.dtype)
    return image + safe_sqrt(shot * jnp.maximum(image, 0) + read * read) * normal(key, image, extent=extent)


@parameters
class PoissonNoise:
    """Size of an electron, and the readout."""

    gain: Leaf = param(0.0004, (1e-5, 0.1), "level/e-", log=True, doc="level of one electron")
    read: Leaf = param(0.007, (0.0, 0.2), "level", doc="standard deviation in the dark")


@register
def poisson_noise(
    params: PoissonNoise, image: Image, *, key: jax.Array, extent: Extent | None = None
) -> Image:
    """Count electrons, then add Gaussian read noise: `shot_read_noise` without its approximation.

    `y = x + (gain * N - max(x, 0)) + read * n`, N Poisson of mean max(x, 0) / gain, n standard normal.
    The variance is `gain * x + read**2`; negative light draws no electrons and is kept.

    Args:
        params: gain and read.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.

    Returns:
        The same shape and domain, not clipped.

    Gradient: surrogate. 1 to the image; to the gain as if the counts were Gaussian,
    `(gain * N - x) / (2 gain)`; exact to read.

    Source: Foi et al. 2008; Giles 2016, "Algorithm 955: approximation of the inverse Poisson cumulative
    distribution function".
    """
    gain, read = params.gain.astype(image.dtype), params.read.astype(image.dtype)
    count_key, read_key = jax.random.split(key)
    mean = lax.stop_gradient(jnp.maximum(image, 0) / gain)
    excess = lax.stop_gradient(gain) * poisson_excess(count_key, mean, extent)
    growth = jnp.sqrt(gain / lax.stop_gradient(gain))  # 1 in value
    return image + straight_through(excess, excess * growth) + read * normal(read_key, image, extent=extent)


def poisson_excess(key: jax.Array, mean: jax.Array, extent: Extent | None = None) -> jax.Array:
    """N - mean, with N Poisson: the quantile function at a uniform draw.

    Unlike rejection it takes keys of every kind, has no loop of unknown length, and changes as little
    as can be when the mean changes. Summed up to a mean of 16, Giles's expansion beyond, whose
    distribution function is right within 2e-5.
    """
    if mean.ndim > 2:
        # as rows of interleaved pixels: XLA's CPU code does not vectorise over a last axis of 3
        rows = materialize(mean.reshape(len(mean), math.prod(mean.shape[1:])))
        own = extent and extent._replace(width=extent.width * (rows.shape[1] // mean.shape[1]))
        return materialize(poisson_excess(key, rows, own)).reshape(mean.shape)
    tiny = jnp.finfo(mean.dtype).eps
    sign = uniform(key, mean.shape, mean.dtype, -1 + float(tiny), 1, extent)
    return jnp.where(mean < 16, _summed(0.5 * (1 + sign), mean), _expanded(sign, mean))


def _summed(u: jax.Array, mean: jax.Array) -> jax.Array:
    mean = jnp.minimum(mean, 16)
    u = jnp.minimum(u, 1 - 1e-6)  # beyond, rounding of the sum would decide
    term = total = jnp.exp(-mean)
    count = (u >= total).astype(mean.dtype)
    for k in range(1, 42):  # the quantile of 1 - 1e-6 for a mean of 16 is 39
        term = term * (mean / k)
        total = total + term
        count = count + (u >= total).astype(count.dtype)
    return count - mean


def _expanded(sign: jax.Array, mean: jax.Array) -> jax.Array:
    mean = jnp.maximum(mean, 16)
    root, w = jnp.sqrt(mean), jnp.sqrt(2).astype(mean.dtype) * lax.erf_inv(sign)
    w2 = w * w
    quantile = root * w + (2 + w2) / 6 - w * (2 + w2) / (72 * root)
    quantile = quantile + (w2 * (7 / 810 + w2 / 270) - 8 / 405) / mean
    share = mean - jnp.floor(mean)  # apart from the whole electrons, which float32 would round
    return jnp.maximum(jnp.floor(share + quantile) - share, -mean)
