"""Clean+noisy pairs: numbers that say how a real picture's residual differs from a simulated one's.

Pixels of two noise realisations never agree, so statistics of the residual are compared: what its mean
follows (light, radius, edges, hue ...), see `noisy_mean`, and how its noise is spread, correlated, shaped and
repeated. The noise is measured on what is left when the mean's part, a regression on the noise-free picture's
local features, is taken out: an error of the mean at edges is no noise. Repeated frames give it without any.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import ycbcr_to_rgb_planes
from jaxisp.gap.noisy_codes import Codes, comb_part, cosine, unknown_codes
from jaxisp.gap.noisy_mean import CHANNELS, Maps, blurred, mean_names, tents
from jaxisp.windows import gaussian_blur

LUMA = (0.0, 28.0, 60.0, 100.0, 150.0, 200.0, 255.0)
"""Where the tents of luma stand that noise is measured in: the dark has more to tell."""
LEVELS = tuple(range(8, 81, 6))
"""Values up to white that posterisation may leave."""
_LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
_DARK = 70.0  # luma below which read noise is most of the noise
_PLAIN, _PLAINLY = 0.05, 0.2  # a correlation from scene to scene that is no chance: of pixels, of spots
_OUTLIER = 4.0  # standard deviations beyond which noise is a matter of tails
_FEW = 2.5  # standard deviations of noise beyond which a pixel counts no more among those around
_STRIPE = 16  # px: lines are measured on every second stripe, and on the stripes between
_GUARD = 4  # px between the parts of stripes that bands of lines are measured on: grain reaches as far
Found = dict[str, jax.Array]


def _log(numerator: Any, denominator: Any = 1.0, least: float = 0.02) -> jax.Array:
    return jnp.log((numerator + least) / (denominator + least))


def _mean(values: jax.Array, weight: jax.Array) -> jax.Array:
    return (values * weight).sum() / (weight.sum() + 1e-3)


def flatness(s: jax.Array, mask: jax.Array) -> jax.Array:
    """(h, w) near 1 where neither luma nor chroma of a noise-free picture has edges, near 0 at edges."""
    smooth = blurred(s, 1.0)
    steps = [jnp.asarray(jnp.gradient(smooth, axis=a)) for a in (0, 1)]
    activity = gaussian_blur(jnp.sqrt((steps[0] ** 2 + steps[1] ** 2).sum(-1)), 2.0, 6)
    return mask / (1 + (activity / 2.0) ** 2) ** 2


def noise_part(r: jax.Array, y: jax.Array, s: jax.Array, mask: jax.Array, seen: Codes) -> Found:
    """Spread, spectrum, correlation, lines, tails and grids of one residual's noise."""
    flat = flatness(s, mask)
    whole = r - blurred(r, 2.5)
    r = r - whole + _without_outliers(whole, flat)
    smooth = [blurred(r, sigma) for sigma in (1.0, 2.5, 6.0)]
    bands = [r - smooth[0], smooth[0] - smooth[1], smooth[1] - smooth[2]]
    high = r - smooth[1]
    found = _spread(high, bands, s, mask, flat) | _correlations(high, flat, s[..., 0]) | _lines(r, flat)
    found |= _tails(whole[..., 0], s[..., 0], flat) | _grids(high, y, flat) | comb_part(y, s, flat, seen)
    return found | _levels(y, flat)


def _without_outliers(high: jax.Array, flat: jax.Array) -> jax.Array:
    """Noise (h, w, C) cut off where it is far beyond what it is around: a few hot pixels, which may lie
    anywhere, would decide on all that is measured; tails are looked at apart."""
    weight = flat + 0.02  # of edges, where nothing is flat around
    size = blurred(jnp.abs(high) * weight[..., None], 4.0) / gaussian_blur(weight, 4.0, 12)[..., None]
    most = _OUTLIER * jnp.sqrt(jnp.pi / 2) * (size + 0.1)
    return jnp.clip(high, -most, most)


def _levels(y: jax.Array, flat: jax.Array) -> Found:
    """The characteristic function of what green differs in from its neighbour's: of few levels the
    differences are multiples of one step."""
    green = ycbcr_to_rgb_planes(*jnp.moveaxis(y / 255, -1, 0))[1]
    step, weight = green[:, 1:] - green[:, :-1], flat[:, 1:] * flat[:, :-1]
    return {f"levels intensity {count:02d}": _mean(cosine(count * step), weight) for count in LEVELS}


def _spread(high: jax.Array, bands: list[jax.Array], s: jax.Array, mask: jax.Array, flat: jax.Array) -> Found:
    found: Found = {}
    h, w = mask.shape
    down, across = (jnp.arange(n) / (n - 1) - 0.5 for n in (h, w))
    outer = jnp.clip(2 * (down[:, None] ** 2 + across[None, :] ** 2), 0, 1)
    for c, name in enumerate(CHANNELS):
        square = high[..., c] ** 2
        whole = _mean(square, flat)
        for k, tent in enumerate(tents(s[..., 0], LUMA)):
            found[f"logvar intensity {name}{k}"] = _log(_mean(square, flat * tent))
        for k, band in enumerate(bands):
            found[f"logvar frequency {name}{k}"] = _log(_mean(band[..., c] ** 2, flat), whole)
        found[f"logvar edge {name}"] = _log(_mean(square, mask - flat), whole)
        parts = [_mean(square, flat * weight) for weight in (outer, 1 - outer)]
        found[f"logvar radius {name}"] = _log(parts[0], parts[1])
    return found


def _correlations(high: jax.Array, flat: jax.Array, light: jax.Array) -> Found:
    """With neighbours, in the dark, where read noise is most of it, and elsewhere; and between channels."""
    found: Found = {}
    dark = jax.nn.sigmoid((_DARK - light) / 6)
    for part, weight in (("dark", flat * dark), ("light", flat * (1 - dark))):
        power = [(high[..., c] ** 2 * weight).sum() + 1.0 for c in range(3)]
        for c, name in enumerate(CHANNELS):
            for lag in _LAGS[: 6 if c == 0 else 3]:
                product = high[..., c] * jnp.roll(high[..., c], lag, (0, 1))
                found[f"corr lag {name}{lag} {part}"] = (product * weight).sum() / power[c]
        one, other = (found[f"corr lag Y{lag} {part}"] for lag in ((1, 1), (1, -1)))
        found[f"corr orientation diagonals {part}"] = one - other  # rows and columns have axes of their own
        for a, b in ((0, 1), (0, 2), (1, 2)):
            product = (high[..., a] * high[..., b] * weight).sum()
            found[f"corr channel {CHANNELS[a]}{CHANNELS[b]} {part}"] = product / jnp.sqrt(power[a] * power[b])
    return found


def _lines(r: jax.Array, flat: jax.Array) -> Found:
    """How the mean of a row over every second stripe follows that over the stripes between, which white
    noise does not make it do; alike for columns. "slow" is what varies over tens of lines."""
    found: Found = {}
    power = blurred(r**2 * flat[..., None], 4.0) / (gaussian_blur(flat, 4.0, 12) + 1e-3)[..., None]
    even = r / jnp.sqrt(power + 0.1 * power.mean((0, 1)) + 1e-3)  # quiet parts tell as much as loud ones
    for axis, of in ((1, "row"), (0, "column")):
        at = jnp.arange(r.shape[axis])
        place, inner = at // _STRIPE % 2, at % _STRIPE < _STRIPE - _GUARD
        sides, apart = (
            [flat * jnp.expand_dims((place == side) & counted, 1 - axis) for side in (0, 1)]
            for counted in (jnp.ones_like(inner), inner)
        )
        for c, name in enumerate(CHANNELS):
            fine, bands = (
                [(even[..., c] * side).sum(axis) / (side.sum(axis) + 1.0) for side in both]
                for both in (sides, apart)
            )
            found[f"corr {of} {name}"] = _agreement(*(m[1:-1] - 0.5 * (m[:-2] + m[2:]) for m in fine))
            slow = [jnp.convolve(m, jnp.ones(5) / 5, "valid") for m in bands]
            found[f"corr {of} {name} slow"] = _agreement(*(m - m.mean() for m in slow))
    return found


def _agreement(a: jax.Array, b: jax.Array) -> jax.Array:
    return (a * b).sum() / jnp.sqrt((a**2).sum() * (b**2).sum() + 1e-6)


def _tails(luma: jax.Array, light: jax.Array, flat: jax.Array) -> Found:
    found: Found = {}
    local = gaussian_blur(luma**2 * flat, 4.0, 12) / (gaussian_blur(flat, 4.0, 12) + 1e-3)
    for name, part in (("dark", light < 80), ("bright", light >= 80)):
        weight = flat * part
        variance = _mean(luma**2, weight) + 0.02
        z = luma / jnp.sqrt(0.8 * local + 0.2 * variance + 0.02)
        found[f"tail tail kurtosis {name}"] = _log(_mean(z**4, weight), 3.0, 0.1)
        found[f"tail tail skew {name}"] = 0.5 * _mean(jnp.clip(z, -6, 6) ** 3, weight)
        for sign, side in ((1, "high"), (-1, "low")):
            share = _mean(jax.nn.sigmoid(4 * (sign * z - 4.0)), weight)
            found[f"tail tail {side} {name}"] = 0.5 * jnp.log1p(1e4 * share)
    return found


def _grids(high: jax.Array, y: jax.Array, flat: jax.Array) -> Found:
    """What repeats every 2 px, every 8 px, or at certain values only."""
    found: Found = {}
    for c, name in enumerate(CHANNELS):
        whole = _mean(high[..., c] ** 2, flat)
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            part = _mean(high[a::2, b::2, c] ** 2, flat[a::2, b::2])
            found[f"logvar cfa_phase {name}{a}{b}"] = _log(part, whole)
    for axis, of in ((1, "columns"), (0, "rows")):
        jump = (jnp.abs(y[..., 0] - jnp.roll(y[..., 0], 1, axis)) * flat).sum(1 - axis)
        by_phase = jnp.stack([jump[k::8].mean() for k in range(8)])
        for k in range(8):
            found[f"logvar block_phase {of}{k}"] = _log(by_phase[k], by_phase.mean(), 0.01)
    h, w = (n // 8 * 8 for n in flat.shape)
    even = flat[:h, :w].reshape(h // 8, 8, w // 8, 8).mean((1, 3))[..., None, None]  # edges are no noise
    for c, name in enumerate(CHANNELS):
        size = jnp.abs(_blocks(y[..., c]))
        near = (jnp.exp(-((size / 1.5) ** 2)) * even).sum((0, 1)) / (even.sum() + 1e-3)
        for k in range(3):
            band = (_ORDER // 4).clip(max=2) == k
            found[f"comb block_phase {name}{k}"] = (near * band).sum() / band.sum()
        still = jnp.exp(-(((y[..., c] - jnp.roll(y[..., c], 1, 1)) / 0.7) ** 2))
        found[f"comb intensity {name}"] = _mean(still, flat)
    return found


_ORDER = np.add.outer(np.arange(8), np.arange(8))
_WAVES = np.cos(np.outer(np.arange(8), 2 * np.arange(8) + 1) * np.pi / 16)
_WAVES = _WAVES / np.linalg.norm(_WAVES, axis=1, keepdims=True)


def _blocks(plane: jax.Array) -> jax.Array:
    """(down, across, 8, 8) cosine transform of the 8x8 blocks."""
    h, w = (n // 8 * 8 for n in plane.shape)
    blocks = plane[:h, :w].reshape(h // 8, 8, w // 8, 8).swapaxes(1, 2)
    waves = jnp.asarray(_WAVES, plane.dtype)
    return waves @ blocks @ waves.T


def pattern_part(r: jax.Array, s: jax.Array, mask: jax.Array, others: jax.Array) -> Found:
    """(N,) each: how a pair's residual repeats in the other scenes, pixel by pixel and line by line."""
    found: Found = {}
    light = s[..., 0] / 255
    for c, name in enumerate(CHANNELS):
        plane = r[..., c] * mask
        high = plane - jnp.stack([gaussian_blur(v, 1.5, 5) for v in plane])
        clipped = jnp.clip(high / (jnp.sqrt((high**2).mean((1, 2), keepdims=True)) + 0.1), -4, 4)
        found[f"pattern fixed_pattern {name} pixel"] = _repeated(clipped, others)
        most = _FEW * jnp.sqrt((high**2).mean((1, 2), keepdims=True)) + 0.1
        even = jnp.clip(plane, -most, most)  # a hot pixel is no spot
        coarse = jnp.stack([gaussian_blur(v, 2.0, 6) - gaussian_blur(v, 8.0, 24) for v in even])
        found[f"coarse fixed_pattern {name}"] = _repeated(coarse, others, _PLAINLY)
        if c == 0:
            found["pattern fixed_pattern bright"] = _repeated(clipped * light, others)
            found["pattern tail peaks"] = _repeated(jnp.maximum(jnp.abs(clipped) - 3, 0), others)
        for axis, of in ((1, "column"), (2, "row")):
            line = plane.sum(axis) / (mask.sum(axis) + 1e-3)
            step = line[:, 1:-1] - 0.5 * (line[:, :-2] + line[:, 2:])
            found[f"pattern {of} {name} repeats"] = _repeated(step, others)
    return found


def _repeated(values: jax.Array, which: jax.Array, plain: float = _PLAIN) -> jax.Array:
    """(N,) correlation with the mean of the others, beyond what is plain its logarithm: a pattern repeats or
    does not; how much of it is seen beside a scene's light and noise is a matter of few pixels."""
    others = jnp.tensordot(which, values, 1, precision="highest")
    axes = tuple(range(1, values.ndim))
    found = (values * others).sum(axes) / (jnp.sqrt((values**2).sum(axes) * (others**2).sum(axes)) + 1e-6)
    return plain * jnp.arcsinh(found / plain)


class Frames(NamedTuple):
    """Which pictures are of one scene.

    Attributes:
        average: (N, N) the mean over the frames of the own scene; zero where there is one only.
        others: (N, N) the mean over the frames of other scenes, or of the own where there is no other.
    """

    average: jax.Array
    others: jax.Array


def frames_of(scenes: Sequence[str]) -> Frames:
    """From the name of the scene of each picture."""
    same = np.equal.outer(scenes, scenes).astype(float)
    average = np.where(same.sum(1, keepdims=True) > 1, same / same.sum(1, keepdims=True), 0)
    others = 1 - same if (same == 0).any() else 1 - np.eye(len(same))
    others = others / np.maximum(others.sum(1, keepdims=True), 1)
    return Frames(jnp.asarray(average, jnp.float32), jnp.asarray(others, jnp.float32))


def features(
    y: jax.Array,
    s: jax.Array,
    mask: jax.Array,
    maps: Sequence[tuple[Maps, ...]],
    frames: Frames,
    seen: Codes,
) -> np.ndarray:
    """(N, F) statistics of pictures (N, h, w, 3) against noise-free ones, all in Y'CbCr in 8-bit steps.

    Args:
        maps: `normalised_regressors` of the pictures.
        frames: where a scene has several, their noise is what each differs in from their mean.
        seen: how to get back to what the sensor read.
    """
    parts = [_mean_part(*own) for own in zip(y, s, mask, maps)]  # compiled once for any N
    means, whole = (jnp.stack(part) for part in zip(*parts))
    noise = _apart(whole, mask, frames.average)
    each = [_noise_part(*own, seen) for own in zip(noise, y, s, mask)]
    others = np.concatenate([np.stack(each), _patterns(whole, s, mask, frames.others)], 1)
    return np.concatenate([means, others[:, _others()[1]]], 1)


def mean_features(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]]
) -> np.ndarray:
    """(N, M) the first of the `features`, those of the mean, alone."""
    return np.stack([_mean_part(*own)[0] for own in zip(y, s, mask, maps)])


@jax.jit
def _noise_part(*arguments: Any) -> jax.Array:
    return jnp.stack([v for _, v in sorted(noise_part(*arguments).items())])


@jax.jit
def _patterns(*arguments: Any) -> jax.Array:
    return jnp.stack([v for _, v in sorted(pattern_part(*arguments).items())], 1)


@jax.jit
def _mean_part(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: tuple[Maps, ...]
) -> tuple[jax.Array, jax.Array]:
    """The amplitudes of one picture's maps, and what a regression on them leaves of its residual."""
    means, left = [], []
    for c, (m, inverse) in enumerate(maps):
        flat = (y - s)[..., c].reshape(-1)
        amplitude = jnp.einsum("kp,p->k", m, flat, precision="highest")
        fitted = jnp.einsum("kp,k->p", m, inverse @ amplitude, precision="highest")
        means.append(amplitude)
        left.append((flat - fitted).reshape(mask.shape))
    return jnp.concatenate(means), jnp.stack(left, -1) * mask[..., None]


@jax.jit
def _apart(whole: jax.Array, mask: jax.Array, average: jax.Array) -> jax.Array:
    """What each picture differs in from the mean of its scene's frames."""
    apart = jnp.eye(len(whole)) - average
    apart = apart / jnp.sqrt((apart**2).sum(1, keepdims=True))
    return jnp.tensordot(apart, whole, 1, precision="highest") * mask[..., None]


@functools.cache
def _others() -> tuple[tuple[str, ...], np.ndarray]:
    """The names of what is no mean, and where each stands in what `_noise_part` and `_patterns` give."""
    shape = jax.ShapeDtypeStruct((32, 32, 3), jnp.float32)
    mask = jax.ShapeDtypeStruct((32, 32), jnp.float32)
    noise = jax.eval_shape(noise_part, shape, shape, shape, mask, unknown_codes((32, 32)))
    many = jax.ShapeDtypeStruct((2, 32, 32, 3), jnp.float32)
    masks, pairs = (jax.ShapeDtypeStruct(n, jnp.float32) for n in ((2, 32, 32), (2, 2)))
    names = np.array([*sorted(noise), *sorted(jax.eval_shape(pattern_part, many, many, masks, pairs))])
    order = np.argsort(names)
    return tuple(map(str, names[order])), order


@functools.cache
def feature_names() -> tuple[str, ...]:
    """In the order of the columns of `features`; "kind axis what"."""
    return *mean_names(), *_others()[0]
