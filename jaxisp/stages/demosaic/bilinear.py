"""Bilinear demosaicking."""

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


@register(reach=1, symmetric=True)
def demosaic_bilinear(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
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
    check_bayer(cfa)
    forward = partial(_interpolate, cfa)
    adjoint = mirrored(forward, partial(_collect, cfa), image.shape)
    return linear_call(lambda _, x: forward(x), lambda _, y: adjoint(y), (), image)


def _interpolate(cfa: str, image: jax.Array) -> jax.Array:
    at = sites(image.shape, cfa)
    padded = pad(image, 1)
    row, column = row_and_column_sums(padded, 1)
    red, blue = red_and_blue(at, image, 0.25 * diagonal_sum(padded, 1), 0.5 * row, 0.5 * column)
    return interleaved([red, jnp.where(at.green, image, 0.25 * (row + column)), blue])


def _collect(cfa: str, cotangent: jax.Array) -> jax.Array:
    """The adjoint: a sample collects from the pixels that it was spread over, in its own colour."""
    at = sites(cotangent.shape, cfa)
    red, green, blue = (pad(p, 1) for p in planes(cotangent))
    row, column = row_and_column_sums(green, 1)
    (own,) = views(green, [(0, 0)], 1)
    from_green = own + 0.25 * (row + column)
    return jnp.where(at.red, collect(red, 1), jnp.where(at.blue, collect(blue, 1), from_green))
