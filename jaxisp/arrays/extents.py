"""A picture in a larger frame: one program for pictures of many sizes, each as it would be alone.

The picture begins at the frame's top left. What is beyond it is made anew, from the picture, before each
stage that reads there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

Size = tuple[int, int]
"""Rows and columns [px]."""
LEAST = 5
"""px: of a picture in a larger frame. JPEG does not interpolate the chroma of narrower ones."""


class Extent(NamedTuple):
    """The rows and columns that the picture has; int32, traced."""

    height: jax.Array
    width: jax.Array

    def grown(self, by: int) -> "Extent":
        return Extent(self.height + by, self.width + by)

    def over(self, step: tuple[int, int]) -> "Extent":
        """Of samples that stand for `step` pixels each, those at the end for fewer."""
        return Extent(*(-(-n // s) for n, s in zip(self, step)))


def whole(frame: Size) -> Extent:
    """Of a picture that fills its frame, behind a barrier: what hangs on constants XLA works out itself, with
    other functions than a program has."""
    return Extent(*lax.optimization_barrier(tuple(map(jnp.int32, frame))))


def has_room(size: Size, frame: Size, margin: int) -> bool:
    """Whether a picture comes out of a frame as it would alone, by the margin of what it goes through."""
    return min(size) >= LEAST and all(f == s or f >= s + margin for s, f in zip(size, frame))


def mirrored(image: jax.Array, extent: Extent) -> jax.Array:
    """An (H, W) or (H, W, C) frame with the picture's mirror image beyond it, the edge not repeated."""
    for axis, size in enumerate(extent):
        period = jnp.maximum(2 * (size - 1), 1)
        place = lax.iota(jnp.int32, image.shape[axis]) % period
        image = jnp.take(image, jnp.minimum(place, period - place), axis, mode="clip")
    return lax.optimization_barrier(image)


def clamped(plane: jax.Array, extent: Extent) -> jax.Array:
    """An (H, W) frame with the picture's last row and column repeated beyond it."""
    for axis, size in enumerate(extent):
        plane = _clamped(plane, size, axis)
    return lax.optimization_barrier(plane)


def clamped_rows(plane: jax.Array, height: jax.Array) -> jax.Array:
    """An (H, W) frame with the last row of a picture of all its columns repeated beyond it."""
    return lax.optimization_barrier(_clamped(plane, height, 0))


def _clamped(plane: jax.Array, size: jax.Array, axis: int) -> jax.Array:
    place = jnp.minimum(lax.iota(jnp.int32, plane.shape[axis]), size - 1)
    return jnp.take(plane, place, axis, mode="clip")
