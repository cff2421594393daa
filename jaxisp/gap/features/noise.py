"""Noise statistics of one picture: variance, correlation, tails and grids."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.stencils import gaussian_blur
from jaxisp.color import ycbcr_to_rgb_planes
from jaxisp.gap.features.mean import CHANNELS, Found, blurred_planes, named, tents
from jaxisp.gap.features.quantization import Quantization, averages, cosine, quantization_part, sums

LUMA = (0.0, 28.0, 60.0, 100.0, 150.0, 200.0, 255.0)
"""Luma knots (0 to 255) of the tents that noise is measured in; closer in the dark."""
LEVELS = tuple(range(8, 81, 6))
"""Numbers of levels from black to white that are tested for posterisation."""
_LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
_DARK = 70.0  # luma; read noise dominates below it
_OUTLIER = 4.0  # standard deviations; only the tail statistics use noise beyond it
_STRIPE = 16  # px; line means over even stripes are compared with line means over odd stripes
_GUARD = 4  # px left out between stripes when bands of lines are measured, since grain correlates this far


def _log(numerator: Any, denominator: Any = 1.0, least: float = 0.02) -> jax.Array:
    return jnp.log((numerator + least) / (denominator + least))


def flatness(s: jax.Array, mask: jax.Array) -> jax.Array:
    """Flatness (h, w) in [0, 1] of a noise-free picture (3, h, w), Y'CbCr in 8-bit steps.

    It is near 0 at edges of luma or chroma, near 1 elsewhere, and multiplied by the mask (h, w).
    """
    smooth = blurred_planes(s, 1.0)
    down, right = (jnp.asarray(jnp.gradient(smooth, axis=a)) for a in (1, 2))
    activity = gaussian_blur(jnp.sqrt((down**2 + right**2).sum(0)), 2.0, 6)
    return mask / (1 + (activity / 2.0) ** 2) ** 2


def noise_part(r: jax.Array, y: jax.Array, s: jax.Array, mask: jax.Array, seen: Quantization) -> Found:
    """Compute variance, spectrum, correlation, line, tail and grid statistics of one picture's noise.

    Args:
        r: (h, w, 3) noise, Y'CbCr in 8-bit steps.
        y: (h, w, 3) the picture.
        s: (h, w, 3) the noise-free picture.
        mask: (h, w) weight of each pixel.
        seen: the map from the picture back to sensor values.
    """
    r, y, s = (materialize(jnp.moveaxis(a, -1, 0)) for a in (r, y, s))  # avoids strided reads of channels
    flat = materialize(flatness(s, mask))
    whole = materialize(r - blurred_planes(r, 2.5))
    r = materialize(r - whole + _without_outliers(whole, flat))
    smooth = [r, *(materialize(blurred_planes(r, sigma)) for sigma in (1.0, 2.5, 6.0))]
    bands = [fine - coarse for fine, coarse in itertools.pairwise(smooth)]
    high, light = materialize(r - smooth[2]), s[0]
    found = _spread(high, bands, light, mask, flat) | _correlations(high, flat, light) | _lines(r, flat)
    found |= _tails(whole[0], light, flat) | _grids(y, flat) | _levels(y, flat)
    return found | quantization_part(y, s, flat, seen)


def _without_outliers(high: jax.Array, flat: jax.Array) -> jax.Array:
    """Clip noise (C, h, w) at `_OUTLIER` local standard deviations.

    A few hot pixels would otherwise dominate all statistics. `_tails` measures outliers separately.
    """
    weight = flat + 0.02  # the constant keeps the mean defined where no flat area is near
    size = blurred_planes(jnp.abs(high) * weight, 4.0) / gaussian_blur(weight, 4.0, 12)
    most = _OUTLIER * jnp.sqrt(jnp.pi / 2) * (size + 0.1)
    return jnp.clip(high, -most, most)


def _levels(picture: jax.Array, flat: jax.Array) -> Found:
    """Characteristic function of the differences between horizontal neighbours in green.

    If a picture has few levels, the differences are multiples of one step.
    """
    green = ycbcr_to_rgb_planes(*picture / 255)[1]
    step, weight = green[:, 1:] - green[:, :-1], flat[:, 1:] * flat[:, :-1]
    waves = cosine(jnp.asarray(LEVELS, step.dtype)[:, None, None] * step)
    return {named("levels intensity {:02d}", LEVELS): averages(waves, weight[None])[0]}


def _spread(
    high: jax.Array, bands: list[jax.Array], light: jax.Array, mask: jax.Array, flat: jax.Array
) -> Found:
    """Log variances of the noise (3, h, w) by luma, CFA phase, edges, radius and frequency band."""
    down, across = (jnp.arange(n) / (n - 1) - 0.5 for n in mask.shape)
    outer = jnp.clip(2 * (down[:, None] ** 2 + across[None, :] ** 2), 0, 1)
    tented = [flat * tent for tent in tents(light, LUMA)]
    weights = [
        *tented,
        *(flat * p for p in _phases(mask.shape)),
        mask - flat,
        flat * outer,
        flat * (1 - outer),
    ]
    means = averages(jnp.concatenate([high, *bands]) ** 2, jnp.stack([*weights, flat]))
    whole, fine, by_place = means[-1, :3], means[-1, 3:].reshape(-1, 3), means[:, :3]
    k = len(tented)
    return {
        named("logvar intensity {1}{0}", range(k), CHANNELS): _log(by_place[:k]).ravel(),
        named("logvar cfa_phase {2}{0}{1}", (0, 1), (0, 1), CHANNELS): _log(by_place[k:-4], whole).ravel(),
        named("logvar edge {}", CHANNELS): _log(by_place[-4], whole),
        named("logvar radius {}", CHANNELS): _log(by_place[-3], by_place[-2]),
        named("logvar frequency {1}{0}", range(len(bands)), CHANNELS): _log(fine, whole).ravel(),
    }


def _phases(shape: tuple[int, ...]) -> list[jax.Array]:
    """Four (h, w) masks, one for each combination of even and odd rows and columns."""
    row, column = jnp.arange(shape[0])[:, None] % 2, jnp.arange(shape[1])[None, :] % 2
    return [(row == a) & (column == b) for a in (0, 1) for b in (0, 1)]


def _correlations(high: jax.Array, flat: jax.Array, light: jax.Array) -> Found:
    """Correlations of the noise (3, h, w) with its neighbours and between channels.

    They are measured separately in the dark, where read noise dominates, and in the light.
    """
    parts, pairs = ("dark", "light"), ((0, 1), (0, 2), (1, 2))
    dark = jax.nn.sigmoid((_DARK - light) / 6)
    near = [high * jnp.roll(high, lag, (1, 2)) for lag in _LAGS[:3]]
    far = [high[:1] * jnp.roll(high[:1], lag, (1, 2)) for lag in _LAGS[3:]]
    between = [high[a : a + 1] * high[b : b + 1] for a, b in pairs]
    values = jnp.concatenate([high**2, *near, *far, *between])
    found = sums(values, jnp.stack([flat * dark, flat * (1 - dark)]))
    power = found[:, :3] + 1.0
    neighbours = found[:, 3:12].reshape(2, 3, 3) / power[:, None]
    luma = jnp.concatenate([neighbours[..., 0], found[:, 12:15] / power[:, :1]], 1)
    across = jnp.stack([jnp.sqrt(power[:, a] * power[:, b]) for a, b in pairs], 1)
    one, other = (luma[:, _LAGS.index(lag)] for lag in ((1, 1), (1, -1)))
    return {
        named("corr lag Y{1} {0}", parts, _LAGS): luma.ravel(),
        named("corr lag {2}{1} {0}", parts, _LAGS[:3], CHANNELS[1:]): neighbours[..., 1:].ravel(),
        # rows and columns belong to other axes, so only diagonals are compared here
        named("corr orientation diagonals {}", parts): one - other,
        named("corr channel {1} {0}", parts, [CHANNELS[a] + CHANNELS[b] for a, b in pairs]): (
            found[:, 15:] / across
        ).ravel(),
    }


def _lines(r: jax.Array, flat: jax.Array) -> Found:
    """Correlations of row means over even stripes with row means over odd stripes; likewise for columns.

    White noise has none. Statistics named "slow" are of offsets that vary over tens of lines.
    """
    found: Found = {}
    power = blurred_planes(r**2 * flat, 4.0) / (gaussian_blur(flat, 4.0, 12) + 1e-3)
    usual = averages(power, jnp.ones((1, *flat.shape), flat.dtype))[0, :, None, None]
    even = r / jnp.sqrt(power + 0.1 * usual + 1e-3)  # quiet and noisy areas then count alike
    weighed = materialize(even * flat)
    for axis, of, along in ((1, "row", "hw,wk->hk"), (0, "column", "hw,hk->wk")):
        at = np.arange(flat.shape[axis])
        sides = np.stack([at // _STRIPE % 2 == side for side in (0, 1)], 1)
        apart = sides & (at % _STRIPE < _STRIPE - _GUARD)[:, None]
        stripes = jnp.asarray(np.concatenate([sides, apart], 1), r.dtype)
        counts, *parts = (jnp.einsum(along, a, stripes, precision="highest") for a in (flat, *weighed))
        means = jnp.stack([part / (counts + 1.0) for part in parts], -1).swapaxes(0, 1)
        fine = means[:2, 1:-1] - 0.5 * (means[:2, :-2] + means[:2, 2:])
        n = means.shape[1] - 4
        slow = sum((means[2:, k : k + n] for k in range(5)), jnp.zeros(())) / 5
        found[named(f"corr {of} {{}}", CHANNELS)] = _agreement(*fine)
        found[named(f"corr {of} {{}} slow", CHANNELS)] = _agreement(*(slow - slow.mean(1, keepdims=True)))
    return found


def _agreement(a: jax.Array, b: jax.Array) -> jax.Array:
    """Correlation (C,) of two series of line offsets (n, C)."""
    return (a * b).sum(0) / jnp.sqrt((a**2).sum(0) * (b**2).sum(0) + 1e-6)


def _tails(luma: jax.Array, light: jax.Array, flat: jax.Array) -> Found:
    parts = ("dark", "bright")
    local = gaussian_blur(luma**2 * flat, 4.0, 12) / (gaussian_blur(flat, 4.0, 12) + 1e-3)
    weights = flat * jnp.stack([light < 80, light >= 80])
    variances = averages(luma[None] ** 2, weights) + 0.02
    found = []
    for weight, variance in zip(weights, variances):
        z = luma / jnp.sqrt(0.8 * local + 0.2 * variance + 0.02)
        beyond = [jax.nn.sigmoid(4 * (sign * z - 4.0)) for sign in (1, -1)]
        found.append(averages(jnp.stack([z**4, jnp.clip(z, -6, 6) ** 3, *beyond]), weight[None])[0])
    fourth, third, *shares = jnp.stack(found, 1)
    return {
        named("tail tail kurtosis {}", parts): _log(fourth, 3.0, 0.1),
        named("tail tail skew {}", parts): 0.5 * third,
        named("tail tail {} {}", ("high", "low"), parts): 0.5 * jnp.log1p(1e4 * jnp.concatenate(shares)),
    }


def _grids(picture: jax.Array, flat: jax.Array) -> Found:
    """Statistics of 8x8 blocks and of quantized values in a picture (3, h, w)."""
    found: Found = {}
    luma = picture[0]
    for axis, of in ((1, "columns"), (0, "rows")):
        jump = (jnp.abs(luma - jnp.roll(luma, 1, axis)) * flat).sum(1 - axis)
        phase = np.eye(8, dtype=np.float32)[np.arange(len(jump)) % 8]
        by_phase = jnp.matmul(jump, phase, precision="highest") / phase.sum(0)
        found[named("logvar block_phase {}{}", [of], range(8))] = _log(by_phase, by_phase.mean(), 0.01)
    h, w = (n // 8 * 8 for n in flat.shape)
    even = flat[:h, :w].reshape(h // 8, 8, w // 8, 8).mean((1, 3)).ravel()  # blocks with edges count less
    near = materialize(jnp.exp(-((_blocks(picture[:, :h, :w]) / 1.5) ** 2)))
    near = jnp.einsum("b,cbk->ck", even, near, precision="highest") / (even.sum() + 1e-3)
    band = (_ORDER // 4).clip(max=2).ravel() == np.arange(3)[:, None]
    share = jnp.einsum("ck,bk->cb", near, band / band.sum(1, keepdims=True), precision="highest")
    found[named("comb block_phase {}{}", CHANNELS, range(3))] = share.ravel()
    still = jnp.exp(-(((picture - jnp.roll(picture, 1, 2)) / 0.7) ** 2))
    found[named("comb intensity {}", CHANNELS)] = averages(still, flat[None])[0]
    return found


_ORDER = np.add.outer(np.arange(8), np.arange(8))
_WAVES = np.cos(np.outer(np.arange(8), 2 * np.arange(8) + 1) * np.pi / 16)
_WAVES = _WAVES / np.linalg.norm(_WAVES, axis=1, keepdims=True)


def _blocks(picture: jax.Array) -> jax.Array:
    """Cosine transform (C, blocks, 64) of the 8x8 blocks of planes (C, h, w)."""
    c, h, w = picture.shape
    blocks = materialize(picture.reshape(c, h // 8, 8, w // 8, 8).swapaxes(2, 3).reshape(c, -1, 64))
    waves = jnp.asarray(np.kron(_WAVES, _WAVES), picture.dtype)
    return jnp.matmul(blocks, waves.T, precision="highest")
