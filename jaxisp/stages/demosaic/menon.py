"""Menon, Andriani & Calvagno's directional filtering with a posteriori decision."""

import jax
import jax.numpy as jnp

from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.numerics import materialize
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    Pair,
    Sites,
    directional_greens,
    red_and_blue,
    row_and_column_means,
    sites,
)
from jaxisp.windows import pad, views


@register
def demosaic_menon(image: Mosaic, *, cfa: str = "RGGB", refining: bool = True) -> CameraRGB:
    """Interpolate green along rows and along columns, keep where colour differences vary less, and refine.

    `G = G_h if d_v >= d_h else G_v`, `d` the weighted sum over a 5x5 window of `|C(n) - C(n + 2)|`
    along the direction, `C = x - G_h` or `x - G_v`. On green sites R and B follow by the mean difference
    from G, on the opposite colour by the mean difference R - B along the chosen direction. Refining
    replaces each interpolated difference by a mean of three along that direction.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.
        refining: whether to run the refining step.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choice of direction is held constant, exact in all else.

    Source: Menon, Andriani & Calvagno 2007.
    """
    at = sites(image.shape, cfa)
    across, down = materialize(directional_greens(at, image))
    horizontal = _variation(image - down, vertical=True) >= _variation(image - across, vertical=False)
    horizontal, green = materialize((horizontal, jnp.where(horizontal, across, down)))
    red, blue = materialize(_differences(at, image - green, horizontal))
    if refining:
        red, green, blue = _refine(at, image, (red, green, blue), horizontal)
    return jnp.stack([green + red, green, green + blue], axis=-1)


def _variation(difference: jax.Array, vertical: bool) -> jax.Array:
    """How much colour differences vary along a direction, in a 5x5 window."""
    padded = pad(jax.lax.stop_gradient(difference), 2)

    def step(side: int, start: int, stop: int) -> jax.Array:
        ends = [(start, side), (stop, side)] if vertical else [(side, start), (side, stop)]
        a, b = views(padded, ends, 2)
        return jnp.abs(a - b)

    own = {side: step(side, -2, 0) + step(side, 0, 2) for side in (-2, 0, 2)}
    return (own[-2] + own[2]) + 3 * own[0] + (step(-1, -1, 1) + step(1, -1, 1))


def _along(horizontal: jax.Array, plane: jax.Array) -> jax.Array:
    """The mean of the two nearest along the chosen direction."""
    return jnp.where(horizontal, *row_and_column_means(plane))


def _differences(at: Sites, known: jax.Array, horizontal: jax.Array) -> Pair:
    """R - G and B - G everywhere, out of `mosaic - G` known on red and blue sites."""
    row, column = row_and_column_means(known)
    # on green sites R - B; on a red or blue site its mean is what parts the opposite colour from the own
    red_blue = materialize(jnp.where(at.green, jnp.where(at.red_row, row - column, column - row), 0))
    gap = _along(horizontal, red_blue)
    opposite = known + jnp.where(at.blue, gap, -gap)
    return red_and_blue(at, known, opposite, row, column)


def _refine(
    at: Sites, mosaic: jax.Array, differences: tuple[jax.Array, jax.Array, jax.Array], horizontal: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The refining step on (R - G, G, B - G); returns the same."""
    red, _, blue = differences
    smooth_red, smooth_blue = ((2 * _along(horizontal, d) + d) / 3 for d in (red, blue))
    known = jnp.where(at.red, smooth_red, jnp.where(at.blue, smooth_blue, 0))
    known = materialize(known)
    row, column = row_and_column_means(known)
    # R - B: fresh on green sites; on red and blue sites as it was before this step
    fresh = jnp.where(at.red_row, row - column, column - row)
    red_blue = materialize(jnp.where(at.green, fresh, red - blue))
    gap = (2 * _along(horizontal, red_blue) + red_blue) / 3
    new_red, new_blue = red_and_blue(at, known, known + jnp.where(at.blue, gap, -gap), row, column)
    return new_red, mosaic - known, new_blue
