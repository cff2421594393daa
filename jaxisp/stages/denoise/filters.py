"""What the neighbourhood filters share: reflected borders, forwards and in adjoints."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp import windows


def reflect(plane: jax.Array, radius: int) -> jax.Array:
    """Pad an (H, W) plane by reflection without repeating the edge (`cv2.BORDER_REFLECT_101`).

    An axis of one pixel repeats it; any size works.
    """
    if min(plane.shape) > 1:
        return windows.pad(plane, radius)
    for axis, n in enumerate(plane.shape):
        width = [(radius, radius) if a == axis else (0, 0) for a in range(2)]
        plane = jnp.pad(plane, width, mode="reflect" if n > 1 else "edge")
    return lax.optimization_barrier(plane)


def edge_counts(shape: tuple[int, ...], dtype: jnp.dtype) -> jax.Array:
    """(H, W): 2 on the first and last row, times 2 on the first and last column, else 1.

    It turns the adjoint of a reflected window into a reflected window. With `out_p = sum_q f(q, p)`
    over the window of p, an interior q meets p directly and through its own mirror image, which is as
    often as q meets p and the mirror image of p. A pixel on the mirror line has no second image, so
    `sum_p f(q, p) = sum_p f(q, p) counts_p / counts_q` over the reflected window of q.
    """
    rows, columns = (np.ones(n) for n in shape)
    for line in (rows, columns):
        if len(line) > 1:
            line[[0, -1]] = 2
    return jnp.asarray(rows[:, None], dtype) * jnp.asarray(columns[None, :], dtype)
