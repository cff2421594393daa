"""Demosaicking by normalised convolution, for any colour filter array."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.planes import interleaved
from jaxisp.arrays.stencils import filter_rows_columns
from jaxisp.cfa import Pattern, is_xtrans, masks, rows_of_cell
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register


@register(reach=lambda o: _reach(o["cfa"]), block=rows_of_cell)
def demosaic_normalized_convolution(image: Mosaic, *, cfa: Pattern = "RGGB") -> CameraRGB:
    """Fill in each colour by the mean of its samples nearby, weighted by distance: robust, and blurs.

    `y_c = (k * m_c x) / (k * m_c)` where colour c was not measured; m_c is 1 where it was, `*` convolves.
    k is the product of two tents, [1, 2, 1] on a Bayer pattern, where this is bilinear interpolation, and
    [1, 2, 3, 2, 1] on X-Trans.

    Args:
        image: (H, W) mosaic, any range.
        cfa: the Bayer or X-Trans pattern, row-major from the top-left.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Beyond the borders there are no samples. A
        colour of which none is near, as in frames of one row, is 0.

    Raises:
        ValueError: unknown pattern.

    Gradient: exact (linear).

    Source: Knutsson & Westin 1993, "Normalized and differential convolution".
    """
    distance = _reach(cfa)
    taps = [distance + 1.0 - abs(i) for i in range(-distance, distance + 1)]

    def near(samples: list[jax.Array]) -> jax.Array:
        return filter_rows_columns(interleaved(samples), taps, taps, "constant")

    at = masks((image.shape[0], image.shape[1]), cfa)
    weights = near([mask.astype(image.dtype) for mask in at])
    means = near([jnp.where(mask, image, 0) for mask in at]) / jnp.maximum(weights, 1)
    measured = interleaved([mask.astype(image.dtype) for mask in at])
    return jnp.where(measured > 0, image[..., None], means)


def _reach(cfa: str) -> int:
    """How far from a pixel its result depends on the mosaic [px]."""
    return 2 if is_xtrans(cfa) else 1
