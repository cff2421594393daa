"""The lattice of X-Trans: 3x3 pixels around a green that has no green beside it.

Three kinds of places repeat every three pixels: the solitary green itself; its four neighbours, red or blue;
and the four greens at the corners, which form 2x2 blocks with those of the cells around. The neighbours in
the row have one colour, here called 0, those in the column the other, called 1. From a cell to the next, 0
and 1 are swapped, and that is all in which cells differ: so a stencil on 0 and 1 is the same in all of them.

A plane is held as nine smaller ones, one a place, of a value a cell. A stencil reads whole planes.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.cfa import shifted, solitary_green

Place = tuple[int, int]
"""(row, column) from the solitary green: -1, 0 or 1 for a place of the cell, or any offset [px]."""

SOLITARY: Place = (0, 0)
BESIDE: tuple[Place, ...] = ((0, -1), (0, 1), (-1, 0), (1, 0))
"""The red and blue places. Each is also the direction to the one other that is not green and touches it."""
CORNERS: tuple[Place, ...] = ((-1, -1), (-1, 1), (1, -1), (1, 1))

Planes = Mapping[Place, jax.Array]
"""By place, (..., M, N): a value for each of M x N cells."""


class Stored(NamedTuple):
    """Planes to be read at offsets, with a border of zeros one cell wide."""

    planes: Planes


def store(planes: Planes) -> Stored:
    """Make planes ready to be read at offsets."""

    def bordered(plane: jax.Array) -> jax.Array:
        margins = [(0, 0, 0)] * (plane.ndim - 2) + [(1, 1, 0)] * 2
        return lax.pad(plane, np.zeros((), plane.dtype), margins)

    return Stored(materialize({place: bordered(plane) for place, plane in planes.items()}))


def at(stored: Stored, place: Place, offset: Place, *, colored: bool = False) -> jax.Array:
    """The value so many pixels from a place, for every cell.

    Args:
        stored: the planes.
        place: where the stencil is centred.
        offset: at most three pixels in each direction.
        colored: whether the axis before the cells is that of the colours 0 and 1; those returned are of the
            cell of `place`.
    """
    row, column = ((p + o + 1) // 3 for p, o in zip(place, offset))
    source: Place = (place[0] + offset[0] - 3 * row, place[1] + offset[1] - 3 * column)
    plane = stored.planes[source]
    height, width = plane.shape[-2] - 2, plane.shape[-1] - 2
    view = plane[..., 1 + row : 1 + row + height, 1 + column : 1 + column + width]
    return view[..., ::-1, :, :] if colored and (row + column) % 2 else view


class Frame(NamedTuple):
    """How an (H, W) frame lies on the lattice.

    Args:
        before, after: rows and columns that are added so that whole cells cover the frame and its margin.
        red_first: whether colour 0 of the first cell is red.
        axes: first and last row, and column, about which the pattern is its own mirror image.
        shape: (H, W).
    """

    before: tuple[int, int]
    after: tuple[int, int]
    red_first: bool
    axes: tuple[tuple[int, int], tuple[int, int]]
    shape: tuple[int, int]


def frame(shape: tuple[int, int], cfa: str, margin: int) -> Frame:
    """Lay a frame of 6 x 6 pixels or more on the lattice, with that margin at least [px]."""
    first = solitary_green(cfa)
    before = tuple(margin + (1 - own - margin) % 3 for own in first)
    after = tuple(margin + -(size + b + margin) % 3 for size, b in zip(shape, before))
    own = shifted(cfa, -before[0], -before[1])  # of the first cell; its solitary green is at (1, 1)
    axes = tuple((a, a + (size - 1 - a) // 3 * 3) for a, size in zip(first, shape))
    return Frame((before[0], before[1]), (after[0], after[1]), own[6 + 2] == "R", (axes[0], axes[1]), shape)


def split(image: jax.Array, on: Frame) -> dict[Place, jax.Array]:
    """The planes of an (H, W) image, continued beyond its borders in phase, by mirror images."""
    for axis, (first, last) in enumerate(on.axes):

        def mirrored(rows: range, first: int = first, last: int = last) -> np.ndarray:
            half = last - first
            inside = (np.array(rows, np.int32) - first) % (2 * half)
            return first + np.minimum(inside, 2 * half - inside)

        size = on.shape[axis]
        head = jnp.take(image, mirrored(range(-on.before[axis], 0)), axis)
        tail = jnp.take(image, mirrored(range(size, size + on.after[axis])), axis)
        image = jnp.concatenate([head, image, tail], axis)
    height, width = image.shape
    cells = materialize(jnp.transpose(image.reshape(height // 3, 3, width // 3, 3), (1, 3, 0, 2)))
    return {(y, x): cells[y + 1, x + 1] for y in (-1, 0, 1) for x in (-1, 0, 1)}


def join(planes: Planes, on: Frame, margin: int) -> jax.Array:
    """(..., H + 2 margin, W + 2 margin) of planes (..., M, N): the inverse of `split`."""
    rows = [jnp.stack([planes[y, x] for x in (-1, 0, 1)], -1) for y in (-1, 0, 1)]
    cells = jnp.stack(rows, -3)  # (..., M, 3, N, 3)
    *rest, m, _, n, _ = cells.shape
    image = materialize(cells).reshape(*rest, 3 * m, 3 * n)
    top, left = (b - margin for b in on.before)
    height, width = (size + 2 * margin for size in on.shape)
    return image[..., top : top + height, left : left + width]


def red_and_blue(colored: Planes, on: Frame) -> tuple[Planes, Planes]:
    """Red and blue of planes (..., 2, M, N) of the colours 0 and 1."""

    def pick(which: int) -> Planes:
        def of(plane: jax.Array) -> jax.Array:
            m, n = plane.shape[-2:]
            parity = lax.broadcasted_iota(jnp.int32, (m, n), 0) + lax.broadcasted_iota(jnp.int32, (m, n), 1)
            zero = (parity % 2 == 0) == (on.red_first == (which == 0))
            return jnp.where(zero, plane[..., 0, :, :], plane[..., 1, :, :])

        return {place: of(plane) for place, plane in colored.items()}

    return pick(0), pick(1)
