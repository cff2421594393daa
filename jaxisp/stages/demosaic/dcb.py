"""Gozdz's DCB: the direction whose guesses vary as the samples do, refined on the map of directions."""

from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    CROSS,
    DIAGONALS,
    Planes,
    Sites,
    neighbours,
    paired_sum,
    red_and_blue,
    sites,
)

_TWO_AWAY = [(2 * y, 2 * x) for y, x in CROSS]
_AROUND = CROSS + DIAGONALS


@register(reach=16, symmetric=True)
def demosaic_dcb(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Blend the means of the greens to the sides and above and below by a map of directions.

    The first map comes of two guesses of the opposite colour at red and blue sites, with green from the row
    and from the column: the direction is taken whose guesses have a range nearer to that of the samples. On
    the green that results each pixel is called horizontal or vertical by its neighbours: above their mean it
    lies on a ridge, below in a valley, and the direction is that in which green rises or falls less. Green is
    interpolated anew by the share of vertical pixels in a diamond of 13, four times, the first with a
    second difference of the pixel's smoothed colour. Red and blue follow by bilinear colour differences.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the map of directions is held constant, exact in all else.

    Source: J. Gozdz 2010, as LibRaw 0.22 has it, without its iterations before and its enhancement after. Its
    smoothing of colours is in place there, in scan order.
    """
    check_bayer(cfa)
    at = sites(image.shape, cfa)
    share = _share_of_columns(at, lax.stop_gradient(image))
    left, right, up, down = neighbours(image, CROSS)
    green = jnp.where(at.green, image, (1 - share) * (0.5 * (left + right)) + share * (0.5 * (up + down)))
    return interleaved(_colored(at, image, materialize(green)))


def _share_of_columns(at: Sites, image: jax.Array) -> jax.Array:
    """The share of the column's mean in green on red and blue sites, multiples of 1/16."""
    left, right, up, down = neighbours(image, CROSS)
    rows, columns = materialize((0.5 * (left + right), 0.5 * (up + down)))
    samples = _range(image, _TWO_AWAY) + _range(image, DIAGONALS)
    off_rows, off_columns = (
        jnp.abs(samples - _guessed_range(at, image, jnp.where(at.green, image, g))) for g in (rows, columns)
    )
    green = materialize(jnp.where(at.green, image, jnp.where(off_rows < off_columns, rows, columns)))
    red, _, blue = materialize(_colored(at, image, green))
    share = _share(green)
    own = materialize(green + jnp.where(at.red, _smoothed(red - green), _smoothed(blue - green)))
    left, right, up, down = neighbours(own, _TWO_AWAY)
    curved = rows + own - 0.5 * (left + right), columns + own - 0.5 * (up + down)
    green = materialize(jnp.where(at.green, image, (1 - share) * curved[0] + share * curved[1]))
    for _ in range(2):
        share = _share(green)
        green = materialize(jnp.where(at.green, image, (1 - share) * rows + share * columns))
    return materialize(_share(green))


def _range(plane: jax.Array, offsets: list[tuple[int, int]]) -> jax.Array:
    around = neighbours(plane, offsets)
    return reduce(jnp.maximum, around) - reduce(jnp.minimum, around)


def _guessed_range(at: Sites, image: jax.Array, green: jax.Array) -> jax.Array:
    """The range of the opposite colour two away and of the pixel's own on the diagonals, both guessed."""
    difference = materialize(jnp.where(at.green, 0, image - green))
    guess = materialize(green + 0.25 * paired_sum(neighbours(difference, DIAGONALS)))
    return _range(guess, _TWO_AWAY) + _range(guess, DIAGONALS)


def _colored(at: Sites, image: jax.Array, green: jax.Array) -> Planes:
    """Red and blue by bilinear colour differences."""
    difference = materialize(jnp.where(at.green, 0, image - green))
    left, right, up, down, *diagonal = neighbours(difference, _AROUND)
    opposite = 0.25 * paired_sum(diagonal)
    red, blue = red_and_blue(at, difference, opposite, 0.5 * (left + right), 0.5 * (up + down))
    return green + red, green, green + blue


def _smoothed(difference: jax.Array) -> jax.Array:
    """The mean of the eight around each pixel."""
    return paired_sum(neighbours(difference, _AROUND)) / 8


def _share(green: jax.Array) -> jax.Array:
    """The share of pixels whose green goes along the column, in a diamond of 13 weighed 4, 2, 1."""
    left, right, up, down = neighbours(green, CROSS)
    rows, columns = left + right, up + down
    ridge = green > 0.25 * (rows + columns)
    low = (rows + jnp.minimum(left, right)) < (columns + jnp.minimum(up, down))
    high = (rows + jnp.maximum(left, right)) > (columns + jnp.maximum(up, down))
    vertical = materialize(jnp.where(ridge, low, high).astype(green.dtype))
    near = reduce(jnp.add, neighbours(vertical, CROSS))
    far = reduce(jnp.add, neighbours(vertical, _TWO_AWAY))
    return (4 * vertical + 2 * near + far) / 16
