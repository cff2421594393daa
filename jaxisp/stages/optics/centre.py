"""Where pixels are, seen from the centre of the image."""

import jax
import jax.numpy as jnp


def from_centre(shape: tuple[int, ...], dtype: jnp.dtype) -> tuple[jax.Array, jax.Array]:
    """(H, 1) and (1, W): rows and columns from the image centre, px."""
    y = jnp.arange(shape[0], dtype=dtype) - (shape[0] - 1) / 2
    x = jnp.arange(shape[1], dtype=dtype) - (shape[1] - 1) / 2
    return y[:, None], x[None, :]


def radius_squared(shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """(H, W): squared distance from the centre, 1 at the centres of the corner pixels."""
    y, x = from_centre(shape, dtype)
    corner = ((shape[0] - 1) ** 2 + (shape[1] - 1) ** 2) / 4
    return (y * y + x * x) / max(corner, 1)
