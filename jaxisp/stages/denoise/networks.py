"""Medians by comparator networks: exact, branch-free, minima and maxima only."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxisp.arrays.stencils import pad, views

Network = tuple[tuple[int, int], ...]
"""Comparators (i, j): wire i gets the smaller and wire j the larger, in order."""

SORT_3: Network = ((0, 1), (1, 2), (0, 1))
SORT_5: Network = ((0, 3), (1, 4), (0, 2), (1, 3), (0, 1), (2, 4), (1, 2), (3, 4), (2, 3))

MEDIAN_5: Network = ((0, 1), (3, 4), (0, 3), (1, 4), (1, 2), (2, 3), (1, 2))
"""Median of five on wire 2."""

MEDIAN_3X3: Network = ((0, 1), (1, 2), (3, 4), (4, 5), (3, 4), (6, 7), (6, 8), (2, 4), (4, 6), (2, 4))
"""Median on wire 4 of nine, where wires k, k+3, k+6 are sorted (Smith 1996)."""

# fmt: off
MEDIAN_5X5: Network = (
    (0, 3), (0, 2), (1, 3), (2, 4), (1, 2), (3, 4), (2, 3), (5, 8), (6, 9), (6, 8), (5, 6), (7, 9), (6, 7),
    (8, 9), (7, 8), (10, 13), (11, 14), (10, 12), (11, 13), (10, 11), (12, 14), (11, 12), (13, 14), (15, 18),
    (16, 19), (15, 17), (16, 18), (15, 16), (17, 19), (16, 17), (17, 18), (20, 23), (21, 24), (20, 22),
    (21, 23), (20, 21), (22, 24), (21, 22), (11, 15), (7, 3), (20, 16), (4, 8), (12, 13), (9, 21), (15, 3),
    (20, 4), (16, 8), (12, 9), (3, 16), (9, 17), (16, 4), (13, 9), (16, 13), (3, 16), (4, 12), (16, 4),
)
# fmt: on
"""Median on wire 4 of 25, where wires k, k+5, k+10, k+15, k+20 are sorted.

Rows sorted, then Batcher's merge exchange over the 13 candidates left, less every comparator that is
idle on all 7776 zero-one inputs whose columns are sorted. 88 minima and maxima are live.
"""

CROSS = ((-1, 0), (0, -1), (0, 0), (0, 1), (1, 0))


def compare(values: list[jax.Array], network: Network) -> list[jax.Array]:
    """The wires after the network; what the caller does not use is never computed.

    Written as selections, each is one instruction: jnp.minimum takes three, to pass on NaN.
    """
    values = list(values)
    for i, j in network:
        a, b = values[i], values[j]
        values[i], values[j] = jnp.where(a < b, a, b), jnp.where(a < b, b, a)
    return values


def median_cross(plane: jax.Array, step: int = 1) -> jax.Array:
    """Median of a pixel and its 4 neighbours `step` px away, borders reflected."""
    return compare(views(pad(plane, step), [(step * dy, step * dx) for dy, dx in CROSS], step), MEDIAN_5)[2]


def median_3x3(plane: jax.Array, step: int = 1) -> jax.Array:
    """Median of 3x3 pixels `step` px apart, borders reflected."""
    return _median_square(plane, 1, step, SORT_3, MEDIAN_3X3)


def median_5x5(plane: jax.Array, step: int = 1) -> jax.Array:
    """Median of 5x5 pixels `step` px apart, borders reflected."""
    return _median_square(plane, 2, step, SORT_5, MEDIAN_5X5)


def _median_square(plane: jax.Array, radius: int, step: int, sort: Network, select: Network) -> jax.Array:
    """Columns are sorted anew for each window that shares them: to store them takes a CPU longer."""
    reach = step * radius
    span = range(-reach, reach + 1, step)
    padded = pad(plane, reach)
    columns = [compare(views(padded, [(dy, dx) for dy in span], reach), sort) for dx in span]
    return compare([column[rank] for rank in range(2 * radius + 1) for column in columns], select)[4]


MEDIANS: dict[str, tuple[Callable[..., jax.Array], tuple[tuple[int, int], ...]]] = {
    "cross": (median_cross, CROSS),
    "3x3": (median_3x3, tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1))),
    "5x5": (median_5x5, tuple((dy, dx) for dy in range(-2, 3) for dx in range(-2, 3))),
}
"""The filter and the offsets of each footprint."""
