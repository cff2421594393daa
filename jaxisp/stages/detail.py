"""Detail and size: unsharp masking, resizing, rounding to output levels."""

import jax
import jax.numpy as jnp

from jaxisp.domains import RGB
from jaxisp.numerics import per_plane, straight_through
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.windows import gaussian_blur


@parameters
class UnsharpMask:
    """Strength, width and threshold of the mask."""

    amount: Leaf = param(0.5, (0.0, 4.0), "1", doc="share of the detail that is added")
    sigma: Leaf = param(1.5, (0.1, 4.0), "px", log=True, doc="standard deviation of the blur")
    threshold: Leaf = param(0.0, (0.0, 0.2), "level", doc="smaller detail is left alone")


@register
def unsharp_mask(params: UnsharpMask, image: RGB, *, radius: int = 12) -> RGB:
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

    def sharpen(plane: jax.Array) -> jax.Array:
        detail = plane - gaussian_blur(plane, params.sigma, radius)
        excess = jnp.abs(detail) - params.threshold
        soft = jax.nn.sigmoid(excess / (0.05 * params.threshold + 1e-4))
        gate = straight_through((excess > 0).astype(plane.dtype), soft)
        return plane + params.amount * gate * detail

    return per_plane(sharpen, image)
