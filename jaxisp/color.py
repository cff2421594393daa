"""Colour matrices and luma/chroma, on planes and arrays."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.linear import scaled
from jaxisp.arrays.planes import interleaved, planes

LUMA_601 = (0.299, 0.587, 0.114)
"""Rec. 601 luma weights of R', G', B', as JFIF uses them."""

SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""Linear sRGB to CIE XYZ, D65 (IEC 61966-2-1)."""

XYZ_TO_SRGB = np.linalg.inv(SRGB_TO_XYZ)
"""The exact inverse, so that a round trip is one."""

Planes = tuple[jax.Array, jax.Array, jax.Array]


def luma(r: jax.Array, g: jax.Array, b: jax.Array) -> jax.Array:
    """Rec. 601 luma of three planes."""
    return LUMA_601[0] * r + LUMA_601[1] * g + LUMA_601[2] * b


def rgb_to_ycbcr_planes(r: jax.Array, g: jax.Array, b: jax.Array) -> Planes:
    """Planes of luma and of chroma in [-0.5, 0.5] (JFIF scale, real-valued)."""
    y = luma(r, g, b)
    return y, (b - y) / (2 * (1 - LUMA_601[2])), (r - y) / (2 * (1 - LUMA_601[0]))


def ycbcr_to_rgb_planes(y: jax.Array, cb: jax.Array, cr: jax.Array) -> Planes:
    """The exact inverse of `rgb_to_ycbcr_planes`."""
    b = y + 2 * (1 - LUMA_601[2]) * cb
    r = y + 2 * (1 - LUMA_601[0]) * cr
    return r, (y - LUMA_601[0] * r - LUMA_601[2] * b) / LUMA_601[1], b


def apply_matrix(matrix: jax.Array | np.ndarray, image: jax.Array) -> jax.Array:
    """`matrix @ pixel` for an (H, W, 3) image, written out: an einsum is 24 times slower on a CPU."""
    m = jnp.asarray(matrix, image.dtype)
    r, g, b = planes(image)
    return interleaved([scaled(m[i, 0], r) + scaled(m[i, 1], g) + scaled(m[i, 2], b) for i in range(3)])


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Encoded sRGB, at least 0, in linear light, without a device (IEC 61966-2-1; the stage `srgb_eotf` is
    the one to differentiate)."""
    high = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, high)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_to_linear`."""
    high = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, high)
