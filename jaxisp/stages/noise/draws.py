"""White and filtered normal draws of the shape of an image."""

import jax

from jaxisp.arrays.extents import Extent
from jaxisp.arrays.stencils import filter_rows_columns
from jaxisp.stages.draws import standard_normal


def normal(
    key: jax.Array, like: jax.Array, shape: tuple[int, ...] | None = None, *, extent: Extent | None = None
) -> jax.Array:
    return standard_normal(key, like.shape if shape is None else shape, like.dtype, extent)


def filtered_normal(key: jax.Array, like: jax.Array, taps_y: jax.Array, taps_x: jax.Array) -> jax.Array:
    """Unit white noise correlated with an outer product of taps.

    It is drawn on a larger frame and cropped, so that the borders have the same statistics as the rest.
    """
    ry, rx = len(taps_y) // 2, len(taps_x) // 2
    height, width = like.shape[:2]
    drawn = normal(key, like, (height + 2 * ry, width + 2 * rx))
    return filter_rows_columns(drawn, taps_y, taps_x)[ry : ry + height, rx : rx + width]
