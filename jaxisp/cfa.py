"""Colour filter arrays: Bayer patterns, row-major from the top-left."""

from typing import Annotated

import jax
import jax.numpy as jnp

from jaxisp.options import one_of

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
Pattern = Annotated[str, one_of(*PATTERNS)]
"""A pattern as a static option."""


def check_cfa(cfa: str) -> str:
    """Return `cfa`; raise ValueError where it is not one of `PATTERNS`."""
    if cfa not in PATTERNS:
        raise ValueError(f"cfa {cfa!r} is not one of {', '.join(PATTERNS)}")
    return cfa


def site(cfa: str, color: str) -> tuple[int, int]:
    """(row, column) in the 2x2 cell of "R" or "B"; for "G" the one in the first row."""
    index = check_cfa(cfa).index(color)
    return divmod(index, 2)


def masks(shape: tuple[int, int], cfa: str) -> tuple[jax.Array, jax.Array, jax.Array]:
    """(R, G, B) boolean (H, W) masks, made of iotas so that they fuse into what uses them."""
    rows = jax.lax.broadcasted_iota(jnp.int32, shape, 0) % 2
    columns = jax.lax.broadcasted_iota(jnp.int32, shape, 1) % 2

    def of(color: str) -> jax.Array:
        row, column = site(cfa, color)
        return (rows == row) & (columns == column)

    red, blue = of("R"), of("B")
    return red, ~(red | blue), blue


def select(
    mask_rgb: tuple[jax.Array, jax.Array, jax.Array], r: jax.Array, g: jax.Array, b: jax.Array
) -> jax.Array:
    """The (H, W) mosaic that takes r, g, b where their masks are set."""
    red, green, _ = mask_rgb
    return jnp.where(red, r, jnp.where(green, g, b))


def shifted(cfa: str, rows: int, columns: int) -> str:
    """The pattern seen after cropping that many rows and columns off the top and left."""
    cell = check_cfa(cfa)
    return "".join(cell[2 * ((y + rows) % 2) + (x + columns) % 2] for y in (0, 1) for x in (0, 1))
