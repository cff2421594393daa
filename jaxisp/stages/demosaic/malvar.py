"""Malvar, He & Cutler's gradient-corrected linear demosaicking."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad, views
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    collect,
    diagonal_sum,
    red_and_blue,
    row_and_column_sums,
    sites,
)
from jaxisp.stages.demosaic.linear import mirrored


@register(reach=2, symmetric=True)
def demosaic_malvar(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
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
    check_bayer(cfa)
    forward = partial(_interpolate, cfa)
    adjoint = mirrored(forward, partial(_collect, cfa), image.shape)
    return linear_call(lambda _, x: forward(x), lambda _, y: adjoint(y), (), image)


def _interpolate(cfa: str, image: jax.Array) -> jax.Array:
    at = sites(image.shape, cfa)
    padded = pad(image, 2)
    row, column = row_and_column_sums(padded, 2)
    far_row, far_column = row_and_column_sums(padded, 2, step=2)
    diagonal = diagonal_sum(padded, 2)

    green = 0.5 * image + 0.25 * (row + column) - 0.125 * (far_row + far_column)
    opposite = 0.75 * image + 0.25 * diagonal - 0.1875 * (far_row + far_column)
    in_row = 0.625 * image + 0.5 * row - 0.125 * (diagonal + far_row) + 0.0625 * far_column
    in_column = 0.625 * image + 0.5 * column - 0.125 * (diagonal + far_column) + 0.0625 * far_row
    red, blue = red_and_blue(at, image, opposite, in_row, in_column)
    return interleaved([red, jnp.where(at.green, image, green), blue])


def _collect(cfa: str, cotangent: jax.Array) -> jax.Array:
    """The adjoint: what a red, a green and a blue sample were used for, with the same weights."""
    at = sites(cotangent.shape, cfa)
    red, green, blue = padded = [pad(p, 2) for p in planes(cotangent)]
    own_red, own_green, own_blue = (views(p, [(0, 0)], 2)[0] for p in padded)
    far_red, far_green, far_blue = (row_and_column_sums(p, 2, step=2) for p in padded)
    row, column = row_and_column_sums(green, 2)

    in_green = 0.5 * own_green - 0.125 * (far_green[0] + far_green[1])
    in_blue = 0.75 * own_blue - 0.1875 * (far_blue[0] + far_blue[1])
    in_red = 0.75 * own_red - 0.1875 * (far_red[0] + far_red[1])
    along = jnp.where(at.red_row, far_red[0] + far_blue[1], far_red[1] + far_blue[0])
    across = jnp.where(at.red_row, far_red[1] + far_blue[0], far_red[0] + far_blue[1])
    diagonal = diagonal_sum(red, 2) + diagonal_sum(blue, 2)
    from_green = own_green + 0.25 * (row + column) + 0.625 * (own_red + own_blue)
    from_green += 0.0625 * across - 0.125 * (diagonal + along)
    from_red, from_blue = collect(red, 2) + in_blue, collect(blue, 2) + in_red
    return jnp.where(at.green, from_green, in_green + jnp.where(at.red, from_red, from_blue))
