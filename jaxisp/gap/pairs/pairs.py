"""What is compared: light, pictures, and the pixels that count."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes

BORDER = 8  # px that are not compared: filters see mirrored pixels there
INNER = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
"""What of (N, H, W, ...) is compared."""


@dataclasses.dataclass(frozen=True)
class Pairs:
    """What is compared.

    Attributes:
        names: (N,) of the pairs.
        light: (N, H, W) mosaics or (N, H, W, 3) scenes, linear.
        pictures: (N, H, W, 3) encoded, in [0, 1].
        mask: (N, H, W) bool, the pixels that count.
        again: the scenes as the compression of their files leaves them a second time; None where the files
            are not compressed.
    """

    names: tuple[str, ...]
    light: jax.Array
    pictures: np.ndarray
    mask: np.ndarray
    again: jax.Array | None = None

    def relit(self, change: Callable[[jax.Array], jax.Array]) -> "Pairs":
        """Apply a function to the light."""
        again = None if self.again is None else change(self.again)
        return dataclasses.replace(self, light=change(self.light), again=again)

    def take(self, which: Sequence[int]) -> "Pairs":
        """Some of the pairs."""
        index = np.asarray(which)
        names = tuple(self.names[i] for i in index)
        own = self.relit(lambda light: light[index])
        return dataclasses.replace(own, names=names, pictures=self.pictures[index], mask=self.mask[index])


def to_steps(pictures: np.ndarray) -> np.ndarray:
    """(..., 3) RGB in [0, 1] to (..., 3) Y'CbCr in 8-bit steps, float32."""
    return np.asarray(_to_steps(pictures))


@functools.partial(jax.jit, static_argnums=1)
def inner_steps(pictures: jax.Array, count: int) -> jax.Array:
    """(N, h, w, 3) Y'CbCr in 8-bit steps of the first N of (M, H, W, 3) encoded, clipped, without the border:
    as one program, where whole pictures need not be on the host."""
    return _to_steps(jnp.clip(pictures[:count][INNER], 0, 1))


@jax.jit
def _to_steps(pictures: jax.Array) -> jax.Array:
    return 255 * jnp.stack(rgb_to_ycbcr_planes(*jnp.moveaxis(jnp.asarray(pictures, jnp.float32), -1, 0)), -1)


def to_rgb(steps: np.ndarray) -> np.ndarray:
    """(..., 3) Y'CbCr in 8-bit steps to (..., 3) RGB in [0, 1], float32: the inverse of `to_steps`."""
    planes = jnp.moveaxis(jnp.asarray(steps, jnp.float32) / 255, -1, 0)
    return np.asarray(jnp.stack(ycbcr_to_rgb_planes(*planes), -1))
