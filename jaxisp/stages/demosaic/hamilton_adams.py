"""Hamilton & Adams' adaptive colour plane interpolation."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad, views
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    CROSS,
    collect_differences,
    collect_greens,
    directional_greens,
    row_and_column_sums,
    sites,
    spread_differences,
)
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear


@register(reach=3, symmetric=True)
def demosaic_hamilton_adams(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Interpolate green along the direction that is flatter in green and in the pixel's own colour.

    `G = (left + right) / 2 + (2 x - left_2 - right_2) / 4` where `|left - right| + |2 x - left_2 - right_2|`
    is less than the same along the column, the column's where it is greater, the mean of both on a tie;
    `R = G + bilinear(R - G)`, `B = G + bilinear(B - G)`.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choice of direction is held constant, exact in all else.

    Source: Hamilton & Adams 1997, US patent 5629734; red and blue by plain colour differences.
    """
    check_bayer(cfa)
    forward = partial(_by_differences, cfa)
    adjoint = mirrored(forward, partial(_collected, cfa), image.shape)
    return piecewise_linear(partial(_evaluate, cfa), forward, adjoint)(image)


def _evaluate(cfa: str, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array]]:
    share = share_of_rows(image, curved=True)
    return _by_differences(cfa, share, image), (share,)


def share_of_rows(image: jax.Array, curved: bool, tie: float = 0.5) -> jax.Array:
    """The share of the row's estimate in green where it is missing: 1, 0, or `tie`.

    Args:
        image: (H, W) mosaic.
        curved: whether the second difference of the pixel's own colour counts too.
        tie: where rows and columns are equally flat.
    """
    padded = pad(image, 2)
    left, right, up, down = views(padded, CROSS, 2)
    across, along = jnp.abs(left - right), jnp.abs(up - down)
    if curved:
        row, column = row_and_column_sums(padded, 2, step=2)
        across, along = across + jnp.abs(2 * image - row), along + jnp.abs(2 * image - column)
    return materialize(
        jnp.where(across < along, 1.0, jnp.where(across > along, 0.0, tie)).astype(image.dtype)
    )


def _by_differences(cfa: str, share: jax.Array, image: jax.Array) -> jax.Array:
    at = sites(image.shape, cfa)
    across, down = materialize(directional_greens(at, image))
    green = share * across + (1 - share) * down
    difference = materialize(jnp.where(at.green, 0, image - green))
    red, blue = spread_differences(at, pad(difference, 1))
    green = image - difference
    return interleaved([green + red, green, green + blue])


def _collected(cfa: str, share: jax.Array, cotangent: jax.Array) -> jax.Array:
    """The adjoint of `_by_differences`."""
    at = sites(share.shape, cfa)
    red, green, blue = planes(cotangent)
    to_image = red + green + blue
    to_difference = collect_differences(at, red, blue) - jnp.where(at.green, 0, to_image)
    to_rows, to_columns = materialize((-share * to_difference, (share - 1) * to_difference))
    return to_image + to_difference + collect_greens(at, to_rows, to_columns)
