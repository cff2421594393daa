"""Menon, Andriani & Calvagno's directional filtering with a posteriori decision."""

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
    Sites,
    collect_greens,
    directional_greens,
    red_and_blue,
    row_and_column_sums,
    sites,
)
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear


@register(reach=8, symmetric=True)
def demosaic_menon(image: Mosaic, *, cfa: Bayer = "RGGB", refining: bool = True) -> CameraRGB:
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
    check_bayer(cfa)
    forward = partial(_with_direction, cfa, refining)
    adjoint = mirrored(forward, partial(_collect, cfa, refining), image.shape)
    return piecewise_linear(partial(_evaluate, cfa, refining), forward, adjoint)(image)


def _evaluate(cfa: str, refining: bool, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array]]:
    """The picture, and where it follows rows."""
    at = sites(image.shape, cfa)
    across, down = materialize(directional_greens(at, image))
    horizontal = _variation(image - down, vertical=True) >= _variation(image - across, vertical=False)
    horizontal, known = materialize((horizontal, image - jnp.where(horizontal, across, down)))
    return _finish(at, refining, image, known, horizontal), (horizontal,)


def _with_direction(cfa: str, refining: bool, horizontal: jax.Array, image: jax.Array) -> jax.Array:
    at = sites(image.shape, cfa)
    known = materialize(image - jnp.where(horizontal, *directional_greens(at, image)))
    return _finish(at, refining, image, known, horizontal)


def _variation(difference: jax.Array, vertical: bool) -> jax.Array:
    """How much colour differences vary along a direction, in a 5x5 window."""
    padded = pad(jax.lax.stop_gradient(difference), 2)

    def step(side: int, start: int, stop: int) -> jax.Array:
        ends = [(start, side), (stop, side)] if vertical else [(side, start), (side, stop)]
        a, b = views(padded, ends, 2)
        return jnp.abs(a - b)

    own = {side: step(side, -2, 0) + step(side, 0, 2) for side in (-2, 0, 2)}
    return (own[-2] + own[2]) + 3 * own[0] + (step(-1, -1, 1) + step(1, -1, 1))


def _finish(
    at: Sites, refining: bool, image: jax.Array, known: jax.Array, horizontal: jax.Array
) -> jax.Array:
    """The picture out of `known`: the difference from green on red and blue sites, 0 on green ones.

    On green sites R - G and B - G are means of two known ones. A red site's B - G is its own R - G less
    R - B, the mean over its neighbours along the chosen direction of what the known ones say there.
    Refining takes the mean of each known difference, twice, with those one step away (which are means
    themselves: the weights come to 1/6, 2/3, 1/6 at a step of 2), and that of R - B, twice the new with
    once the old.
    """
    gap_source = known
    if refining:
        padded = pad(known, 2)
        row, column = row_and_column_sums(padded, 2, step=2)
        refined = jnp.where(at.green, 0, (2 / 3) * known + jnp.where(horizontal, row, column) / 6)
        known, gap_source = materialize((refined, (2 * refined + known) / 3))
    row, column = row_and_column_sums(pad(gap_source, 1), 1)
    red_blue = materialize(jnp.where(at.green, 0.5 * jnp.where(at.red_row, row - column, column - row), 0))
    row, column = row_and_column_sums(pad(red_blue, 1), 1)
    gap = 0.5 * jnp.where(horizontal, row, column)
    row, column = row_and_column_sums(pad(known, 1), 1)
    opposite = known + jnp.where(at.blue, gap, -gap)
    red, blue = red_and_blue(at, known, opposite, 0.5 * row, 0.5 * column)
    green = image - known
    return interleaved([green + red, green, green + blue])


def _collect(cfa: str, refining: bool, horizontal: jax.Array, cotangent: jax.Array) -> jax.Array:
    """The adjoint of `_with_direction`: `_finish` backwards, line by line."""
    at = sites(cotangent.shape, cfa)
    red, green, blue = materialize(planes(cotangent))
    to_known, to_gap = _collect_colors(at, red, green, blue)
    to_gap = materialize(to_gap)
    row, _ = row_and_column_sums(pad(jnp.where(horizontal, to_gap, 0), 1), 1)
    _, column = row_and_column_sums(pad(jnp.where(horizontal, 0, to_gap), 1), 1)
    to_red_blue = materialize(jnp.where(at.green, 0.5 * (row + column), 0))
    row, column = row_and_column_sums(pad(to_red_blue, 1), 1)
    both = 0.5 * (row + column)  # in every R - B red counts with +, blue with -
    to_source = jnp.where(at.red, both, jnp.where(at.blue, -both, 0))
    if refining:
        refined = materialize(to_known + (2 / 3) * to_source)
        row, _ = row_and_column_sums(pad(jnp.where(horizontal, refined, 0), 2), 2, step=2)
        _, column = row_and_column_sums(pad(jnp.where(horizontal, 0, refined), 2), 2, step=2)
        to_known = jnp.where(at.green, 0, (2 / 3) * refined + (row + column) / 6) + to_source / 3
    else:
        to_known = to_known + to_source
    to_known = materialize(to_known)
    by_rows, by_columns = jnp.where(horizontal, -to_known, 0), jnp.where(horizontal, 0, -to_known)
    return red + green + blue + to_known + collect_greens(at, by_rows, by_columns)


def _collect_colors(
    at: Sites, red: jax.Array, green: jax.Array, blue: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Cotangents of `known` and of `gap`, both 0 on green sites."""
    row, column = row_and_column_sums(pad(red, 1), 1)
    row_too, column_too = row_and_column_sums(pad(blue, 1), 1)
    spread = 0.5 * jnp.where(at.red, row + column, row_too + column_too)
    to_known = jnp.where(at.green, 0, spread - green)  # its own colours less what green takes away
    return to_known, jnp.where(at.blue, red, jnp.where(at.red, -blue, 0))
