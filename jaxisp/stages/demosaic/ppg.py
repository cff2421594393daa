"""Lin's pixel grouping: green along the flatter of two directions, red and blue by colour differences."""

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import CROSS, DIAGONALS, neighbours, red_and_blue, sites


@register(reach=5, symmetric=True)
def demosaic_ppg(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Interpolate green along the flatter direction, kept between its neighbours, and colours by differences.

    The flatness of a row weighs the samples two apart three times and the greens two apart three and two
    times; green is `(left + right) / 2 + (2 x - left_2 - right_2) / 4`, no lower and no higher than left and
    right. Red and blue follow by the mean difference from green: on green sites of the two beside, on the
    opposite colour along the diagonal that is flatter in that colour and in green, both on a tie.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choices of direction are held constant, exact in all else.

    Source: C.-K. Lin 2003, "Pixel grouping for color filter array demosaicing", with plain colour differences
    in place of his hue transit, as dcraw and LibRaw have it.
    """
    check_bayer(cfa)
    at = sites(image.shape, cfa)
    across, flat_rows = _along(image, horizontal=True)
    down, flat_columns = _along(image, horizontal=False)
    by_rows = lax.stop_gradient(flat_rows <= flat_columns)
    green = materialize(jnp.where(at.green, image, jnp.where(by_rows, across, down)))
    difference = materialize(jnp.where(at.green, 0, image - green))
    left, right, up, down = neighbours(difference, CROSS)
    opposite = _opposite(image, green, difference)
    red, blue = red_and_blue(at, difference, opposite, 0.5 * (left + right), 0.5 * (up + down))
    return interleaved([green + red, green, green + blue])


def _along(image: jax.Array, *, horizontal: bool) -> tuple[jax.Array, jax.Array]:
    """Green on red and blue sites along a direction, and how far the mosaic is from flat there."""
    steps = [k for k in (-3, -2, -1, 1, 2, 3)]
    offsets = [(0, k) if horizontal else (k, 0) for k in steps]
    farthest, far, near, near_too, far_too, farthest_too = neighbours(image, offsets)
    estimate = 0.5 * (near + near_too) + 0.25 * ((image - far) + (image - far_too))
    inside = jnp.clip(estimate, jnp.minimum(near, near_too), jnp.maximum(near, near_too))
    around = jnp.abs(far - image) + jnp.abs(far_too - image) + jnp.abs(near - near_too)
    beyond = jnp.abs(farthest - near) + jnp.abs(farthest_too - near_too)
    return materialize((inside, 3 * around + 2 * beyond))


def _opposite(image: jax.Array, green: jax.Array, difference: jax.Array) -> jax.Array:
    """The colour difference that a red site takes from the blue ones around it, and the other way round."""
    colors, greens = (neighbours(lax.stop_gradient(p), DIAGONALS) for p in (image, green))
    a, b, c, d = neighbours(difference, DIAGONALS)
    centre = lax.stop_gradient(green)

    def steep(i: int, j: int) -> jax.Array:
        in_green = jnp.abs(greens[i] - centre) + jnp.abs(greens[j] - centre)
        return jnp.abs(colors[i] - colors[j]) + in_green

    falling, rising = steep(0, 3), steep(1, 2)
    share = jnp.where(falling < rising, 1.0, jnp.where(falling > rising, 0.0, 0.5)).astype(image.dtype)
    return share * (0.5 * (a + d)) + (1 - share) * (0.5 * (b + c))
