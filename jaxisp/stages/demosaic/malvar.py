"""Malvar, He & Cutler's gradient-corrected linear demosaicking."""

import jax.numpy as jnp

from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import CROSS, DIAGONALS, red_and_blue, sites
from jaxisp.windows import pad, views


@register
def demosaic_malvar(image: Mosaic, *, cfa: str = "RGGB") -> CameraRGB:
    """Bilinear interpolation plus a share of the Laplacian of the colour measured on the spot.

    `G = bilinear + 1/2 Lap(x)` on red and blue; R and B are bilinear plus 5/8 of a 5x5 Laplacian of
    green on green, plus 3/4 Lap(x) on the opposite colour, where `Lap(x) = x - mean of the 4 at distance 2`.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: exact (linear).

    Source: Malvar, He & Cutler 2004, figure 2 (gains 1/2, 5/8, 3/4).
    """
    at = sites(image.shape, cfa)
    padded = pad(image, 2)
    left, right, up, down = views(padded, CROSS, 2)
    far_left, far_right, far_up, far_down = views(padded, [(2 * y, 2 * x) for y, x in CROSS], 2)
    a, b, c, d = views(padded, DIAGONALS, 2)
    row, column, diagonal = left + right, up + down, (a + b) + (c + d)
    far_row, far_column = far_left + far_right, far_up + far_down

    green = 0.5 * image + 0.25 * (row + column) - 0.125 * (far_row + far_column)
    opposite = 0.75 * image + 0.25 * diagonal - 0.1875 * (far_row + far_column)
    in_row = 0.625 * image + 0.5 * row - 0.125 * (diagonal + far_row) + 0.0625 * far_column
    in_column = 0.625 * image + 0.5 * column - 0.125 * (diagonal + far_column) + 0.0625 * far_row
    red, blue = red_and_blue(at, image, opposite, in_row, in_column)
    return jnp.stack([red, jnp.where(at.green, image, green), blue], axis=-1)
