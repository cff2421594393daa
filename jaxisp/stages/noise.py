"""Noise: of light, of the readout, of the sensor's own pattern, and of film.

Draws are reparameterised: for a fixed key the noise is a smooth function of the parameters, so that
gradients to them exist.
"""

import zlib

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.color import luma
from jaxisp.domains import EncodedRGB, Image
from jaxisp.numerics import planes, safe_sqrt, straight_through
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.draws import standard_normal
from jaxisp.windows import filter_rows_columns, gaussian_blur, gaussian_taps


def pattern_key(key: jax.Array, sensor: int | None, name: str) -> jax.Array:
    """The key of a fixed pattern: `key`, or that of the sensor with this serial number."""
    if sensor is None:
        return key
    return jax.random.fold_in(jax.random.key(sensor), zlib.crc32(name.encode()) & 0x7FFFFFFF)


def _normal(key: jax.Array, like: jax.Array, shape: tuple[int, ...] | None = None) -> jax.Array:
    return standard_normal(key, like.shape if shape is None else shape, like.dtype)


def _filtered_normal(key: jax.Array, like: jax.Array, taps_y: jax.Array, taps_x: jax.Array) -> jax.Array:
    """Unit white noise correlated with an outer product of taps.

    It is drawn on a larger frame and cropped, so that the borders have the same statistics as the rest.
    """
    ry, rx = len(taps_y) // 2, len(taps_x) // 2
    height, width = like.shape[:2]
    drawn = _normal(key, like, (height + 2 * ry, width + 2 * rx))
    return filter_rows_columns(drawn, taps_y, taps_x)[ry : ry + height, rx : rx + width]


@parameters
class GaussianNoise:
    """Strength."""

    std: Leaf = param(0.05, (0.0, 0.5), "level", doc="standard deviation")


@register
def gaussian_noise(params: GaussianNoise, image: Image, *, key: jax.Array) -> Image:
    """Add white Gaussian noise, the same strength everywhere and in all channels.

    `y = x + std * n`, n standard normal.

    Args:
        params: std, in the unit of the image.
        image: (H, W) or (H, W, 3), any range.
        key: draws the noise.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, table 1 ("AWGN").
    """
    return image + params.std.astype(image.dtype) * _normal(key, image)


@parameters
class ShotReadNoise:
    """Variance as an affine function of light."""

    shot: Leaf = param(0.0004, (0.0, 0.1), "level", doc="variance per unit of light: sigma_p**2")
    read: Leaf = param(0.007, (0.0, 0.2), "level", doc="standard deviation in the dark")


@register
def shot_read_noise(params: ShotReadNoise, image: Image, *, key: jax.Array) -> Image:
    """Add signal-dependent Gaussian noise: photons and readout.

    `y = x + sqrt(shot * max(x, 0) + read**2) * n`, n standard normal.

    Args:
        params: shot and read. A Poisson factor sigma_p, as std = sigma_p sqrt(x), is shot = sigma_p**2;
            a DNG's NoiseProfile (S, O) is shot = S, read = sqrt(O).
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact (where the variance is 0, that of the noise is taken as 0).

    Source: Foi et al. 2008; Jaroensri et al. 2019, section 3 ("AMWGN").
    """
    shot, read = params.shot.astype(image.dtype), params.read.astype(image.dtype)
    return image + safe_sqrt(shot * jnp.maximum(image, 0) + read * read) * _normal(key, image)


@parameters
class PoissonNoise:
    """Size of an electron, and the readout."""

    gain: Leaf = param(0.0004, (1e-5, 0.1), "level/e-", log=True, doc="level of one electron")
    read: Leaf = param(0.007, (0.0, 0.2), "level", doc="standard deviation in the dark")


@register
def poisson_noise(params: PoissonNoise, image: Image, *, key: jax.Array) -> Image:
    """Count electrons, then add Gaussian read noise: `shot_read_noise` without its approximation.

    `y = x + (gain * N - max(x, 0)) + read * n`, N Poisson of mean max(x, 0) / gain, n standard normal.
    The variance is `gain * x + read**2`; negative light draws no electrons and is kept.

    Args:
        params: gain and read.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the noise.

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
    excess = lax.stop_gradient(gain) * _poisson_excess(count_key, mean)
    growth = jnp.sqrt(gain / lax.stop_gradient(gain))  # 1 in value
    return image + straight_through(excess, excess * growth) + read * _normal(read_key, image)


def _poisson_excess(key: jax.Array, mean: jax.Array) -> jax.Array:
    """N - mean, with N Poisson: the quantile function at a uniform draw.

    Unlike rejection it takes keys of every kind, has no loop of unknown length, and changes as little
    as can be when the mean changes. Summed up to a mean of 16, Giles's expansion beyond, whose
    distribution function is right within 2e-5.
    """
    tiny = jnp.finfo(mean.dtype).eps
    sign = jax.random.uniform(key, mean.shape, mean.dtype, minval=-1 + tiny, maxval=1)
    return jnp.where(mean < 16, _summed(0.5 * (1 + sign), mean), _expanded(sign, mean))


def _summed(u: jax.Array, mean: jax.Array) -> jax.Array:
    mean = jnp.minimum(mean, 16)
    u = jnp.minimum(u, 1 - 1e-6)  # beyond, rounding of the sum would decide
    term = total = jnp.exp(-mean)
    count = (u >= total).astype(mean.dtype)
    for k in range(1, 42):  # the quantile of 1 - 1e-6 for a mean of 16 is 39
        term = term * (mean / k)
        total = total + term
        count = count + (u >= total)
    return count - mean


def _expanded(sign: jax.Array, mean: jax.Array) -> jax.Array:
    mean = jnp.maximum(mean, 16)
    root, w = jnp.sqrt(mean), jnp.sqrt(2).astype(mean.dtype) * lax.erf_inv(sign)
    w2 = w * w
    quantile = root * w + (2 + w2) / 6 - w * (2 + w2) / (72 * root)
    quantile = quantile + (w2 * (7 / 810 + w2 / 270) - 8 / 405) / mean
    share = mean - jnp.floor(mean)  # apart from the whole electrons, which float32 would round
    return jnp.maximum(jnp.floor(share + quantile) - share, -mean)


@parameters
class RowNoise:
    """Strength."""

    std: Leaf = param(0.005, (0.0, 0.1), "level", doc="standard deviation of the rows' offsets")


@register
def row_noise(params: RowNoise, image: Image, *, key: jax.Array) -> Image:
    """Add one random offset a row, as a rolling readout does.

    `y[i, j] = x[i, j] + std * n[i]`, n standard normal; channels share it.

    Args:
        params: std.
        image: (H, W) or (H, W, 3), any range.
        key: draws the offsets.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Wei et al. 2020, "A physics-based noise formation model for extreme low-light raw denoising".
    """
    offsets = _normal(key, image, (image.shape[0],) + (1,) * (image.ndim - 1))
    return image + params.std.astype(image.dtype) * offsets


@parameters
class ColumnNoise:
    """Strength."""

    std: Leaf = param(0.005, (0.0, 0.1), "level", doc="standard deviation of the columns' offsets")


@register
def column_noise(params: ColumnNoise, image: Image, *, key: jax.Array, sensor: int | None = None) -> Image:
    """Add one offset a column, the fixed pattern of column amplifiers.

    `y[i, j] = x[i, j] + std * n[j]`, n standard normal; channels share it.

    Args:
        params: std.
        image: (H, W) or (H, W, 3), any range.
        key: draws the offsets.
        sensor: a serial number that fixes the pattern whatever the key; None draws it from the key.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: EMVA Standard 1288 (dark signal nonuniformity, column profile); El Gamal & Eltoukhy 2005.
    """
    own = pattern_key(key, sensor, "column_noise")
    offsets = _normal(own, image, (1, image.shape[1]) + (1,) * (image.ndim - 2))
    return image + params.std.astype(image.dtype) * offsets


@parameters
class Prnu:
    """Photo-response nonuniformity."""

    std: Leaf = param(0.01, (0.0, 0.1), "1", doc="standard deviation of the pixels' gains")


@register
def prnu(params: Prnu, image: Image, *, key: jax.Array, sensor: int | None = None) -> Image:
    """Give each pixel a gain of its own, a fixed pattern that grows with light.

    `y = x (1 + std * n)`, n standard normal.

    Args:
        params: std.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the gains.
        sensor: a serial number that fixes the pattern whatever the key; None draws it from the key.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: EMVA Standard 1288 (photo response nonuniformity); Lukas, Fridrich & Goljan 2006.
    """
    return image * (1 + params.std.astype(image.dtype) * _normal(pattern_key(key, sensor, "prnu"), image))


@parameters
class CorrelatedNoise:
    """Strength, and correlation between neighbours."""

    std: Leaf = param(0.01, (0.0, 0.2), "level", doc="standard deviation")
    horizontal: Leaf = param(0.3, (-0.65, 0.65), "1", doc="correlation with the next pixel of the row")
    vertical: Leaf = param(0.0, (-0.65, 0.65), "1", doc="correlation with the next pixel of the column")


@register
def correlated_noise(params: CorrelatedNoise, image: Image, *, key: jax.Array) -> Image:
    """Add Gaussian noise that is correlated between neighbours; its strength does not depend on that.

    `y = x + std * (k_v * k_h * n)`, n white, `k = [a, 1, a] / sqrt(1 + 2 a**2)`, with
    `a = r / (1 + sqrt(1 - 2 r**2))` for a correlation r at distance 1; at distance 2 it is
    `a**2 / (1 + 2 a**2)`, and 0 beyond.

    Args:
        params: std and the two correlations; both 0 give white noise.
        image: (H, W) or (H, W, 3), any range; channels have noise of their own.
        key: draws the noise.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Box, Jenkins & Reinsel 1994, chapter 3 (moving-average process of order 2, symmetric).
    """
    taps = [_correlating_taps(r.astype(image.dtype)) for r in (params.vertical, params.horizontal)]
    keys = [key] if image.ndim == 2 else list(jax.random.split(key, image.shape[-1]))
    noise = [_filtered_normal(k, image, *taps) for k in keys]
    return image + params.std.astype(image.dtype) * (noise[0] if image.ndim == 2 else jnp.stack(noise, -1))


def _correlating_taps(correlation: jax.Array) -> jax.Array:
    side = correlation / (1 + safe_sqrt(1 - 2 * correlation * correlation))
    return jnp.stack([side, jnp.ones_like(side), side]) / jnp.sqrt(1 + 2 * side * side)


@parameters
class HeavyTailedNoise:
    """Strength and weight of the tails."""

    std: Leaf = param(0.01, (0.0, 0.2), "level", doc="standard deviation")
    tail: Leaf = param(0.15, (0.0, 0.4), "1", doc="Tukey's h: 0 is Gaussian, above 0.25 no kurtosis")


@register
def heavy_tailed_noise(params: HeavyTailedNoise, image: Image, *, key: jax.Array) -> Image:
    """Add white noise with heavier tails than a Gaussian; its variance does not depend on them.

    `y = x + std * (1 - 2 tail)**0.75 * n * exp(tail * n**2 / 2)`, n standard normal: Tukey's
    h-distribution, scaled to unit variance.

    Args:
        params: std and tail.
        image: (H, W) or (H, W, 3), any range.
        key: draws the noise.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Tukey 1977; Martinez & Iglewicz 1984, "Some properties of the Tukey g and h family".
    """
    std, tail = params.std.astype(image.dtype), params.tail.astype(image.dtype)
    n = _normal(key, image)
    return image + std * n * jnp.exp(0.5 * tail * n * n + 0.75 * jnp.log1p(-2 * tail))


@parameters
class FilmGrain:
    """Strength and size of the grain."""

    std: Leaf = param(0.03, (0.0, 0.2), "level", doc="standard deviation in mid-grey")
    sigma: Leaf = param(0.8, (0.3, 2.0), "px", log=True, doc="size: standard deviation of the blur")


@register
def film_grain(params: FilmGrain, image: EncodedRGB, *, key: jax.Array, radius: int = 6) -> EncodedRGB:
    """Add grain after the tone curve: blurred noise, strongest in mid-grey, none in black and white.

    `y = x + std * 2 sqrt(Y (1 - Y)) * g`, g white noise blurred by a Gaussian and scaled to unit
    variance, Y the luma clipped to [0, 1]. All channels share g, so that grain has no colour.

    Args:
        params: std and sigma [px].
        image: (H, W, 3) display-encoded.
        key: draws the grain.
        radius: where the Gaussian is cut [px]; 3 times the largest sigma keeps it whole.

    Returns:
        (H, W, 3) display-encoded, not clipped.

    Gradient: exact (where Y is 0 or 1 or beyond, that of the strength is taken as 0).

    Source: Newson et al. 2017, "A stochastic film grain model for resolution-independent rendering":
    the variance of the covered share u of an area goes as u (1 - u).
    """
    taps = gaussian_taps(params.sigma, radius).astype(image.dtype)
    height, width = image.shape[:2]
    # on a larger frame, so that the borders have the same statistics as the rest
    drawn = _normal(key, image, (height + 2 * radius, width + 2 * radius))
    blurred = gaussian_blur(drawn, params.sigma, radius)[radius : radius + height, radius : radius + width]
    y = jnp.clip(luma(*planes(image)), 0, 1)
    strength = 2 * params.std.astype(image.dtype) * safe_sqrt(y * (1 - y))
    return image + (strength * blurred / jnp.sum(taps * taps))[..., None]
