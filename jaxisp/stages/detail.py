"""Detail: unsharp masking and deconvolution."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize, on_all_cores
from jaxisp.arrays.linear import pointwise
from jaxisp.arrays.planes import planes
from jaxisp.arrays.safe_math import straight_through
from jaxisp.arrays.stencils import gaussian_blur
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.color import luma
from jaxisp.domains import RGB
from jaxisp.options import Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register


@parameters
class UnsharpMask:
    """Strength, width and threshold of the mask."""

    amount: Leaf = param(0.5, (0.0, 4.0), "1", doc="share of the detail that is added")
    sigma: Leaf = param(1.5, (0.1, 4.0), "px", log=True, doc="standard deviation of the blur")
    threshold: Leaf = param(0.0, (0.0, 0.2), "level", doc="smaller detail is left alone")


@register(reach=lambda o: o["radius"], symmetric=True)
def unsharp_mask(params: UnsharpMask, image: RGB, *, radius: Positive = 12) -> RGB:
    """Add what a Gaussian blur takes away: a halo along edges, and amplified noise.

    `y = x + amount * d * [|d| > threshold]`, with `d = x - blur(x)`, per channel, not clipped.

    Args:
        params: amount and sigma [px]; threshold in the unit of the image.
        image: (H, W, 3), any range.
        radius: where the Gaussian is cut [px]; 3 times the largest sigma keeps it whole.

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Gradient: surrogate for the threshold (a logistic gate 5 % of it wide), exact in all else.

    Source: Jaroensri et al. 2019, section 3; Polesel, Ramponi & Mathews 2000.
    """
    return in_strips_on_cpu(partial(_unsharp, radius), image, radius, (params,), forward=False)


def _unsharp(radius: int, image: jax.Array, params: UnsharpMask) -> jax.Array:
    # stored, or it would be done again by everything that reads it
    blurred = materialize(gaussian_blur(image, params.sigma, radius))
    return pointwise(_sharpened, (image, blurred), params.amount, params.threshold)


def _sharpened(x: jax.Array, blurred: jax.Array, amount: jax.Array, threshold: jax.Array) -> jax.Array:
    detail = x - blurred
    excess = jnp.abs(detail) - threshold
    soft = jax.nn.sigmoid(excess / (0.05 * threshold + 1e-4))
    return x + amount * straight_through((excess > 0).astype(x.dtype), soft) * detail


_DARKEST = 1e-4  # of white: deconvolution is of positive values
_STEEPNESS = 10  # of the damping; White's N


@parameters
class RichardsonLucy:
    """Width of the blur that is undone, share of the result, and damping."""

    sigma: Leaf = param(0.7, (0.1, 2.0), "px", log=True, doc="standard deviation of the blur")
    amount: Leaf = param(1.0, (0.0, 2.0), "1", doc="share of the change that is applied")
    damping: Leaf = param(
        0.0, (0.0, 0.3), "sqrt(level)", doc="smaller misfits, over the root of the value, are left alone"
    )


@register(reach=lambda o: 2 * o["radius"] * o["iterations"])
def richardson_lucy(
    params: RichardsonLucy, image: RGB, *, iterations: Positive = 10, radius: Positive = 6
) -> RGB:
    """Richardson-Lucy deconvolution of luma by a Gaussian: sharper edges, less halo than a mask leaves.

    From `x = y`, luma, each iteration takes `x <- x G(1 + w (y - b) / b)` with `b = G(x)`, G the Gaussian.
    `w` is 1 without damping, else `u**9 (10 - 9 u)` with `u = min(2 (y ln(y / b) - y + b) / damping**2, 1)`.
    Every channel is multiplied by `1 + amount (x / y - 1)`.

    Args:
        params: sigma [px], amount, damping.
        image: (H, W, 3), any range, linear or encoded; luma counts as 1e-4 at least.
        iterations: how many; more sharpen more, and amplify noise more.
        radius: where the Gaussian is cut [px]; 3 times the largest sigma keeps it whole.

    Returns:
        (H, W, 3) in the domain of the image, not clipped. Borders are reflected.

    Gradient: exact.

    Source: Richardson 1972; Lucy 1974; damping: White 1994, "Image restoration using the damped
    Richardson-Lucy method".
    """
    data = jnp.maximum(luma(*planes(image)), _DARKEST)
    found = deconvolved(data, data, params.sigma, params.damping, iterations, radius)
    return image * (1 + params.amount * (found / data - 1))[..., None]


def deconvolved(
    data: jax.Array, start: jax.Array, sigma: jax.Array, damping: jax.Array, iterations: int, radius: int
) -> jax.Array:
    """Damped Richardson-Lucy iterations on an (H, W) plane of positive values, from a start."""

    def once(i: jax.Array, estimate: jax.Array) -> jax.Array:
        blurred = materialize(gaussian_blur(estimate, sigma, radius))
        misfit = (data - blurred) / blurred
        likelihood = 2 * (data * jnp.log(data / blurred) - data + blurred)
        damped = damping > 0
        u = jnp.minimum(likelihood / jnp.where(damped, damping * damping, 1.0), 1.0)
        weight = jnp.where(damped, u ** (_STEEPNESS - 1) * (_STEEPNESS - (_STEEPNESS - 1) * u), 1.0)
        return estimate * gaussian_blur(materialize(1 + weight * misfit), sigma, radius)

    return lax.fori_loop(0, iterations, lambda i, x: once(on_all_cores(i), x), start)
