"""JAX's rules of promotion where the arithmetic is a library's."""

from collections.abc import Iterator
from contextlib import contextmanager

import jax


@contextmanager
def a_librarys() -> Iterator[None]:
    """JAX's default rules, which optax and flax are written for, whatever rules are set around it.

    optax counts steps in integers and divides by them, and flax averages by the number of pixels: strict
    promotion refuses both. The values are those of the default rules.
    """
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
