"""Noise of a sensor seen after white balance: each colour amplified by its own gain."""

import jax

from jaxisp import cfa as filters
from jaxisp.arrays.extents import Extent
from jaxisp.arrays.safe_math import safe_sqrt
from jaxisp.cfa import Pattern
from jaxisp.domains import Mosaic
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.noise.draws import normal


@parameters
class BalancedNoise:
    """Shot and read noise, and the gains they go through."""

    shot: Leaf = param(4e-4, (0.0, 0.1), "level", doc="variance per unit of light, in green")
    read: Leaf = param(0.004, (0.0, 0.2), "level", doc="standard deviation in the dark, in green")
    red_gain: Leaf = param(2.0, (0.2, 8.0), "1", log=True, doc="gain of red, whose noise it amplifies")
    blue_gain: Leaf = param(1.6, (0.2, 8.0), "1", log=True, doc="gain of blue")


@register
def balanced_noise(
    params: BalancedNoise,
    image: Mosaic,
    *,
    key: jax.Array,
    extent: Extent | None = None,
    cfa: Pattern = "RGGB",
) -> Mosaic:
    """Add shot and read noise to a mosaic that is white-balanced already.

    `y = x + sqrt(g_c shot max(x, 0) + (g_c read)**2) n`, g_c the gain of the colour, 1 for green: the noise
    of `x / g_c` as a sensor sees it, times g_c.

    Args:
        params: shot, read and the gains of red and blue.
        image: (H, W) white-balanced linear light, any range.
        key: draws the noise.
        extent: of the picture, where the image is a larger frame.
        cfa: the Bayer or X-Trans pattern, row-major from the top-left.

    Returns:
        (H, W) linear light, not clipped.

    Gradient: exact (where the variance is 0, that of the noise is taken as 0).

    Source: Foi et al. 2008; EMVA Standard 1288.
    """
    masks = filters.masks((image.shape[0], image.shape[1]), cfa)
    red, blue = (g.astype(image.dtype) + 0 * image for g in (params.red_gain, params.blue_gain))
    gain = filters.select(masks, red, 1 + 0 * image, blue)
    light = (image > 0).astype(image.dtype) * image
    variance = gain * params.shot * light + (gain * params.read) ** 2
    return image + safe_sqrt(variance) * normal(key, image, extent=extent)
