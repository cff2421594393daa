"""Edge-aware interpolation without colour differences, as simple converters do it."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import collect, diagonal_sum, red_and_blue, row_and_column_sums, sites
from jaxisp.stages.demosaic.hamilton_adams import share_of_rows
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear


@register(reach=1, symmetric=True)
def demosaic_edge_aware(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Interpolate green along the direction in which it changes less, red and blue bilinearly.

    `G = (left + right) / 2 if |left - right| <= |up - down| else (up + down) / 2`.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choice of direction is held constant, exact in all else.

    Source: OpenCV's "edge-aware" conversion; Hibbard 1995 for the choice.
    """
    check_bayer(cfa)
    forward = partial(_by_planes, cfa)
    adjoint = mirrored(forward, partial(_collected, cfa), image.shape)
    return piecewise_linear(partial(_evaluate, cfa), forward, adjoint)(image)


def _evaluate(cfa: str, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array]]:
    share = share_of_rows(image, curved=False, tie=1.0)
    return _by_planes(cfa, share, image), (share,)


def _by_planes(cfa: str, share: jax.Array, image: jax.Array) -> jax.Array:
    at = sites(image.shape, cfa)
    padded = pad(image, 1)
    row, column = row_and_column_sums(padded, 1)
    green = jnp.where(at.green, image, share * (0.5 * row) + (1 - share) * (0.5 * column))
    red, blue = red_and_blue(at, image, 0.25 * diagonal_sum(padded, 1), 0.5 * row, 0.5 * column)
    return interleaved([red, green, blue])


def _collected(cfa: str, share: jax.Array, cotangent: jax.Array) -> jax.Array:
    """The adjoint of `_by_planes`: a sample collects, in its colour, from where it was spread."""
    at = sites(share.shape, cfa)
    red, green, blue = planes(cotangent)
    row, _ = row_and_column_sums(pad(share * green, 1), 1)
    _, column = row_and_column_sums(pad((1 - share) * green, 1), 1)
    from_red, from_blue = (collect(pad(p, 1), 1) for p in (red, blue))
    return jnp.where(at.red, from_red, jnp.where(at.blue, from_blue, green + 0.5 * (row + column)))
