"""Interleaved images as planes, and planes as interleaved images."""

from collections.abc import Callable, Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.linear import linear_call


def planes(image: jax.Array) -> tuple[jax.Array, ...]:
    """The channels of (H, W, C) as a tuple of (H, W)."""
    # split, as the transpose of slices would pad each of them
    last = image.ndim - 1
    return tuple(lax.squeeze(p, (last,)) for p in lax.split(image, (1,) * image.shape[-1], axis=last))


def interleaved(channels: Sequence[jax.Array]) -> jax.Array:
    """(H, W, C) of C planes of (H, W): the inverse of `planes`.

    On a CPU each value is selected from those of all channels: XLA vectorises that, and not what joins them
    along a last axis of 3, which takes twice as long.
    """
    return linear_call(lambda _, c: _interleaved(c), lambda _, image: planes(image), (), tuple(channels))


def _interleaved(channels: tuple[jax.Array, ...]) -> jax.Array:
    return lax.platform_dependent(channels, cpu=_selected, default=lambda c: jnp.stack(c, axis=-1))


def _selected(channels: tuple[jax.Array, ...]) -> jax.Array:
    shape = (*channels[0].shape, len(channels))
    index = lax.broadcasted_iota(jnp.int32, shape, len(shape) - 1)
    *others, last = (jnp.broadcast_to(c[..., None], shape) for c in channels)
    return reduce(lambda rest, i: jnp.where(index == i, others[i], rest), range(len(others)), last)


def per_plane(fn: Callable[[jax.Array], jax.Array], image: jax.Array) -> jax.Array:
    """Apply a function of an (H, W) plane to a mosaic, or to each channel of an (H, W, C) image.

    The channels go first: neighbourhood code on an interleaved array is 8x slower.
    """
    if image.ndim == 2:
        return fn(image)
    return interleaved(tuple(jax.vmap(fn)(jnp.moveaxis(image, -1, 0))))
