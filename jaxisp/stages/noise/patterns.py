"""Noise of the sensor's own pattern: rows, columns, and pixels that differ."""

import zlib

import jax

from jaxisp.domains import Image
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.noise.draws import normal


def pattern_key(key: jax.Array, sensor: int | None, name: str) -> jax.Array:
    """The key of a fixed pattern: `key`, or that of the sensor with this serial number."""
    if sensor is None:
        return key
    return jax.random.fold_in(jax.random.key(sensor), zlib.crc32(name.encode()) & 0x7FFFFFFF)


@parameters
class RowNoise:
    """Strength."""

    std: Leaf = param(0.005, (0.0, 0.1), "level", doc="standard deviation of the rows' offsets")


@register
def row_noise(params: RowNoise, image: Image, *, key: jax.Array) -> Image:
    """Add one random offset a row, as a rolling readout does.

    `y[i, j] = x[i, j] + std * n[i]`, n standard normal; channels share it.

    Args:
        params: std.
        image: (H, W) or (H, W, 3), any range.
        key: draws the offsets.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: Wei et al. 2020, "A physics-based noise formation model for extreme low-light raw denoising".
    """
    offsets = normal(key, image, (image.shape[0],) + (1,) * (image.ndim - 1))
    return image + params.std.astype(image.dtype) * offsets


@parameters
class ColumnNoise:
    """Strength."""

    std: Leaf = param(0.005, (0.0, 0.1), "level", doc="standard deviation of the columns' offsets")


@register
def column_noise(params: ColumnNoise, image: Image, *, key: jax.Array, sensor: int | None = None) -> Image:
    """Add one offset a column, the fixed pattern of column amplifiers.

    `y[i, j] = x[i, j] + std * n[j]`, n standard normal; channels share it.

    Args:
        params: std.
        image: (H, W) or (H, W, 3), any range.
        key: draws the offsets.
        sensor: a serial number that fixes the pattern whatever the key; None draws it from the key.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: EMVA Standard 1288 (dark signal nonuniformity, column profile); El Gamal & Eltoukhy 2005.
    """
    own = pattern_key(key, sensor, "column_noise")
    offsets = normal(own, image, (1, image.shape[1]) + (1,) * (image.ndim - 2))
    return image + params.std.astype(image.dtype) * offsets


@parameters
class Prnu:
    """Photo-response nonuniformity."""

    std: Leaf = param(0.01, (0.0, 0.1), "1", doc="standard deviation of the pixels' gains")


@register
def prnu(params: Prnu, image: Image, *, key: jax.Array, sensor: int | None = None) -> Image:
    """Give each pixel a gain of its own, a fixed pattern that grows with light.

    `y = x (1 + std * n)`, n standard normal.

    Args:
        params: std.
        image: (H, W) or (H, W, 3) linear light, any range.
        key: draws the gains.
        sensor: a serial number that fixes the pattern whatever the key; None draws it from the key.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: EMVA Standard 1288 (photo response nonuniformity); Lukas, Fridrich & Goljan 2006.
    """
    return image * (1 + params.std.astype(image.dtype) * normal(pattern_key(key, sensor, "prnu"), image))
