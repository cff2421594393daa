"""Hibbard's demosaicking by luminance gradients: the "Kodak" algorithm of Jaroensri et al. 2019."""

import jax.numpy as jnp

from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.numerics import materialize
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import CROSS, sites, spread_differences
from jaxisp.windows import pad, views


@register
def demosaic_hibbard(image: Mosaic, *, cfa: str = "RGGB") -> CameraRGB:
    """Interpolate green along the direction in which it changes less, then the differences from green.

    `G = (left + right) / 2 if |left - right| < |up - down|, (up + down) / 2 if it is greater, the mean
    of the four if equal`; `R = G + bilinear(R - G)`, `B = G + bilinear(B - G)`.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choice of direction is held constant, exact in all else.

    Source: Hibbard 1995, US patent 5382976, with the two gradients compared with each other.
    """
    at = sites(image.shape, cfa)
    left, right, up, down = views(pad(image, 1), CROSS, 1)
    row, column = 0.5 * (left + right), 0.5 * (up + down)
    across, along = jnp.abs(left - right), jnp.abs(up - down)
    chosen = jnp.where(across < along, row, jnp.where(across > along, column, 0.5 * (row + column)))
    green = materialize(jnp.where(at.green, image, chosen))
    red_green, blue_green = spread_differences(at, image - green)
    return jnp.stack([green + red_green, green, green + blue_green], axis=-1)
