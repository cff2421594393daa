"""Looks that a phone lays over its picture: a free tone curve, colour by hue, tone by neighbourhood."""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import fused_sum, linear_call, sums
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.safe_math import clip, safe_sqrt
from jaxisp.arrays.shares import weighted
from jaxisp.color import luma, rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import RGB, EncodedRGB
from jaxisp.options import Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

SECTORS = 16
_DARK = 0.05  # below this maximum of the channels saturation, which is mostly noise there, fades
_DARKEST, _EDGE = 0.004, 1.0  # of linear light; stops squared of variance above which an edge is kept
_STEP = 0.01  # lightness squared, likewise
_LEVELS, _STRIDE = 256, 5  # of a histogram, and how many of them a table of its sums is linear between
_EXACT = lax.Precision.HIGHEST
_REDUCED = 4  # local means are taken of blocks of 4x4: they are wide, and 16 times cheaper there


@parameters
class SplineCurve:
    """Weights of the cubic B-splines that are added to the identity."""

    offsets: Leaf = param(
        (0.0,) * 12, (-0.6, 0.6), "level", any_length=True, doc="weight of each spline, from black to white"
    )


@register(reach=0)
def spline_curve(params: SplineCurve, image: RGB) -> RGB:
    """A smooth tone curve, the same for every channel, linear in its parameters.

    `y = x + sum_i offset_i B((N - 1) x - i)`, i = 0..N-1, B the uniform cubic B-spline; x is taken as
    0 or 1 outside [0, 1] inside the sum. Nothing forces it to rise.

    Args:
        params: N >= 2 offsets; all 0 leave the image as it is.
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image.

    Gradient: exact.

    Source: de Boor 1978, "A Practical Guide to Splines".
    """
    at = (params.offsets.shape[0] - 1) * clip(image, 0, 1)
    return image + _spline(params.offsets, at)


@jax.custom_jvp
def _spline(offsets: jax.Array, at: jax.Array) -> jax.Array:
    """The splines' sum at places from 0 to N - 1."""
    return _by_pieces(offsets, at)


def _spline_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (offsets, at), (d_offsets, d_at) = primals, tangents
    y = _spline(offsets, at)
    change = jnp.zeros_like(y)
    if not isinstance(d_at, SymbolicZero):
        change = jax.jvp(partial(_by_pieces, offsets), (at,), (d_at,))[1]
    if not isinstance(d_offsets, SymbolicZero):
        collected = partial(_collected, len(offsets))
        change += linear_call(lambda a, d: _by_pieces(d, a), collected, at, d_offsets)
    return y, change


_spline.defjvp(_spline_jvp, symbolic_zeros=True)


def _collected(count: int, at: jax.Array, cotangent: jax.Array) -> jax.Array:
    """What each of the weights gets."""

    def shares(at: jax.Array, cotangent: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(cotangent * _b_spline(at - i) for i in range(-1, count + 1))

    first, *inner, last = (s.sum() for s in sums(shares, at, cotangent))
    # the two splines whose centres lie outside go on with the first and last weight
    inner[0] += first
    inner[-1] += last
    return jnp.stack(inner)


def _b_spline(u: jax.Array) -> jax.Array:
    """The uniform cubic B-spline, 2/3 at 0 and 0 from 2 on."""
    near, far = (jnp.maximum(n - jnp.abs(u), 0) for n in (1, 2))
    return (far * far * far - 4 * near * near * near) / 6


def _by_pieces(offsets: jax.Array, at: jax.Array) -> jax.Array:
    """One cubic between two centres, found by comparisons: a sixth of the time of the sum."""
    weights = jnp.pad(offsets, 1, mode="edge")
    w, x, y, z = (weights[k : len(weights) - 3 + k] for k in range(4))
    cubics = jnp.stack(((w + 4 * x + y) / 6, (y - w) / 2, (w - 2 * x + y) / 2, (z - w + 3 * (x - y)) / 6), 1)
    start, own = jnp.zeros_like(at), [jnp.full_like(at, c) for c in cubics[0]]
    for i in range(1, len(cubics)):
        beyond = at >= i
        start = jnp.where(beyond, i, start)
        own = [jnp.where(beyond, c, before) for c, before in zip(cubics[i], own)]
    a, b, c, d = own
    t = at - start
    return a + t * (b + t * (c + t * d))


@parameters
class SelectiveColor:
    """Changes of sixteen sectors of hue, from the hue of blue-yellow's positive axis on, 22.5 degrees each.

    Each is that of a fully saturated colour; others change in proportion to their saturation.
    """

    hue: Leaf = param((0.0,) * SECTORS, (-1.2, 1.2), "rad", doc="rotation of the hues of each sector")
    saturation: Leaf = param((0.0,) * SECTORS, (-1.0, 2.0), "1", doc="chroma gain less 1 of each sector")
    lightness: Leaf = param((0.0,) * SECTORS, (-1.5, 1.5), "1", doc="luma added per unit of chroma")


@register(reach=0)
def selective_color(params: SelectiveColor, image: EncodedRGB) -> EncodedRGB:
    """Turn, saturate and lighten some hues more than others, as a colour look-up table does.

    In Y'CbCr, with hue h = atan2(Cr, Cb), saturation s = (max - min) / max of the channels and sixteen
    raised cosines w_k(h) that sum to 1: chroma is turned by `s sum_k w_k hue_k` and scaled by
    `1 + s sum_k w_k saturation_k`; `Y' += |C| s sum_k w_k lightness_k`.

    Args:
        params: sixteen numbers each; all 0 leave the image as it is, up to rounding.
        image: (H, W, 3) encoded, any range.

    Returns:
        (H, W, 3) encoded, not clipped. Greys stay grey.

    Gradient: exact (at grey, where hue has none, that to the hue is 0).

    Source: DNG Specification 1.6, ProfileHueSatMapData, whose tables too are by hue and saturation.
    """
    red, green, blue = planes(image)
    y, cb, cr = rgb_to_ycbcr_planes(red, green, blue)
    colored = cb * cb + cr * cr > 1e-12
    # stored, or each of the three channels would work it all out
    hue = materialize(jnp.arctan2(jnp.where(colored, cr, 0.0), jnp.where(colored, cb, 1.0)))
    high = jnp.maximum(jnp.maximum(red, green), blue)
    low = jnp.minimum(jnp.minimum(red, green), blue)
    saturation = jnp.clip((high - low) / jnp.maximum(high, _DARK), 0, 1)
    tables = params.hue, params.saturation, params.lightness
    by_hue = materialize(_by_hue(hue, tuple(t.astype(jnp.result_type(hue, t)) for t in tables)))
    turn, gain, lift = (saturation * amount for amount in by_hue)
    cos, sin = materialize(((1 + gain) * jnp.cos(turn), (1 + gain) * jnp.sin(turn)))
    chroma = safe_sqrt(cb * cb + cr * cr)
    return interleaved(ycbcr_to_rgb_planes(y + lift * chroma, cos * cb - sin * cr, sin * cb + cos * cr))


@jax.custom_jvp
def _by_hue(hue: jax.Array, amounts: tuple[jax.Array, ...]) -> list[jax.Array]:
    """What each list of amounts has at a hue [rad]: raised cosines from one sector's middle to the next's."""
    first, share = materialize(_sectors(hue))
    values = [jnp.zeros_like(hue) for _ in amounts]
    for k in range(SECTORS):
        here = first == k
        for i, a in enumerate(amounts):
            between = a[k] + share * (a[(k + 1) % SECTORS] - a[k])
            values[i] = jnp.where(here, between, values[i])
    return values


@_by_hue.defjvp
def _by_hue_jvp(primals: Any, tangents: Any) -> tuple[list[jax.Array], list[jax.Array]]:
    (hue, amounts), (d_hue, d_amounts) = primals, tangents
    values, by_hue = jax.jvp(lambda h: _by_hue.fun(h, amounts), (hue,), (d_hue,))
    by_amounts = linear_call(_by_hue.fun, _gathered, hue, d_amounts)
    return values, [a + b for a, b in zip(by_hue, by_amounts)]


def _gathered(hue: jax.Array, cotangents: list[jax.Array]) -> tuple[jax.Array, ...]:
    """The transpose to the amounts, as products: autodiff sums over the picture once for each of them."""
    first, share = materialize(_sectors(hue))
    before = [jnp.where(first == k, 1 - share, 0) for k in range(SECTORS)]
    after = [jnp.where(first == (k - 1) % SECTORS, share, 0) for k in range(SECTORS)]
    weights = materialize(jnp.stack([a + b for a, b in zip(before, after)])).reshape(SECTORS, -1)
    return tuple(jnp.matmul(weights, c.reshape(-1), precision=_EXACT) for c in cotangents)


def _sectors(hue: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The sector whose middle is before a hue [rad], and the share of the next."""
    at = hue * (SECTORS / (2 * math.pi)) % SECTORS
    first = jnp.where(at < SECTORS, jnp.floor(at), 0)  # a hue just below 0 may be rounded up to all of them
    return first, 0.5 - 0.5 * jnp.cos(math.pi * (at - first))


@parameters
class LocalToneMapping:
    """How the tone of a pixel follows the brightness around it."""

    compression: Leaf = param(0.0, (-0.8, 0.8), "1", doc="exponent that the surround's brightness loses")
    adaptation: Leaf = param(1.0, (0.0, 1.0), "share", doc="1 keeps the frame's own mean, 0 keeps 0.18")
    detail: Leaf = param(0.0, (-0.8, 2.0), "1", doc="share of the difference to the surround that is added")
    sigma: Leaf = param(14.0, (4.0, 40.0), "px", log=True, doc="standard deviation of the surround")
    edges: Leaf = param(0.0, (0.0, 1.0), "share", doc="of an edge-aware surround, in place of the even one")
    contrast: Leaf = param(0.0, (-0.8, 2.0), "1", doc="as detail, in lightness")
    equalization: Leaf = param(0.0, (0.0, 1.0), "share", doc="of lightness equalised tile by tile")
    clip: Leaf = param(3.0, (1.0, 20.0), "1", doc="of a tile's histogram, times its mean")


@register
def local_tone_mapping(params: LocalToneMapping, image: RGB, *, tiles: Positive = 8) -> RGB:
    """Lift dark surroundings, hold back bright ones, and raise local contrast.

    `y = x (m / k)**(-compression) + detail (Y - m)`, m the Gaussian mean of luma Y, no less than 0.004, and
    `k = g**adaptation 0.18**(1 - adaptation)`, g the geometric mean of m over the frame. In the gain, a share
    `edges` of log2 m is a guided filter of log2 Y by itself, which keeps edges of several stops: an even
    surround has halos there.

    Lightness, sRGB's encoding of the light, then gains `contrast (L - m_L) + equalization (E(L) - L)`, the
    same in every channel. m_L is its surround, likewise even or edge-aware. E is contrast limited adaptive
    histogram equalisation: the distribution function of each of tiles x tiles parts of the frame, its
    density no more than `clip` times the mean and the excess spread evenly, bilinear between their middles.

    Args:
        params: compression, adaptation, detail, sigma [px], edges, contrast, equalization, clip.
        image: (H, W, 3), linear light or encoded, any range.
        tiles: parts of the frame along each axis.

    Returns:
        (H, W, 3) in the domain of the image, not clipped. Compression, detail, contrast and equalization of
        0 leave it as it is.

    Gradient: exact (counts of levels are constant but at single values).

    Source: Tumblin & Turk 1999; Reinhard et al. 2002 (key of the frame, surround); Durand & Dorsey 2002
    (base and detail), here with a linear base or that of He, Sun & Tang 2010 (guided filter); Zuiderveld
    1994, "Contrast limited adaptive histogram equalization", here with tables that are linear in steps of 5
    levels.
    """
    y = luma(*planes(image))
    mean = wide_blur(y, params.sigma)
    surround = jnp.log2(jnp.maximum(mean, _DARKEST))
    edge_aware = _guided(jnp.log2(jnp.maximum(y, _DARKEST)), params.sigma)
    surround = surround + params.edges * (edge_aware - surround)
    key = params.adaptation * surround.mean() + (1 - params.adaptation) * math.log2(0.18)
    gain = jnp.exp2(-params.compression * (surround - key))
    mapped = image * gain[..., None] + (params.detail * (y - mean))[..., None]
    y = luma(*planes(mapped))
    change = weighted(_contrast, params.contrast, params.sigma, params.edges, y)
    change = change + weighted(partial(_equalised, tiles), params.equalization, params.clip, y)
    encoded = materialize(srgb_oetf(mapped))
    # less its own inverse, so that no change is none
    return mapped + (srgb_eotf(encoded + change[..., None]) - srgb_eotf(encoded))


def _contrast(sigma: jax.Array, edges: jax.Array, y: jax.Array) -> jax.Array:
    """Lightness less its surround."""
    lightness = materialize(srgb_oetf(y))
    surround = wide_blur(lightness, sigma)
    surround = surround + edges * (_guided(lightness, sigma, _STEP) - surround)
    return lightness - surround


def _equalised(tiles: int, clip_at: jax.Array, y: jax.Array) -> jax.Array:
    """Lightness equalised by tiles, less itself."""
    lightness = materialize(srgb_oetf(y))
    height, width = lightness.shape
    rows, columns = (-(-n // tiles) for n in (height, width))
    widths = ((0, rows * tiles - height), (0, columns * tiles - width))
    whole = jnp.pad(lightness, widths, mode="edge").reshape(tiles, rows, tiles, columns)
    density = _density(jnp.moveaxis(whole, 2, 1).reshape(tiles, tiles, rows * columns))
    kept = jnp.minimum(density, clip_at / _LEVELS)
    kept = kept + (1 - kept.sum(-1, keepdims=True)) / _LEVELS
    tables = jnp.cumsum(kept, -1)[..., ::_STRIDE]
    down, across = (
        jnp.asarray(_between_middles(n, tiles, size), y.dtype)
        for n, size in ((height, rows), (width, columns))
    )
    tables = jnp.matmul(down, tables.reshape(tiles, -1), precision=_EXACT).reshape(height, tiles, -1)
    place = clip(lightness, 0, 1) * ((_LEVELS - 1) / _STRIDE)

    def add(found: jax.Array, own: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        knot, table = own
        level = jnp.matmul(table, across.T, precision=_EXACT)
        return found + jnp.maximum(1 - jnp.abs(place - knot), 0) * level, None

    knots = jnp.arange(tables.shape[-1], dtype=y.dtype)
    found, _ = lax.scan(add, jnp.zeros_like(y), (knots, jnp.moveaxis(tables, -1, 0)))
    return found - lightness


def _density(lightness: jax.Array) -> jax.Array:
    """(..., 256): the share of the last axis at each 8-bit level, by indicators of its two digits."""
    level = jnp.round(255 * clip(lax.stop_gradient(lightness), 0, 1))
    high = jnp.floor(level / 16)
    digits = jnp.arange(16, dtype=level.dtype).reshape(*(1,) * level.ndim, 16)
    first, second = (
        (part[..., None] == digits).astype(lightness.dtype) for part in (high, level - 16 * high)
    )
    counts = jnp.matmul(jnp.swapaxes(first, -1, -2), second, precision=_EXACT)
    return counts.reshape(*lightness.shape[:-1], _LEVELS) / lightness.shape[-1]


def _between_middles(n: int, tiles: int, size: int) -> np.ndarray:
    """(n, tiles): weights of tiles of that size at n places, linear between their middles."""
    place = np.clip((np.arange(n) + 0.5) / size - 0.5, 0, tiles - 1)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(tiles)), 0)


def _guided(plane: jax.Array, sigma: jax.Array, edge: float = _EDGE) -> jax.Array:
    """A guided filter of (H, W) by itself with Gaussian windows."""
    mean = wide_blur(plane, sigma)
    variance = wide_blur((plane - mean) ** 2, sigma)
    share = variance / (variance + edge)
    return wide_blur(share, sigma) * plane + wide_blur((1 - share) * mean, sigma)


@jax.jit  # traced once for all of a stage's
def wide_blur(plane: jax.Array, sigma: jax.Array) -> jax.Array:
    """Gaussian mean of (H, W) for sigmas of 4 to 40 px, by way of the means of 4x4 blocks."""
    h, w = plane.shape
    rows, columns = (-n % _REDUCED for n in (h, w))
    padded = jnp.pad(plane, ((0, rows), (0, columns)), mode="edge")
    small = padded.reshape((h + rows) // _REDUCED, _REDUCED, (w + columns) // _REDUCED, _REDUCED).mean((1, 3))
    # a block's 15/12 px2 and the 16/6 px2 of linear interpolation back spread by themselves: 0.245 blocks
    spread = jnp.maximum((jnp.asarray(sigma, plane.dtype) / _REDUCED) ** 2 - 0.245, 0.1)
    down, across = (_reflected_gaussian(n, spread, 30) for n in small.shape)
    small = jnp.matmul(jnp.matmul(down, small, precision=_EXACT), across.T, precision=_EXACT)
    return jax.image.resize(small, padded.shape, "linear")[:h, :w]


def _reflected_gaussian(n: int, variance: jax.Array, radius: int) -> jax.Array:
    """(n, n): what `gaussian_blur` does along an axis; as a matrix it compiles in a tenth of the time."""
    dtype = variance.dtype
    place, period = jnp.arange(n, dtype=dtype)[None, None], max(2 * (n - 1), 1)
    middle = place.mT
    edge = (place == 0) | (place == n - 1)  # is its own mirror image

    def weight(distance: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(distance) <= radius, jnp.exp(-0.5 * distance**2 / variance), 0)

    turns = period * jnp.arange(-(radius // period) - 1, radius // period + 2, dtype=dtype)[:, None, None]
    each = weight(turns + place - middle) + jnp.where(edge, 0, weight(turns - place - middle))
    return fused_sum(each, 0) / weight(jnp.arange(-radius, radius + 1, dtype=dtype)).sum()
