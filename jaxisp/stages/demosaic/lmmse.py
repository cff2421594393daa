"""Zhang & Wu's directional linear minimum mean square-error estimation."""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import CROSS, DIAGONALS, neighbours, paired_sum, sites

_REACH = 4  # px to either side of the smoothing, and of the window that variances are taken over
_TAPS = np.exp(-(np.arange(_REACH + 1.0) ** 2) / 8)
_SMOOTH = tuple(float(t) for t in _TAPS / (2 * _TAPS.sum() - 1))
_WINDOW = (1 / (2 * _REACH + 1),) * (_REACH + 1)
"""Of the pixel itself, and of the two that are one to four pixels away."""
_LEAST = 1e-7  # variance, of white squared


@register(reach=14, symmetric=True)
def demosaic_lmmse(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Estimate the difference of green from red and blue along rows and along columns, and fuse the two.

    Along a direction the difference y of green and the other colour is interpolated by
    `(left + right) / 2 + (2 x - left_2 - right_2) / 4`; it is the true one, whose mean m is y smoothed by a
    Gaussian of 2 px, and an error. With p the variance of m and r the mean square of y - m over nine
    samples the estimate is `m + p / (p + r) (y - m)`, its error `p r / (p + r)`. Rows and columns are weighed
    by each other's error. Red and blue follow: differences on the opposite colour are means of four diagonal
    ones, those on green sites means of the four beside.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the variances are held constant, exact in all else.

    Source: Zhang & Wu 2005, "Color demosaicking via directional linear minimum mean square-error estimation".
    """
    check_bayer(cfa)
    at = sites(image.shape, cfa)
    (rows, off_rows), (columns, off_columns) = (_direction(at.green, image, h) for h in (True, False))
    difference = (off_columns * rows + off_rows * columns) / (off_rows + off_columns)
    known = materialize(jnp.where(at.green, 0, -difference))  # red or blue less green
    opposite = materialize(0.25 * paired_sum(neighbours(known, DIAGONALS)))
    green = image - known

    def everywhere(own: jax.Array) -> jax.Array:
        on_sites = materialize(jnp.where(own, known, opposite))
        return jnp.where(at.green, 0.25 * paired_sum(neighbours(on_sites, CROSS)), on_sites)

    return interleaved([green + everywhere(at.red), green, green + everywhere(at.blue)])


def _direction(on_green: jax.Array, image: jax.Array, horizontal: bool) -> tuple[jax.Array, jax.Array]:
    """Green less the other colour of the row or column on every site, and the variance of its error."""
    steps = [(0, k) if horizontal else (k, 0) for k in (-2, -1, 1, 2)]
    far, near, near_too, far_too = neighbours(image, steps)
    estimate = 0.5 * (near + near_too) + 0.25 * ((image - far) + (image - far_too))
    rough = materialize(jnp.where(on_green, image - estimate, estimate - image))

    def along(plane: jax.Array, taps: tuple[float, ...]) -> jax.Array:
        # the two of a distance first, so that a mirror image has the same bits
        places = [(0, s * k) if horizontal else (s * k, 0) for k in range(1, _REACH + 1) for s in (-1, 1)]
        found = neighbours(plane, places)
        pairs = [t * (a + b) for t, a, b in zip(taps[1:], found[::2], found[1::2], strict=True)]
        return reduce(jnp.add, pairs, taps[0] * plane)

    smooth = materialize(along(rough, _SMOOTH))
    held, error = lax.stop_gradient((smooth, rough - smooth))
    mean = materialize(along(held, _WINDOW))
    square = materialize(along(held * held, _WINDOW))
    signal = jnp.maximum(square - mean * mean, 0) + _LEAST
    noise = materialize(along(error * error, _WINDOW)) + _LEAST
    gain = signal / (signal + noise)
    return materialize((smooth + gain * (rough - smooth), gain * noise))
