"""Illuminants and primaries: the Planckian locus, ROMM primaries."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.safe_math import safe_sqrt
from jaxisp.color import SRGB_TO_XYZ, XYZ_TO_SRGB

D65_TEMPERATURE, D65_TINT = 6504.0, 0.0032
"""Correlated colour temperature [K] and Duv of D65, the white of sRGB."""

# Polynomials in (1000 K / T - 0.3) / 0.225, lowest power first, fitted by least squares to the chromaticity
# of Planck's law (c2 = 1.4388e-2 m K) under the CIE 1931 2-degree observer at 1 nm, for 1900 to 13000 K.
# They are within 2e-8 of it, in single precision within 4e-8; Krystek's (1985) rational fit within 1e-4.
_LOCUS_CENTRE, _LOCUS_HALF_WIDTH = 0.3, 0.225
_LOCUS_U = (
    0.240096709, 0.0696075208, 0.00826266676, -0.00633164679, 0.00185745044, -0.000287816983,
    -2.08786273e-05, 0.000119011979, -0.000262500675, 0.000171399387, 3.68908153e-05, -4.91892572e-05,
)  # fmt: skip
_LOCUS_V = (
    0.343076735, 0.033730131, -0.0229352019, 0.00588383982, 0.000946255261, -0.00170990124,
    0.00102660065, -0.000603775213, 0.000448371396, -8.94181487e-05, -0.000200350877, 0.000111023872,
)  # fmt: skip


def _polynomial(coefficients: tuple[float, ...], x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Value and derivative by Horner's rule."""
    value, slope = jnp.zeros_like(x), jnp.zeros_like(x)
    for c in reversed(coefficients):
        slope = slope * x + value
        value = value * x + c
    return value, slope


def planckian_uv(temperature: jax.Array, tint: Any = 0.0) -> tuple[jax.Array, jax.Array]:
    """CIE 1960 (u, v) at a distance of `tint` from the Planckian locus, along its normal.

    Args:
        temperature: correlated colour temperature, 1900 to 13000 K.
        tint: Duv; positive is above the locus (greenish), negative below (pinkish).

    Gradient: exact, to both.
    """
    x = (1000.0 / jnp.asarray(temperature) - _LOCUS_CENTRE) / _LOCUS_HALF_WIDTH
    u, du = _polynomial(_LOCUS_U, x)
    v, dv = _polynomial(_LOCUS_V, x)
    length = safe_sqrt(du * du + dv * dv)
    return u - tint * dv / length, v + tint * du / length


def illuminant_rgb(temperature: jax.Array, tint: Any = 0.0) -> jax.Array:
    """(3,) linear sRGB of the illuminant of that colour with luminance 1; channels may be negative."""
    u, v = planckian_uv(temperature, tint)
    xyz = (1.5 * u / v, jnp.ones_like(u), (2.0 - 0.5 * u) / v - 5.0)
    m = jnp.asarray(XYZ_TO_SRGB, u.dtype)
    return jnp.stack([m[i, 0] * xyz[0] + m[i, 1] * xyz[1] + m[i, 2] * xyz[2] for i in range(3)])


def primaries_to_xyz(primaries: Any, white: Any) -> np.ndarray:
    """The 3x3 matrix from linear RGB to XYZ.

    Args:
        primaries: (3, 2) chromaticities (x, y) of R, G, B.
        white: (x, y) of RGB = (1, 1, 1), whose Y becomes 1.

    Source: SMPTE RP 177-1993.
    """
    columns = np.array([_xy_to_xyz(p) for p in primaries]).T
    return columns * np.linalg.solve(columns, _xy_to_xyz(white))


def bradford(white_from: Any, white_to: Any) -> np.ndarray:
    """The 3x3 matrix that adapts XYZ under one white (XYZ) to another.

    Source: Lam 1985; ICC.1:2022, annex E.
    """
    cone = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    scale = (cone @ np.asarray(white_to)) / (cone @ np.asarray(white_from))
    return np.linalg.inv(cone) @ (scale[:, None] * cone)


def _xy_to_xyz(xy: Any) -> np.ndarray:
    x, y = xy
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _prophoto_to_srgb() -> np.ndarray:
    d50 = (0.3457, 0.3585)
    romm = primaries_to_xyz(((0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001)), d50)
    return XYZ_TO_SRGB @ bradford(_xy_to_xyz(d50), SRGB_TO_XYZ.sum(axis=1)) @ romm


PROPHOTO_TO_SRGB = _prophoto_to_srgb()
"""Linear ROMM RGB (D50) to linear sRGB (D65), Bradford-adapted: white goes to white."""

SRGB_TO_PROPHOTO = np.linalg.inv(PROPHOTO_TO_SRGB)
"""The exact inverse."""
