"""Detail: unsharp masking."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import pointwise
from jaxisp.arrays.safe_math import straight_through
from jaxisp.arrays.stencils import gaussian_blur
from jaxisp.arrays.strips import in_strips_on_cpu
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
