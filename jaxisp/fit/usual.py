"""What real cameras are like, which a fit falls back on where its pairs are silent: a Gaussian prior.

Colour matrices are near those of real cameras, tone curves near measured response curves. Lens terms
are near none about the optical centre, filters near the mild start. `python -m experiments.usual_cameras`
derives the numbers.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.colorimetry import primaries_to_xyz
from jaxisp.fit import model
from jaxisp.fit.sharing import CAMERA, Layout
from jaxisp.io.color_space import D65, SRGB_PRIMARIES
from jaxisp.params import bounds_to_line, specs
from jaxisp.pipeline import Params

MATRIX_MEAN = np.asarray([-0.6134, -0.1128, -0.2089, -0.3586, 0.0359, -0.5867])
"""Entries off the diagonal, rows summing to 1, from balanced camera RGB to linear sRGB: 127 cameras, 264
matrices. Of 122 they are the DNG profiles' at their illuminants, of 5 libcamera's at 40 temperatures."""
MATRIX_COVARIANCE = np.asarray(
    [
        [0.0790, -0.0285, 0.0003, 0.0109, -0.0004, 0.0037],
        [-0.0285, 0.0158, 0.0034, -0.0049, 0.0011, 0.0050],
        [0.0003, 0.0034, 0.0105, 0.0016, 0.0026, 0.0151],
        [0.0109, -0.0049, 0.0016, 0.0216, 0.0027, -0.0024],
        [-0.0004, 0.0011, 0.0026, 0.0027, 0.0051, 0.0022],
        [0.0037, 0.0050, 0.0151, -0.0024, 0.0022, 0.0441],
    ]
)
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

P3_PRIMARIES = (0.680, 0.320), (0.265, 0.690), (0.150, 0.060)  # of Display P3: SMPTE RP 431-2

LOOK = 0.1  # standard deviation of what a look adds to each entry of the matrix
CAST = 0.05  # of the logarithm of a row's sum: the stated balance is the one that the camera applied
BRIGHTNESS = 0.7  # of the logarithm of the mean of the rows: an EV from the start
SATURATION = 0.3  # of its logarithm
SHADING = 0.5  # of each coefficient of the vignetting [EV]
LATERAL = 1e-3  # of the scales of red and blue
DISTORTION = 0.02  # of its coefficients
FILTERS = 2.0  # of the others on the real line, from where they start
STEP = 1e-2  # of differences on the real line


def _whitener(covariance: np.ndarray) -> np.ndarray:
    """What makes deviations of that covariance independent, of variance 1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


_OFF_DIAGONAL = ~np.eye(3, dtype=bool)
_CURVE = _whitener(CURVE_DIRECTIONS.T @ CURVE_DIRECTIONS + CURVE_REST * np.eye(len(CURVE_MEAN)))


def _matrix_of(entries: np.ndarray) -> np.ndarray:
    """(3, 3) with rows that sum to 1: grey stays."""
    matrix = np.zeros((3, 3))
    matrix[_OFF_DIAGONAL] = entries
    return matrix + np.diag(1 - matrix.sum(axis=1))


@functools.cache
def entries(stated: bool) -> tuple[np.ndarray, np.ndarray]:
    """Mean (6,) and covariance (6, 6) of the matrix's entries off the diagonal, its rows summing to 1.

    Args:
        stated: whether files say what colour space they are in, so that pictures were read as sRGB. Else
            half the cameras write Display P3.
    """
    mean, covariance = MATRIX_MEAN, MATRIX_COVARIANCE
    if not stated:
        to_p3 = np.linalg.solve(primaries_to_xyz(P3_PRIMARIES, D65), primaries_to_xyz(SRGB_PRIMARIES, D65))

        def in_p3(values: np.ndarray) -> np.ndarray:
            return (to_p3 @ _matrix_of(values))[_OFF_DIAGONAL]

        none = in_p3(np.zeros(6))
        turn = np.stack([in_p3(unit) - none for unit in np.eye(6)], axis=1)
        other = turn @ mean + none
        apart = np.outer(other - mean, other - mean) / 4
        mean = (mean + other) / 2
        covariance = (covariance + turn @ covariance @ turn.T) / 2 + apart
    return mean, covariance + LOOK**2 * np.eye(6)


def usual_matrix() -> np.ndarray:
    """(3, 3) from balanced camera RGB to linear sRGB, the mean of real cameras; grey stays."""
    return _matrix_of(MATRIX_MEAN)


def deviations(params: Params, start: Params, stated: bool = True) -> dict[str, jax.Array]:
    """How far parameters are from those of real cameras, in standard deviations, independent.

    Args:
        params: bounded.
        start: where filters begin.
        stated: see `entries`.

    Returns:
        by the name of what they are about, a row each.
    """
    matrix = jnp.asarray(params["color_matrix"].matrix)
    rows = jnp.log(jnp.maximum(matrix.sum(axis=1), STEEPEST))
    normalised = matrix / jnp.exp(rows)[:, None]
    mean, covariance = entries(stated)
    lateral, bent = params["lateral_chromatic_aberration"], params["geometric_distortion"]
    shading = params["vignetting"]
    return {
        "color_matrix": jnp.matmul(_whitener(covariance), normalised[_OFF_DIAGONAL] - mean),
        "cast": (rows - rows.mean()) / CAST,
        "brightness": rows.mean(keepdims=True) / BRIGHTNESS,
        "curve": jnp.matmul(_CURVE, log_slopes(params) - CURVE_MEAN),
        "saturation": _row(jnp.log(jnp.maximum(params["saturation"].amount, STEEPEST))) / SATURATION,
        "vignetting": jnp.stack([shading.a2, shading.a4, shading.a6]) / SHADING,
        "lateral": jnp.stack([lateral.red_scale - 1, lateral.blue_scale - 1]) / LATERAL,
        "distortion": jnp.stack([bent.k1, bent.k2]) / DISTORTION,
        "filters": _from_start(params, start) / FILTERS,
    }


_FILTERS = ("bilateral", "median", "unsharp_mask", model.SAMPLING)
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "look": (
        ("color_matrix", "cast", "brightness", "curve", "saturation"),
        ("color_matrix", *model.tone().names(), "saturation"),
    ),
    "lens": (("vignetting", "lateral", "distortion"), ("vignetting", *model.LENS)),
    "filters": (("filters",), _FILTERS),
}
"""Kinds of parameters: the names of their deviations, and their stages."""


def _row(number: Any) -> jax.Array:
    return jnp.reshape(number, (1,))


def log_slopes(params: Params) -> jax.Array:
    """(8,) of the whole tone curve between eighths of the sRGB encoding."""
    count = len(CURVE_MEAN)
    levels = jnp.broadcast_to(jnp.arange(count + 1)[:, None, None] / count, (count + 1, 1, 3))
    curve = model.tone()(params, levels)[:, 0, 0]
    return jnp.log(jnp.maximum(jnp.diff(curve) * count, STEEPEST))


def _from_start(params: Params, start: Params) -> jax.Array:
    known = {(name, field): spec for name in _FILTERS for field, spec in specs(type(start[name])).items()}
    low, high = (np.asarray([spec.bounds[end] for spec in known.values()]) for end in (0, 1))
    log = np.asarray([spec.scale == "log" for spec in known.values()])
    values = [[getattr(tree[name], field) for name, field in known] for tree in (params, start)]
    # all at once: one by one, each is a program's step of its own
    there, here = (bounds_to_line(jnp.stack(own), low, high, log) for own in values)
    return there - here


@functools.partial(jax.jit, static_argnums=(0, 1))
def linearised(
    layout: Layout,
    stated: bool,
    fixed: Params,
    start: Params,
    weights: dict[str, Any],
    camera: Any,
    image: Any,
) -> tuple[Any, Any]:
    """Deviations (m,) at two vectors of the fit, each times the root of its kind's weight, and their Jacobian
    (m, columns of both), by central differences: right to 1e-3 and compiled in a third of the time."""

    def rows(vector: jax.Array) -> jax.Array:
        parts = jnp.split(vector, [layout.size(CAMERA)])
        found = deviations(layout.params(fixed, *parts), start, stated)
        weighted = [
            found[name] * jnp.sqrt(weights[kind]) for kind, (names, _) in KINDS.items() for name in names
        ]
        return jnp.concatenate(weighted)

    vector = jnp.concatenate([camera, image])
    steps = STEP * jnp.eye(len(vector), dtype=vector.dtype)
    found = jax.vmap(rows)(jnp.concatenate([vector[None], vector[None] + steps, vector[None] - steps]))
    up, down = jnp.split(found[1:], 2)
    return found[0], (up - down).T / (2 * STEP)
