"""Interleaved images as rows of values: XLA vectorises over the last axis, and 3 channels are too few."""

from collections.abc import Callable

import jax

from jaxisp.arrays.barriers import barrier_on_cpu


def as_rows(image: jax.Array) -> jax.Array:
    """(H, W, C) as (H, W C): XLA's CPU code does not vectorise over a last axis of 3, and takes ten times
    as long."""
    # a barrier, or XLA would move the reshape out of the way
    return barrier_on_cpu(image.reshape(len(image), -1))


def from_rows(rows: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """The inverse of `as_rows`."""
    return barrier_on_cpu(rows).reshape(shape)


def elementwise(fn: Callable[..., jax.Array], *images: jax.Array) -> jax.Array:
    """`fn(*images)`, elementwise in images of one shape, as rows of interleaved pixels."""
    shape = images[0].shape
    if len(shape) < 3:
        return fn(*images)
    return from_rows(fn(*map(as_rows, images)), shape)
