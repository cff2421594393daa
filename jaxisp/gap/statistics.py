"""Clean+noisy pairs: numbers that say how a real picture's residual differs from a simulated one's.

Pixels of two noise realisations never agree, so statistics of the residual are compared: what its mean
follows (light, radius, edges, hue ...), and how its noise is spread, correlated, shaped and repeated.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.windows import gaussian_blur

LUMA_BINS = 8
_CHANNELS = ("Y", "Cb", "Cr")
MEAN_TOLERANCE = 0.35
"""Mean errors of so many 8-bit steps are taken for a harmless mismatch; of logarithms and correlations, see
`TOLERANCES`."""
TOLERANCES = {"logvar": 0.08, "corr": 0.02, "pattern": 0.02, "tail": 0.08, "comb": 0.02}


def _blur(stack: jax.Array, sigma: float) -> jax.Array:
    """(h, w, C)."""
    radius = int(np.ceil(3 * sigma))
    return jnp.stack([gaussian_blur(stack[..., c], sigma, radius) for c in range(stack.shape[-1])], -1)


def _tents(x: jax.Array, count: int) -> list[jax.Array]:
    """Partition of [0, 1] into `count` overlapping tents."""
    at = jnp.clip(x, 0, 1) * (count - 1)
    return [jnp.maximum(1 - jnp.abs(at - k), 0) for k in range(count)]


def regressors(s: jax.Array) -> dict[str, tuple[int, jax.Array]]:
    """What the mean residual may follow, computed from the noise-free picture (h, w, 3) in steps: the channel
    it is looked for in, and the map, by "axis name"."""
    h, w = s.shape[:2]
    y = s[..., 0]
    rows, columns = (jnp.arange(n) - (n - 1) / 2 for n in (h, w))
    corner = jnp.hypot(rows[-1], columns[-1])
    ry, rx = rows[:, None] / corner, columns[None, :] / corner
    r2 = ry**2 + rx**2
    smooth = _blur(s, 0.8)
    gy, gx = jnp.asarray(jnp.gradient(smooth, axis=0)), jnp.asarray(jnp.gradient(smooth, axis=1))
    wide = _blur(s, 2.0)
    mean = gaussian_blur(y, 14.0, 42)
    maps: dict[str, tuple[int, jax.Array]] = {}
    for c, name in enumerate(_CHANNELS):
        for k, tent in enumerate(_tents(y / 255, LUMA_BINS)):
            maps[f"intensity {name}{k}"] = c, tent
        maps[f"radius {name} gain"] = c, y * (r2 - r2.mean())
        maps[f"radius {name} gain4"] = c, y * (r2**2 - 0.9 * r2)
        own, luma = ry * gy[..., c] + rx * gx[..., c], ry * gy[..., 0] + rx * gx[..., 0]
        maps[f"edge {name} shift"] = c, own if c == 0 else luma
        maps[f"edge {name} shift3"] = c, (own if c == 0 else luma) * r2
        maps[f"frequency {name} fine"] = c, s[..., c] - smooth[..., c]
        maps[f"frequency {name} coarse"] = c, smooth[..., c] - wide[..., c]
    for name, kernel in (("x", (0, 1)), ("y", (1, 0)), ("down", (1, 1)), ("up", (1, -1))):
        moved = [jnp.roll(smooth[..., 0], (i * kernel[0], i * kernel[1]), (0, 1)) for i in (-2, 2)]
        maps[f"orientation {name}"] = 0, smooth[..., 0] - 0.5 * (moved[0] + moved[1])
    maps["neighbourhood base"] = 0, y * (mean - mean.mean()) / 255
    maps["neighbourhood detail"] = 0, y - mean
    cb, cr = s[..., 1], s[..., 2]
    chroma, hue = jnp.hypot(cb, cr), jnp.arctan2(cr, cb + 1e-6)
    for k in range(6):
        sector = jnp.maximum(jnp.cos(hue - k * jnp.pi / 3), 0) ** 4
        maps[f"hue {k} Cb"] = 1, sector * chroma
        maps[f"hue {k} Cr"] = 2, sector * chroma
        maps[f"hue {k} Y"] = 0, sector * chroma
    odd_row, odd_column = jnp.arange(h)[:, None] % 2, jnp.arange(w)[None, :] % 2
    for name, pattern in (("rows", odd_row + 0 * odd_column), ("columns", odd_column + 0 * odd_row),
                          ("checker", (odd_row + odd_column) % 2)):  # fmt: skip
        maps[f"cfa_phase {name}"] = 0, y * (2.0 * pattern - 1)
    return maps


@functools.partial(jax.jit, static_argnums=2)
def normalised_regressors(s: jax.Array, mask: jax.Array, channel: int) -> jax.Array:
    """(N, K, h w) the regressors of one channel of noise-free pictures (N, h, w, 3), scaled so that their
    product with a residual is its amplitude [8-bit steps, root mean square]."""

    def one(pair: Any) -> jax.Array:
        picture, m = pair
        found = regressors(picture)
        maps = jnp.stack([v * m for _, (c, v) in sorted(found.items()) if c == channel])
        norm = jnp.sqrt((maps**2).sum((1, 2)) * m.sum()) + 1e-6
        return (maps / norm[:, None, None]).reshape(len(maps), -1)

    return jax.lax.map(one, (s, mask))


def _log_mean(values: jax.Array, weight: jax.Array, least: float = 0.02) -> jax.Array:
    return jnp.log((values * weight).sum() / (weight.sum() + 1e-6) + least)


def noise_part(r: jax.Array, y: jax.Array, s: jax.Array, mask: jax.Array) -> dict[str, jax.Array]:
    """Spread, spectrum, correlation, tails and grid of the residual's noise."""
    found: dict[str, jax.Array] = {}
    smooth = _blur(s, 1.0)
    steps = [jnp.asarray(jnp.gradient(smooth[..., 0], axis=a)) for a in (0, 1)]
    activity = gaussian_blur(jnp.hypot(steps[0], steps[1]), 2.0, 6)
    flat = mask / (1 + (activity / 2.0) ** 2) ** 2
    bands = [r - _blur(r, 1.0), _blur(r, 1.0) - _blur(r, 2.5), _blur(r, 2.5) - _blur(r, 6.0)]
    high = r - bands[2] - _blur(r, 6.0)
    for c, name in enumerate(_CHANNELS):
        for k, tent in enumerate(_tents(s[..., 0] / 255, 5)):
            found[f"logvar intensity {name}{k}"] = _log_mean(high[..., c] ** 2, flat * tent)
        for k, band in enumerate(bands):
            found[f"logvar frequency {name}{k}"] = _log_mean(band[..., c] ** 2, flat)
        found[f"logvar edge {name}"] = _log_mean(high[..., c] ** 2, mask - flat)
        lags = ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0)) if c == 0 else ((0, 1), (1, 0), (0, 2), (2, 0))
        power = (high[..., c] ** 2 * flat).sum()
        for lag in lags:
            moved = jnp.roll(high[..., c], lag, (0, 1))
            found[f"corr lag {name}{lag}"] = (high[..., c] * moved * flat).sum() / (power + 1e-3)
        for axis, of in ((1, "row"), (0, "column")):
            line = (r[..., c] * flat).sum(axis) / (flat.sum(axis) + 1e-3)
            step = line[1:-1] - 0.5 * (line[:-2] + line[2:])
            found[f"logvar {of} {name}"] = jnp.log((step**2).mean() + 2e-4)
    luma = high[..., 0]
    local = gaussian_blur(luma**2 * flat, 4.0, 12) / (gaussian_blur(flat, 4.0, 12) + 1e-3)
    for name, part in (("dark", s[..., 0] < 90), ("bright", s[..., 0] >= 90)):
        weight = flat * part
        total = weight.sum() + 1e-3
        variance = (luma**2 * weight).sum() / total + 0.02
        z = luma / jnp.sqrt(variance)
        found[f"tail kurtosis {name}"] = jnp.log((z**4 * weight).sum() / total + 0.1)
        found[f"tail skew {name}"] = 0.5 * (jnp.clip(z, -6, 6) ** 3 * weight).sum() / total
        for sign, side in ((1, "high"), (-1, "low")):
            far = jax.nn.sigmoid(4 * (sign * luma / jnp.sqrt(local + 0.05 * variance) - 4.5))
            found[f"tail {side} {name}"] = 0.5 * jnp.log1p(1e4 * (far * weight).sum() / total)
        still = jnp.exp(-(((y[..., 0] - jnp.roll(y[..., 0], 1, 1)) / 0.7) ** 2))
        found[f"comb intensity {name}"] = (still * weight).sum() / total
    for axis, of in ((1, "columns"), (0, "rows")):
        jump = (jnp.abs(y[..., 0] - jnp.roll(y[..., 0], 1, axis)) * flat).sum(1 - axis)
        by_phase = jnp.stack([jump[k::8].mean() for k in range(8)])
        for k in range(8):
            found[f"logvar block_phase {of}{k}"] = jnp.log(by_phase[k] / (by_phase.mean() + 1e-3) + 0.1)
    overall = (luma**2 * flat).sum() / (flat.sum() + 1e-3) + 0.02
    for a in (0, 1):
        for b in (0, 1):
            part, weight = luma[a::2, b::2], flat[a::2, b::2]
            found[f"logvar cfa_phase {a}{b}"] = jnp.log(
                ((part**2 * weight).sum() / (weight.sum() + 1e-3) + 0.02) / overall
            )
    return found


def pattern_part(r: jax.Array, s: jax.Array, mask: jax.Array) -> dict[str, jax.Array]:
    """(N,) each: how a pair's residual repeats in the others of the set, pixel by pixel and line by line."""
    luma = r[..., 0] * mask
    smooth = jnp.stack([gaussian_blur(v, 1.5, 5) for v in luma])
    light = s[..., 0] / 255
    found: dict[str, jax.Array] = {}

    def repeated(values: jax.Array) -> jax.Array:
        others = (values.sum(0) - values) / max(len(values) - 1, 1)
        axes = tuple(range(1, values.ndim))
        norm = jnp.sqrt((values**2).sum(axes) * (others**2).sum(axes)) + 1e-6
        return (values * others).sum(axes) / norm

    high = luma - smooth
    clipped = jnp.clip(high / (jnp.sqrt((high**2).mean((1, 2), keepdims=True)) + 0.1), -4, 4)
    found["pattern fixed_pattern pixel"] = repeated(clipped)
    found["pattern fixed_pattern bright"] = repeated(clipped * light)
    found["pattern tail peaks"] = repeated(jnp.maximum(jnp.abs(clipped) - 3, 0))
    for axis, name in ((1, "column"), (2, "row")):
        line = luma.sum(axis) / (mask.sum(axis) + 1e-3)
        found[f"pattern {name} repeats"] = repeated(line[:, 1:-1] - 0.5 * (line[:, :-2] + line[:, 2:]))
    return found


@jax.jit
def features(y: jax.Array, s: jax.Array, mask: jax.Array, maps: tuple[jax.Array, ...]) -> jax.Array:
    """(N, F) statistics of pictures (N, h, w, 3) against noise-free ones, all in Y'CbCr in 8-bit steps.

    Args:
        maps: `normalised_regressors` of each channel.
    """
    r = y - s
    flat = r.reshape(len(r), -1, 3)
    means = [jnp.einsum("nkp,np->nk", m, flat[..., c], precision="highest") for c, m in enumerate(maps)]

    def one(pair: Any) -> dict[str, jax.Array]:
        picture, noise_free, m = pair
        return noise_part(picture - noise_free, picture, noise_free, m)

    found = jax.lax.map(one, (y, s, mask)) | pattern_part(r, s, mask)
    return jnp.concatenate([*means, jnp.stack([found[name] for name in sorted(found)], 1)], 1)


@functools.cache
def feature_names() -> tuple[str, ...]:
    """In the order of the columns of `features`; "kind axis what"."""
    shape = jax.ShapeDtypeStruct((32, 32, 3), jnp.float32)
    mask = jax.ShapeDtypeStruct((32, 32), jnp.float32)
    channels: dict[str, int] = {}

    def noted(p: jax.Array) -> jax.Array:
        channels.update({name: c for name, (c, _) in regressors(p).items()})
        return p

    jax.eval_shape(noted, shape)
    means = [f"mean {name}" for c in range(3) for name in sorted(channels) if channels[name] == c]
    noise = jax.eval_shape(lambda p, s, m: noise_part(p - s, p, s, m), shape, shape, mask)
    many = jax.ShapeDtypeStruct((2, 32, 32, 3), jnp.float32)
    patterns = jax.eval_shape(pattern_part, many, many, jax.ShapeDtypeStruct((2, 32, 32), jnp.float32))
    return (*means, *sorted({*noise, *patterns}))


def tolerances() -> np.ndarray:
    """(F,) the differences that are taken for harmless."""
    kinds = [name.split()[0] for name in feature_names()]
    return np.array([MEAN_TOLERANCE if k == "mean" else TOLERANCES[k] for k in kinds])
