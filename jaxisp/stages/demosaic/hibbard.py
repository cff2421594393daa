"""Hibbard's demosaicking by luminance gradients: the "Kodak" algorithm of Jaroensri et al. 2019."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad, views
from jaxisp.cfa import Bayer, check_bayer, shifted
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    CROSS,
    collect_differences,
    row_and_column_sums,
    sites,
    spread_differences,
)
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear


@register(reach=2, symmetric=True)
def demosaic_hibbard(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
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
    check_bayer(cfa)
    forward = partial(_with_share, cfa)
    adjoint = mirrored(forward, partial(_collect, cfa), image.shape)
    return piecewise_linear(partial(_evaluate, cfa), forward, adjoint)(image)


def _evaluate(cfa: str, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array]]:
    """The picture, and the share that the mean of the row has in green: 1, 0, or 1/2 on a tie.

    The share comes with a border of one pixel, as `_finish` needs it.
    """
    padded = pad(image, 2)
    left, right, up, down = views(padded, CROSS, 1)
    across, along = jnp.abs(left - right), jnp.abs(up - down)
    share = jnp.where(across < along, 1.0, jnp.where(across > along, 0.0, 0.5)).astype(image.dtype)
    return _finish(cfa, padded, share), (share,)


def _with_share(cfa: str, share: jax.Array, image: jax.Array) -> jax.Array:
    return _finish(cfa, pad(image, 2), share)


def _finish(cfa: str, padded: jax.Array, share: jax.Array) -> jax.Array:
    """The picture out of a mosaic with a border of two pixels."""
    row, column = row_and_column_sums(padded, 1)
    wide, image = padded[1:-1, 1:-1], padded[2:-2, 2:-2]
    difference = wide - (share * (0.5 * row) + (1 - share) * (0.5 * column))
    difference = materialize(jnp.where(sites(wide.shape, shifted(cfa, 1, 1)).green, 0, difference))
    green = image - difference[1:-1, 1:-1]
    red_green, blue_green = spread_differences(sites(image.shape, cfa), difference)
    return interleaved([green + red_green, green, green + blue_green])


def _collect(cfa: str, share: jax.Array, cotangent: jax.Array) -> jax.Array:
    """The adjoint of `_with_share`."""
    at = sites(cotangent.shape, cfa)
    red, green, blue = materialize(planes(cotangent))
    measured = collect_differences(at, red, blue)
    to_green = materialize(red + green + blue - measured)
    chosen, share = jnp.where(at.green, 0, to_green), share[1:-1, 1:-1]
    row, _ = row_and_column_sums(pad(share * chosen, 1), 1)
    _, column = row_and_column_sums(pad((1 - share) * chosen, 1), 1)
    return jnp.where(at.green, to_green + 0.5 * (row + column), measured)
