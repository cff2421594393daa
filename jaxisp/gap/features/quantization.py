"""Quantization: the values that the sensor read, as far as a picture still shows them, and their spacing.

A converter of few levels leaves differences of neighbours that are multiples of one step; tone curve and
matrix are undone with those of the fitted base, which need only be about right for that.
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
"""Levels per unit of light at which a comb is looked for: where noise of any kind leaves little. Fewer levels
show at multiples of their number."""
_TABLE = 256
_FEW = 4
_BRIGHT = 110.0  # luma above which shot noise hides a comb


class Quantization(NamedTuple):
    """From a picture back to what the sensor read.

    Attributes:
        light: (K,) linear light, rising, of `encoded` values evenly from 0 to 1.
        inverse: (3, 3) linear sRGB to what the sensor reads of it, gains and all.
        sites: (h, w, 3) 1 where a photosite has the colour.
    """

    light: jax.Array
    inverse: jax.Array
    sites: jax.Array


def quantization(
    shared: Params, cfa: str, gains: tuple[float, float], shape: tuple[int, int], corner: int
) -> Quantization:
    """Of the base's parameters; `corner` is where the frame of `shape` starts in the picture."""
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
    """Where nothing is known of the camera: its picture is taken for what the sensor read."""
    rows, columns = np.indices(shape) % 2
    sites = np.stack([rows * columns, rows ^ columns, (1 - rows) * (1 - columns)], -1)
    return Quantization(jnp.linspace(0, 1, _TABLE), jnp.eye(3), jnp.asarray(sites, jnp.float32))


def quantization_part(
    y: jax.Array, s: jax.Array, weight: jax.Array, seen: Quantization
) -> dict[tuple[str, ...], jax.Array]:
    """The characteristic function of differences of next neighbours of one colour: values by their names.

    Args:
        y: (3, h, w) the picture, s the noise-free one, in Y'CbCr steps.
        weight: (h, w) of flat places.
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
    """(S, V) sums of values (V, ..., w) under each of the weights (S, ..., w).

    As products of matrices: the compiler's own sum takes one number at a time. Under few weights row by row,
    since it is inexact where a product has one row only.
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
    """(S, V) likewise, over the sum of the weights."""
    one = jnp.ones((1, *weights.shape[1:]), weights.dtype)
    return sums(values, weights) / (sums(one, weights) + 1e-3)


def cosine(turns: jax.Array) -> jax.Array:
    """The cosine of an angle in turns, to 1e-6 within a few hundred: the compiler's own takes longer than
    all other statistics together."""
    x = jnp.pi * (turns - jnp.round(turns))
    square = x * x
    sine = jnp.full_like(x, -1 / 39916800)
    for term in (1 / 362880, -1 / 5040, 1 / 120, -1 / 6, 1.0):
        sine = sine * square + term
    sine = sine * x
    return 1 - 2 * sine * sine


def _spectrum(read: jax.Array, weights: jax.Array) -> jax.Array:
    """(K, S) of what the sensor read, by each of the weights (S, h, w)."""
    steps = jnp.stack([jnp.roll(read, -2, axis) - read for axis in (0, 1)])
    both = jnp.stack([weights * jnp.roll(weights, -2, 1 + axis) for axis in (0, 1)], 1)
    return jax.lax.map(lambda f: averages(cosine(f * steps)[None], both)[:, 0], jnp.asarray(FREQUENCIES))
