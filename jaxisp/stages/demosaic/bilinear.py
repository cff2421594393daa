"""Bilinear demosaicking."""

import jax.numpy as jnp

from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import CROSS, DIAGONALS, red_and_blue, sites
from jaxisp.windows import pad, views


@register
def demosaic_bilinear(image: Mosaic, *, cfa: str = "RGGB") -> CameraRGB:
    """Fill in each colour by the mean of its nearest samples: blurs, and leaves zipper and colour fringes.

    `G = (left + right + up + down) / 4` on red and blue; R and B are the mean of the 2 nearest in the
    row or column on green, of the 4 diagonal ones on the opposite colour.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: exact (linear).

    Source: Longere et al. 2002, bilinear interpolation.
    """
    at = sites(image.shape, cfa)
    padded = pad(image, 1)
    left, right, up, down = views(padded, CROSS, 1)
    a, b, c, d = views(padded, DIAGONALS, 1)
    row, column = 0.5 * (left + right), 0.5 * (up + down)
    red, blue = red_and_blue(at, image, 0.25 * ((a + b) + (c + d)), row, column)
    return jnp.stack([red, jnp.where(at.green, image, 0.5 * (row + column)), blue], axis=-1)
