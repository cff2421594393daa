"""What the demosaicking algorithms share: the layout of a mosaic and its colour differences.

Every border is reflected without repeating the edge, which keeps the phase of the mosaic: a result
is the same as if the mosaic had been continued by its mirror image.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxisp import cfa as cfa_layout
from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.stencils import pad, views
from jaxisp.arrays.varying import alike

Planes = tuple[jax.Array, jax.Array, jax.Array]
Pair = tuple[jax.Array, jax.Array]

CROSS = [(0, -1), (0, 1), (-1, 0), (1, 0)]
"""Left, right, up, down."""
DIAGONALS = [(-1, -1), (-1, 1), (1, -1), (1, 1)]


def neighbours(plane: jax.Array, offsets: Sequence[tuple[int, int]]) -> tuple[jax.Array, ...]:
    """An (H, W) plane seen from so many pixels away: view[y, x] = plane[y + dy, x + dx], borders reflected.

    Gradient: exact; the transpose is written as reads, see `demosaic.linear`.
    """
    return _neighbours(plane, tuple(offsets))


@partial(jax.jit, static_argnums=1)
def _neighbours(plane: jax.Array, offsets: tuple[tuple[int, int], ...]) -> tuple[jax.Array, ...]:
    shape, dtype = plane.shape, plane.dtype
    radius = max(max(abs(dy), abs(dx)) for dy, dx in offsets)

    def seen(_: None, x: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(views(pad(x, radius), offsets, radius))

    def collected(_: None, cotangents: tuple[jax.Array, ...]) -> jax.Array:
        wide = [
            views(pad(c, 2 * radius, "constant"), [(-dy, -dx)], radius)[0]
            for c, (dy, dx) in zip(cotangents, offsets, strict=True)
        ]
        like = alike(jnp.zeros(shape, dtype), wide[0])
        return jax.linear_transpose(lambda x: pad(x, radius), like)(materialize(sum(wide)))[0]

    return linear_call(seen, collected, None, plane)


def paired_sum(planes: Sequence[jax.Array]) -> jax.Array:
    """The sum of two, four or eight views, each pair first: with views of `CROSS` or `DIAGONALS`,
    or of both, a mirror image has the mirror image of the sum, to the bit."""
    while len(planes) > 1:
        planes = [a + b for a, b in zip(planes[::2], planes[1::2], strict=True)]
    return planes[0]


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


def row_and_column_sums(padded: jax.Array, radius: int, step: int = 1) -> Pair:
    """The sums of the two samples `step` away in the row and in the column."""
    left, right, up, down = views(padded, [(step * y, step * x) for y, x in CROSS], radius)
    return left + right, up + down


def diagonal_sum(padded: jax.Array, radius: int) -> jax.Array:
    """The sum of the four diagonal neighbours."""
    a, b, c, d = views(padded, DIAGONALS, radius)
    return (a + b) + (c + d)


def spread_differences(at: Sites, padded: jax.Array) -> Pair:
    """R - G and B - G everywhere, bilinear, out of `mosaic - G` known on red and blue sites.

    `padded` has a border of one pixel more than the layout.
    """
    row, column = row_and_column_sums(padded, 1)
    return red_and_blue(at, padded[1:-1, 1:-1], 0.25 * diagonal_sum(padded, 1), 0.5 * row, 0.5 * column)


def collect(padded: jax.Array, radius: int) -> jax.Array:
    """What a sample collects from a plane that it was spread over bilinearly: the adjoint of spreading."""
    (centre,) = views(padded, [(0, 0)], radius)
    row, column = row_and_column_sums(padded, radius)
    return centre + (0.5 * (row + column) + 0.25 * diagonal_sum(padded, radius))


def collect_differences(at: Sites, red: jax.Array, blue: jax.Array) -> jax.Array:
    """The adjoint of `spread_differences` on cotangents of R - G and B - G; 0 on green sites."""
    from_red, from_blue = collect(pad(red, 1), 1), collect(pad(blue, 1), 1)
    return jnp.where(at.red, from_red, jnp.where(at.blue, from_blue, 0))


_ROW = [(0, s) for s in (-2, -1, 1, 2)]
_COLUMN = [(s, 0) for s in (-2, -1, 1, 2)]


def directional_greens(at: Sites, mosaic: jax.Array) -> Pair:
    """Green interpolated along rows and along columns with [-1, 2, 2, 2, -1] / 4 (Hamilton & Adams 1997)."""
    padded = pad(mosaic, 2)

    def along(offsets: list[tuple[int, int]]) -> jax.Array:
        far, near, near_too, far_too = views(padded, offsets, 2)
        estimate = 0.5 * (near + near_too) + 0.25 * ((mosaic - far) + (mosaic - far_too))
        return jnp.where(at.green, mosaic, estimate)

    return along(_ROW), along(_COLUMN)


def collect_greens(at: Sites, to_rows: jax.Array, to_columns: jax.Array) -> jax.Array:
    """The adjoint of `directional_greens`, from cotangents that are 0 on green sites."""
    rows, columns = pad(to_rows, 2), pad(to_columns, 2)
    (near, _), (far, _) = (row_and_column_sums(rows, 2, step) for step in (1, 2))
    (_, near_too), (_, far_too) = (row_and_column_sums(columns, 2, step) for step in (1, 2))
    own = 0.5 * (to_rows + to_columns) - 0.25 * (far + far_too)
    return jnp.where(at.green, 0.5 * (near + near_too), own)


def clamped_greens(at: Sites, mosaic: jax.Array, choices: Pair | None = None) -> tuple[Pair, Pair]:
    """`directional_greens` kept between the two neighbours along the direction.

    Args:
        at: the layout.
        mosaic: (H, W).
        choices: for each direction what to take: -1 the neighbour to the left or above, 1 the one to the
            right or below, 0 the estimate. Found from the mosaic where they are not given.

    Returns:
        The greens and the choices.
    """
    padded = pad(mosaic, 2)

    def along(offsets: list[tuple[int, int]], estimate: jax.Array, choice: jax.Array | None) -> Pair:
        _, near, near_too, _ = views(padded, offsets, 2)
        if choice is None:
            first_is_low = near <= near_too
            below, above = estimate < jnp.minimum(near, near_too), estimate > jnp.maximum(near, near_too)
            first, second = (below & first_is_low) | (above & ~first_is_low), below | above
            choice = jnp.where(at.green, 0, jnp.where(first, -1, second.astype(jnp.int8)))
        return jnp.where(choice == 0, estimate, jnp.where(choice < 0, near, near_too)), choice

    given = choices or (None, None)
    estimates = materialize(directional_greens(at, mosaic))
    rows, columns = (along(*args) for args in zip((_ROW, _COLUMN), estimates, given, strict=True))
    return (rows[0], columns[0]), (rows[1], columns[1])


def collect_clamped_greens(at: Sites, cotangents: Pair, choices: Pair) -> jax.Array:
    """The adjoint of `clamped_greens` under these choices, from cotangents that are 0 on green sites."""
    estimates = (jnp.where(choice == 0, c, 0) for c, choice in zip(cotangents, choices, strict=True))
    collected = collect_greens(at, *materialize(tuple(estimates)))
    for axis, cotangent, choice in zip((1, 0), cotangents, choices, strict=True):
        index = jax.lax.broadcasted_iota(jnp.int32, cotangent.shape, axis)
        at_start, at_end = index == 0, index == cotangent.shape[axis] - 1
        # on the frame's edge both neighbours are the same sample, in the mirror the first is the second
        both = jnp.where(choice == 0, 0, 0.5 * cotangent)
        first, second = (
            materialize(jnp.where(at_start | at_end, both, jnp.where(choice == c, cotangent, 0)))
            for c in (-1, 1)
        )
        before, after = ((0, -1), (0, 1)) if axis else ((-1, 0), (1, 0))
        (from_second,), (from_first,) = views(pad(second, 1), [before], 1), views(pad(first, 1), [after], 1)
        collected += jnp.where(at_start, from_first, from_second) + jnp.where(at_end, from_second, from_first)
    return collected
