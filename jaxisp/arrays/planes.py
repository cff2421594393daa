"""Interleaved images as planes, and planes as interleaved images."""

from collections.abc import Callable, Sequence
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.platforms import by_platform


@jax.jit  # traced and transformed once for a shape, as `interleaved`
def planes(image: jax.Array) -> tuple[jax.Array, ...]:
    """The channels of (H, W, C) as a tuple of (H, W).

    The transpose stores the planes, and then joins them: by itself XLA's CPU code works each out within the
    loop that joins them, which takes long to compile and does not vectorise.
    """
    return linear_call(lambda _, x: _split(x), lambda _, p: interleaved(materialize(p)), None, image)


def _split(image: jax.Array) -> tuple[jax.Array, ...]:
    last = image.ndim - 1
    return tuple(lax.squeeze(p, (last,)) for p in lax.split(image, (1,) * image.shape[-1], axis=last))


@jax.jit
def interleaved(channels: Sequence[jax.Array]) -> jax.Array:
    """(H, W, C) of C planes of (H, W), stored: the inverse of `planes`.

    On a CPU each value is selected from those of all channels: XLA vectorises that, and not what joins them
    along a last axis of 3, which takes two and a half times as long. It has to be stored, as it would not
    vectorise either what is reshaped after.
    """

    def joined(_: None, channels: tuple[jax.Array, ...]) -> jax.Array:
        return by_platform(
            channels, cpu=lambda c: materialize(_selected(c)), default=lambda c: jnp.stack(c, axis=-1)
        )

    return linear_call(joined, lambda _, image: planes(image), None, tuple(channels))


def _selected(channels: tuple[jax.Array, ...]) -> jax.Array:
    count = len(channels)
    shape = (*channels[0].shape, count)
    index = lax.broadcasted_iota(jnp.int32, shape, len(shape) - 1)

    def alone(i: int) -> jax.Array:
        # padded and not broadcast, which would have what is expensive to compute stored before
        own = channels[i][..., None]
        return lax.pad(own, np.zeros((), own.dtype), [(0, 0, 0)] * (own.ndim - 1) + [(i, count - 1 - i, 0)])

    return reduce(lambda rest, i: jnp.where(index == i, alone(i), rest), range(count - 1), alone(count - 1))


def per_plane(fn: Callable[[jax.Array], jax.Array], image: jax.Array) -> jax.Array:
    """Apply a function of an (H, W) plane to a mosaic, or to each channel of an (H, W, C) image.

    The channels go first: neighbourhood code on an interleaved array is 8x slower.
    """
    if image.ndim == 2:
        return fn(image)
    return interleaved(tuple(jax.vmap(fn)(jnp.moveaxis(image, -1, 0))))
