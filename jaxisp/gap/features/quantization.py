"""Quantization of sensor values, estimated from the finished picture.

An ADC with few levels leaves differences between neighbours that are multiples of one step. The tone curve
and the colour matrix of the fitted base are inverted first. They only need to be approximately right.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp import cfa as bayer
from jaxisp.arrays.barriers import materialize
from jaxisp.color import ycbcr_to_rgb_planes
from jaxisp.gap.simulator.model import MIXING
from jaxisp.pipeline import Params, run, stage

FREQUENCIES = tuple(float(f) for f in np.geomspace(25, 200, 16))
"""Levels per unit of linear light that are tested for a comb. Noise leaves little at these frequencies. An
ADC with fewer levels shows at multiples of its number of levels."""
_TABLE = 256
_FEW = 4
_BRIGHT = 110.0  # luma above which shot noise hides a comb


class Quantization(NamedTuple):
    """The map from an encoded picture back to sensor values.

    Attributes:
        light: (K,) linear light, increasing, of K encoded values spaced evenly from 0 to 1.
        inverse: (3, 3) matrix from linear sRGB to sensor values, white-balance gains included.
        sites: (h, w, 3) 1 where the photosite has this colour, else 0.
    """

    light: jax.Array
    inverse: jax.Array
    sites: jax.Array


def quantization(
    shared: Params, cfa: str, gains: tuple[float, float], shape: tuple[int, int], corner: int
) -> Quantization:
    """Build the map from the parameters of a fitted base.

    Args:
        shared: parameters of the base.
        cfa: Bayer pattern, such as "RGGB".
        gains: white-balance gains of red and blue, with green at 1.
        shape: (h, w) of the measured frame.
        corner: row and column of the picture where that frame starts.
    """
    linear = np.linspace(0, 1.3, 2048, dtype=np.float32)
    curve = stage("spline_curve", name="tone_curve")
    grey = np.broadcast_to(linear[None, :, None], (1, len(linear), 3))
    oetf = stage("srgb_oetf")
    curved = run(curve, {"tone_curve": shared["tone_curve"]}, run(oetf, oetf.init(), grey))
    encoded = np.asarray(curved)[0, :, 0]
    encoded = np.maximum.accumulate(encoded) + 1e-6 * np.arange(len(linear))
    light = np.interp(np.linspace(0, 1, _TABLE), encoded, linear)
    matrix = np.asarray(shared["color_matrix"].matrix @ shared[MIXING].matrix, float)
    inverse = np.linalg.pinv(matrix, rcond=0.02) / np.array([gains[0], 1.0, gains[1]])[:, None]
    whole = (shape[0] + corner, shape[1] + corner)
    sites = np.stack([np.asarray(m, np.float32) for m in bayer.masks(whole, cfa)], -1)[corner:, corner:]
    return Quantization(*(jnp.asarray(a, jnp.float32) for a in (light, inverse, sites)))


def unknown_quantization(shape: tuple[int, int]) -> Quantization:
    """Default for an unknown camera: sensor values equal the picture. `shape` is (h, w)."""
    rows, columns = np.indices(shape) % 2
    sites = np.stack([rows * columns, rows ^ columns, (1 - rows) * (1 - columns)], -1)
    return Quantization(jnp.linspace(0, 1, _TABLE), jnp.eye(3), jnp.asarray(sites, jnp.float32))


def quantization_part(
    y: jax.Array, s: jax.Array, weight: jax.Array, seen: Quantization
) -> dict[tuple[str, ...], jax.Array]:
    """Characteristic function of the differences between nearest photosites of one colour.

    Args:
        y: (3, h, w) the picture, Y'CbCr in 8-bit steps.
        s: (3, h, w) the noise-free picture, likewise.
        weight: (h, w) flatness, see `noise.flatness`.
        seen: the map from the picture back to sensor values.

    Returns:
        values (K,) by their names.
    """
    rgb = jnp.stack(ycbcr_to_rgb_planes(*y / 255))
    at = jnp.clip(rgb, 0, 1) * (_TABLE - 1)
    low = jnp.clip(at.astype(jnp.int32), 0, _TABLE - 2)
    light = seen.light[low] + (at - low) * jnp.diff(seen.light)[low]
    of_site = jnp.einsum("hwi,ic->chw", seen.sites, seen.inverse, precision="highest")
    dark = weight * jax.nn.sigmoid((_BRIGHT - s[0]) / 8)
    values = _spectrum(materialize((of_site * light).sum(0)), materialize(jnp.stack([dark, weight - dark])))
    names = (f"code intensity {name}{k:02d}" for k in range(len(FREQUENCIES)) for name in ("dark", "light"))
    return {tuple(names): values.ravel()}


def sums(values: jax.Array, weights: jax.Array) -> jax.Array:
    """Weighted sums (S, V) of values (V, ..., w) under weights (S, ..., w).

    Matrix products are used because XLA's own sum on CPUs is scalar. With few weights, the sums are taken row
    by row: a product with only one row is inexact.
    """
    if len(weights) > _FEW:
        flat = (a.reshape(len(a), -1) for a in (weights, materialize(values)))
        return jnp.einsum("sp,vp->sv", *flat, precision="highest")
    if len(weights) > 1:
        values = materialize(values)
    one = jnp.ones(values.shape[-1], values.dtype)
    rows = [jnp.matmul((values * own).reshape(-1, len(one)), one, precision="highest") for own in weights]
    return jnp.stack([row.reshape(len(values), -1).sum(1) for row in rows])


def averages(values: jax.Array, weights: jax.Array) -> jax.Array:
    """Weighted means (S, V) of values (V, ..., w) under weights (S, ..., w)."""
    one = jnp.ones((1, *weights.shape[1:]), weights.dtype)
    return sums(values, weights) / (sums(one, weights) + 1e-3)


def cosine(turns: jax.Array) -> jax.Array:
    """Cosine of an angle in turns; the error is 1e-6 for angles up to a few hundred turns.

    XLA's own cosine takes longer than all other statistics together.
    """
    x = jnp.pi * (turns - jnp.round(turns))
    square = x * x
    sine = jnp.full_like(x, -1 / 39916800)
    for term in (1 / 362880, -1 / 5040, 1 / 120, -1 / 6, 1.0):
        sine = sine * square + term
    sine = sine * x
    return 1 - 2 * sine * sine


def _spectrum(read: jax.Array, weights: jax.Array) -> jax.Array:
    """Characteristic function (K, S) at `FREQUENCIES` of sensor values (h, w), under weights (S, h, w)."""
    steps = jnp.stack([jnp.roll(read, -2, axis) - read for axis in (0, 1)])
    both = jnp.stack([weights * jnp.roll(weights, -2, 1 + axis) for axis in (0, 1)], 1)
    return jax.lax.map(lambda f: averages(cosine(f * steps)[None], both)[:, 0], jnp.asarray(FREQUENCIES))
