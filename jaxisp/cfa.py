"""Colour filter arrays: the Bayer patterns and X-Trans, row-major from the top-left."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.options import Limit, check_option

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""The Bayer patterns."""
XTRANS = "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"
"""X-Trans in one of its 18 phases: 6 x 6 filters, with a green that has no green beside it at (1, 1)."""


_LETTERS = f"36 letters as {XTRANS}"


def size(cfa: str) -> int:
    """Rows and columns of the cell that repeats."""
    return math.isqrt(len(cfa))


def rows_of_cell(options: Mapping[str, Any]) -> int:
    """The block of a stage that goes by its `cfa`."""
    return size(options["cfa"])


def shifted(cfa: str, rows: int, columns: int) -> str:
    """The pattern seen after cropping that many rows and columns off the top and left."""
    n = size(check_cfa(cfa))
    return "".join(cfa[n * ((y + rows) % n) + (x + columns) % n] for y in range(n) for x in range(n))


def is_xtrans(cfa: str) -> bool:
    """Whether it is X-Trans, in any phase."""
    return cfa in _PHASES


def check_cfa(cfa: str) -> str:
    """Return `cfa`; raise ValueError where it is neither one of `PATTERNS` nor X-Trans."""
    check_option("cfa", Pattern, cfa)
    return cfa


def check_bayer(cfa: str) -> str:
    """Return `cfa`; raise ValueError where it is not one of `PATTERNS`."""
    check_option("cfa", Bayer, cfa)
    return cfa


def check_xtrans(cfa: str) -> str:
    """Return `cfa`; raise ValueError where it is not X-Trans."""
    check_option("cfa", XTrans, cfa)
    return cfa


def site(cfa: str, color: str) -> tuple[int, int]:
    """(row, column) in the 2x2 cell of "R" or "B"; for "G" the one in the first row."""
    index = check_bayer(cfa).index(color)
    return divmod(index, 2)


def solitary_green(cfa: str) -> tuple[int, int]:
    """(row, column), both below 3, of the first green of X-Trans that has no green beside it."""
    cell = np.array(list(check_xtrans(cfa))).reshape(6, 6) == "G"
    beside = [np.roll(cell, step, axis) for axis in (0, 1) for step in (-1, 1)]
    row, column = np.argwhere(cell & ~np.any(beside, axis=0))[0]
    return int(row) % 3, int(column) % 3


def masks(shape: tuple[int, int], cfa: str) -> tuple[jax.Array, jax.Array, jax.Array]:
    """(R, G, B) boolean (H, W) masks, made of iotas so that they fuse into what uses them."""
    n = size(check_cfa(cfa))
    rows = jax.lax.broadcasted_iota(jnp.int32, shape, 0) % n
    columns = jax.lax.broadcasted_iota(jnp.int32, shape, 1) % n

    def of(color: str) -> jax.Array:
        if n == 2:
            row, column = site(cfa, color)
            return (rows == row) & (columns == column)
        cell = np.array(list(cfa)).reshape(n, n) == color
        bits = jnp.asarray(cell @ (1 << np.arange(n)), jnp.int32)  # of a row: one a column
        return (bits[rows[:, :1]] >> columns) & 1 == 1

    red, blue = of("R"), of("B")
    return red, ~(red | blue), blue


def select(
    mask_rgb: tuple[jax.Array, jax.Array, jax.Array], r: jax.Array, g: jax.Array, b: jax.Array
) -> jax.Array:
    """The (H, W) mosaic that takes r, g, b where their masks are set."""
    red, green, _ = mask_rgb
    return jnp.where(red, r, jnp.where(green, g, b))


def _phases() -> tuple[str, ...]:
    cell = np.array(list(XTRANS)).reshape(6, 6)
    return tuple("".join(np.roll(cell, by, (0, 1)).ravel()) for by in np.ndindex(6, 3))


_PHASES = _phases()
_BAYER = f"one of {', '.join(PATTERNS)}"
_FOR_XTRANS = "demosaic_markesteijn and demosaic_normalized_convolution demosaick X-Trans"

Pattern = Annotated[
    str,
    Limit(f"{_BAYER}, or X-Trans ({_LETTERS})", lambda cfa: cfa in PATTERNS or is_xtrans(cfa), PATTERNS),
]
"""A pattern as a static option."""
Bayer = Annotated[str, Limit(f"{_BAYER} ({_FOR_XTRANS})", lambda cfa: cfa in PATTERNS, PATTERNS)]
"""A static option that takes Bayer patterns alone."""
XTrans = Annotated[str, Limit(f"X-Trans ({_LETTERS}; demosaic_ahd and others demosaick Bayer)", is_xtrans)]
"""A static option that takes X-Trans alone."""
