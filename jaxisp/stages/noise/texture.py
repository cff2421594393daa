"""Noise that is no white Gaussian: correlated, heavy-tailed, and the grain of film."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.safe_math import safe_sqrt
from jaxisp.arrays.stencils import gaussian_blur, gaussian_taps
from jaxisp.color import luma
from jaxisp.domains import EncodedRGB, Image
from jaxisp.options import Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.noise.draws import filtered_normal, normal


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
    noise = [filtered_normal(k, image, *taps) for k in keys]
    return image + params.std.astype(image.dtype) * (noise[0] if image.ndim == 2 else interleaved(noise))


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
    n = normal(key, image)
    return image + std * n * jnp.exp(0.5 * tail * n * n + 0.75 * jnp.log1p(-2 * tail))


@parameters
class FilmGrain:
    """Strength and size of the grain."""

    std: Leaf = param(0.03, (0.0, 0.2), "level", doc="standard deviation in mid-grey")
    sigma: Leaf = param(0.8, (0.3, 2.0), "px", log=True, doc="size: standard deviation of the blur")


@register
def film_grain(params: FilmGrain, image: EncodedRGB, *, key: jax.Array, radius: Positive = 6) -> EncodedRGB:
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
    drawn = normal(key, image, (height + 2 * radius, width + 2 * radius))
    blurred = gaussian_blur(drawn, params.sigma, radius)[radius : radius + height, radius : radius + width]
    y = jnp.clip(luma(*planes(image)), 0, 1)
    strength = 2 * params.std.astype(image.dtype) * safe_sqrt(y * (1 - y))
    return image + (strength * blurred / jnp.sum(taps * taps))[..., None]
