"""What the demosaicking algorithms share: the layout of a mosaic and its colour differences.

Every border is reflected without repeating the edge, which keeps the phase of the mosaic: a result
is the same as if the mosaic had been continued by its mirror image.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxisp import cfa as cfa_layout
from jaxisp.windows import pad, views

Planes = tuple[jax.Array, jax.Array, jax.Array]
Pair = tuple[jax.Array, jax.Array]

CROSS = [(0, -1), (0, 1), (-1, 0), (1, 0)]
"""Left, right, up, down."""
DIAGONALS = [(-1, -1), (-1, 1), (1, -1), (1, 1)]


class Sites(NamedTuple):
    """Where a mosaic's colours stand: boolean (H, W) masks."""

    red: jax.Array
    green: jax.Array
    blue: jax.Array
    red_row: jax.Array


def sites(shape: tuple[int, ...], cfa: str) -> Sites:
    """The masks of a pattern. Raises ValueError where it is not one."""
    red, green, blue = cfa_layout.masks((shape[0], shape[1]), cfa)
    rows = jax.lax.broadcasted_iota(jnp.int32, (shape[0], shape[1]), 0) % 2
    return Sites(red, green, blue, rows == cfa_layout.site(cfa, "R")[0])


def red_and_blue(
    at: Sites, own: jax.Array, opposite: jax.Array, in_row: jax.Array, in_column: jax.Array
) -> Pair:
    """The red and the blue plane out of what each kind of site takes.

    Args:
        at: the layout.
        own: where the colour was measured.
        opposite: where the other of red and blue was.
        in_row: on green sites whose row holds the colour.
        in_column: on green sites whose column holds it.
    """
    red = jnp.where(at.red, own, jnp.where(at.blue, opposite, jnp.where(at.red_row, in_row, in_column)))
    blue = jnp.where(at.blue, own, jnp.where(at.red, opposite, jnp.where(at.red_row, in_column, in_row)))
    return red, blue


def row_and_column_means(plane: jax.Array) -> Pair:
    """The means of the two nearest in the row and in the column."""
    left, right, up, down = views(pad(plane, 1), CROSS, 1)
    return 0.5 * (left + right), 0.5 * (up + down)


def spread_differences(at: Sites, difference: jax.Array) -> Pair:
    """R - G and B - G everywhere, bilinear, out of `mosaic - G` known on red and blue sites."""
    padded = pad(difference, 1)
    left, right, up, down = views(padded, CROSS, 1)
    a, b, c, d = views(padded, DIAGONALS, 1)
    return red_and_blue(at, difference, 0.25 * ((a + b) + (c + d)), 0.5 * (left + right), 0.5 * (up + down))


def directional_greens(at: Sites, mosaic: jax.Array) -> Pair:
    """Green interpolated along rows and along columns with [-1, 2, 2, 2, -1] / 4 (Hamilton & Adams 1997)."""
    padded = pad(mosaic, 2)

    def along(offsets: list[tuple[int, int]]) -> jax.Array:
        far, near, near_too, far_too = views(padded, offsets, 2)
        estimate = 0.5 * (near + near_too) + 0.25 * ((mosaic - far) + (mosaic - far_too))
        return jnp.where(at.green, mosaic, estimate)

    steps = (-2, -1, 1, 2)
    return along([(0, s) for s in steps]), along([(s, 0) for s in steps])
