"""What real cameras are like, which a fit falls back on where its pairs are silent: a Gaussian prior.

Colour matrices are near those of measured sensors, tone curves near measured response curves. Lens terms
are near none about the optical centre, filters near the mild start. `python -m experiments.usual_cameras`
derives the numbers.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit import model
from jaxisp.fit.sharing import CAMERA, Layout
from jaxisp.params import specs, to_unbounded
from jaxisp.pipeline import Params

MATRIX_MEAN = np.asarray([-0.4942, -0.2840, -0.4242, -0.4214, -0.0400, -0.9094])
"""Entries off the diagonal, rows summing to 1, of libcamera's matrices: 5 sensors, 40 colour temperatures."""
MATRIX_COVARIANCE = np.asarray(
    [
        [0.0695, -0.0216, -0.0141, 0.0165, 0.0035, -0.0563],
        [-0.0216, 0.0238, 0.0080, -0.0041, -0.0011, 0.0350],
        [-0.0141, 0.0080, 0.0088, -0.0089, -0.0004, 0.0292],
        [0.0165, -0.0041, -0.0089, 0.0605, 0.0130, -0.0443],
        [0.0035, -0.0011, -0.0004, 0.0130, 0.0064, -0.0060],
        [-0.0563, 0.0350, 0.0292, -0.0443, -0.0060, 0.1353],
    ]
)
SIXTH = 1.5
"""By what a sixth sensor's covariance exceeds that of the five: (n + 1) / (n - 1)."""
CURVE_MEAN = np.asarray([-1.3294, -0.4979, -0.0210, 0.2045, 0.2024, 0.0694, -0.1171, -0.3885])
"""Log slopes of response curves, between eighths of the sRGB encoding: 201 curves of Grossberg and Nayar."""
CURVE_DIRECTIONS = np.asarray(
    [
        [-1.3364, -0.8727, -0.3779, -0.0392, 0.1447, 0.2006, 0.1759, 0.1070],
        [-0.3082, 0.1187, 0.3626, 0.3490, 0.1429, -0.1421, -0.4176, -0.7135],
        [-0.0148, -0.0496, -0.1000, -0.1730, -0.2255, -0.2136, -0.1517, -0.0511],
    ]
)
CURVE_REST = 0.0185  # variance of what the directions leave
STEEPEST = 1e-2  # smallest slope that is told from none

LOOK = 0.1  # standard deviation of what a look adds to each entry of the matrix
CAST = 0.05  # of the logarithm of a row's sum: the stated balance is the one that the camera applied
BRIGHTNESS = 0.7  # of the logarithm of the mean of the rows: an EV from the start
SATURATION = 0.3  # of its logarithm
SHADING = 0.5  # of each coefficient of the vignetting [EV]
LATERAL = 1e-3  # of the scales of red and blue
DISTORTION = 0.02  # of its coefficients
FILTERS = 2.0  # of the others on the real line, from where they start


def _whitener(covariance: np.ndarray) -> np.ndarray:
    """What makes deviations of that covariance independent, of variance 1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


_MATRIX = _whitener(SIXTH * MATRIX_COVARIANCE + LOOK**2 * np.eye(len(MATRIX_MEAN)))
_CURVE = _whitener(CURVE_DIRECTIONS.T @ CURVE_DIRECTIONS + CURVE_REST * np.eye(len(CURVE_MEAN)))


def usual_matrix() -> np.ndarray:
    """(3, 3) from balanced camera RGB to linear sRGB, the mean of real cameras; grey stays."""
    matrix = np.zeros((3, 3))
    matrix[~np.eye(3, dtype=bool)] = MATRIX_MEAN
    return matrix + np.diag(1 - matrix.sum(axis=1))


def deviations(params: Params, start: Params) -> dict[str, jax.Array]:
    """How far parameters are from those of real cameras, in standard deviations, independent.

    Args:
        params: bounded.
        start: where filters begin.

    Returns:
        by the name of what they are about, a row each.
    """
    matrix = jnp.asarray(params["color_matrix"].matrix)
    rows = jnp.log(jnp.maximum(matrix.sum(axis=1), STEEPEST))
    normalised = matrix / jnp.exp(rows)[:, None]
    lateral, bent = params["lateral_chromatic_aberration"], params["geometric_distortion"]
    shading = params["vignetting"]
    return {
        "color_matrix": jnp.matmul(_MATRIX, normalised[~np.eye(3, dtype=bool)] - MATRIX_MEAN),
        "cast": (rows - rows.mean()) / CAST,
        "brightness": rows.mean(keepdims=True) / BRIGHTNESS,
        "curve": jnp.matmul(_CURVE, log_slopes(params) - CURVE_MEAN),
        "saturation": _row(jnp.log(jnp.maximum(params["saturation"].amount, STEEPEST))) / SATURATION,
        "vignetting": jnp.stack([shading.a2, shading.a4, shading.a6]) / SHADING,
        "lateral": jnp.stack([lateral.red_scale - 1, lateral.blue_scale - 1]) / LATERAL,
        "distortion": jnp.stack([bent.k1, bent.k2]) / DISTORTION,
        "filters": _from_start(params, start) / FILTERS,
    }


def _row(number: Any) -> jax.Array:
    return jnp.reshape(number, (1,))


def log_slopes(params: Params) -> jax.Array:
    """(8,) of the whole tone curve between eighths of the sRGB encoding."""
    count = len(CURVE_MEAN)
    levels = jnp.broadcast_to(jnp.arange(count + 1)[:, None, None] / count, (count + 1, 1, 3))
    curve = model.tone()(params, levels)[:, 0, 0]
    return jnp.log(jnp.maximum(jnp.diff(curve) * count, STEEPEST))


_FILTERS = ("bilateral", "median", "unsharp_mask", model.SAMPLING)


def _from_start(params: Params, start: Params) -> jax.Array:
    there, here = (to_unbounded({name: tree[name] for name in _FILTERS}) for tree in (params, start))
    return jnp.stack(
        [
            getattr(there[name], field) - getattr(here[name], field)
            for name in _FILTERS
            for field in specs(type(there[name]))
        ]
    )


@functools.partial(jax.jit, static_argnums=0)
def linearised(layout: Layout, fixed: Params, start: Params, camera: Any, image: Any) -> tuple[Any, Any]:
    """Deviations (m,) at two vectors of the fit, and their Jacobian (m, columns of both)."""

    def rows(vector: jax.Array) -> jax.Array:
        parts = jnp.split(vector, [layout.size(CAMERA)])
        return jnp.concatenate(list(deviations(layout.params(fixed, *parts), start).values()))

    vector = jnp.concatenate([camera, image])
    return rows(vector), jax.jacfwd(rows)(vector)
