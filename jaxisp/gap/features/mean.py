"""Regressor maps for the mean of the residual, computed from the noise-free picture.

The maps are computed once for each set of pairs. NumPy does this in less time than JAX needs to compile it.
"""

import functools
import itertools
import math
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.arrays.stencils import gaussian_blur
from jaxisp.gap.parallel import parallel_map

CHANNELS = ("Y", "Cb", "Cr")
_LUMA = tuple(255 * k / 7 for k in range(8))
Maps = tuple[jax.Array, jax.Array]
Found = dict[tuple[str, ...], jax.Array]
"""Values (..., K) keyed by their K names. One array for K statistics keeps the compiled program small."""


def named(pattern: str, *parts: Iterable[Any]) -> tuple[str, ...]:
    """Fill the pattern with every combination of the parts; the last part varies fastest."""
    return tuple(pattern.format(*filled) for filled in itertools.product(*parts))


def blurred(stack: jax.Array, sigma: float) -> jax.Array:
    """Gaussian blur of an (h, w, C) image; `sigma` in pixels."""
    return gaussian_blur(stack, sigma, int(np.ceil(3 * sigma)))


def blurred_planes(planes: jax.Array, sigma: float) -> jax.Array:
    """Gaussian blur of (C, h, w) planes; `sigma` in pixels. It takes half the time of `blurred`."""
    return jax.vmap(lambda plane: blurred(plane, sigma))(planes)


def tents(x: jax.Array, knots: tuple[float, ...]) -> list[jax.Array]:
    """Overlapping tent functions of `x`, one centred at each knot; they sum to one everywhere."""
    x = jnp.clip(x, knots[0], knots[-1])
    found = []
    for k, knot in enumerate(knots):
        left, right = knots[max(k - 1, 0)], knots[min(k + 1, len(knots) - 1)]
        up = (x - left) / (knot - left) if k else jnp.inf
        down = (right - x) / (right - knot) if k < len(knots) - 1 else jnp.inf
        found.append(jnp.clip(jnp.minimum(up, down), 0, 1))
    return found


def regressors(s: np.ndarray) -> dict[str, tuple[int, np.ndarray]]:
    """Compute all maps of a noise-free picture (h, w, 3), Y'CbCr in 8-bit steps.

    Returns:
        by "axis name": the index of the channel whose residual is regressed on the map, and the (h, w) map.
    """
    maps: dict[str, tuple[int, np.ndarray]] = {}
    smooth, wide = (_smoothed(s, sigma) for sigma in (0.8, 2.0))
    for c, name in enumerate(CHANNELS):
        maps |= {f"{key} {name} {what}": (c, m) for (key, what), m in _of_channel(s, smooth, wide, c).items()}
    return maps | _of_luma(s[..., 0], smooth[..., 0]) | _of_colour(s)


def _of_channel(
    s: np.ndarray, smooth: np.ndarray, wide: np.ndarray, c: int
) -> dict[tuple[str, str], np.ndarray]:
    h, w = s.shape[:2]
    y = s[..., 0]
    rows, columns = (np.arange(n, dtype=np.float32) - (n - 1) / 2 for n in (h, w))
    corner = np.hypot(rows[-1], columns[-1])
    ry, rx = rows[:, None] / corner, columns[None, :] / corner
    r2 = ry**2 + rx**2
    gy, gx = (np.gradient(smooth, axis=a) for a in (0, 1))
    maps = {("intensity", str(k)): tent for k, tent in enumerate(_tents(y))}
    maps["radius", "gain"] = y * (r2 - r2.mean())
    maps["radius", "gain4"] = y * (r2**2 - 0.9 * r2)
    own = c if c == 0 else 0
    outward = ry * gy[..., own] + rx * gx[..., own]
    maps["edge", "shift"], maps["edge", "shift3"] = outward, outward * r2
    maps["edge", "down"], maps["edge", "right"] = gy[..., own], gx[..., own]
    maps["frequency", "fine"] = s[..., c] - smooth[..., c]
    maps["frequency", "coarse"] = smooth[..., c] - wide[..., c]
    if c:
        maps["frequency", "luma"] = y - smooth[..., 0]
        maps["saturation", "gain"] = s[..., c] * np.hypot(s[..., 1], s[..., 2]) / 64
    odd_row, odd_column = np.arange(h)[:, None] % 2, np.arange(w)[None, :] % 2
    for name, pattern in (("rows", odd_row + 0 * odd_column), ("columns", odd_column + 0 * odd_row),
                          ("checker", (odd_row + odd_column) % 2)):  # fmt: skip
        maps["cfa_phase", name] = y * np.where(pattern, 1, -1).astype(np.float32)
    return maps


def _of_luma(y: np.ndarray, smooth: np.ndarray) -> dict[str, tuple[int, np.ndarray]]:
    mean = _smoothed(y, 14.0)
    maps: dict[str, tuple[int, np.ndarray]] = {}
    for name, (down, across) in (("x", (0, 1)), ("y", (1, 0)), ("down", (1, 1)), ("up", (1, -1))):
        moved = [np.roll(smooth, (i * down, i * across), (0, 1)) for i in (-2, 2)]
        maps[f"orientation {name}"] = 0, smooth - 0.5 * (moved[0] + moved[1])
    # this map responds to halos of one sign: dark on both sides of an edge, or bright on both sides
    maps["edge asymmetry"] = 0, np.abs(y - _smoothed(y, 1.5))
    maps["neighbourhood base"] = 0, y * (mean - mean.mean()) / 255
    maps["neighbourhood detail"] = 0, y - mean
    return maps


def _of_colour(s: np.ndarray) -> dict[str, tuple[int, np.ndarray]]:
    cb, cr = s[..., 1], s[..., 2]
    chroma, hue = np.hypot(cb, cr), np.arctan2(cr, cb + 1e-6)
    maps: dict[str, tuple[int, np.ndarray]] = {}
    for k in range(6):
        sector = np.maximum(np.cos(hue - k * np.pi / 3), 0) ** 4
        for c, name in enumerate(CHANNELS):
            maps[f"hue {k} {name}"] = c, sector * chroma
    return maps


def _smoothed(image: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur of an (h, w) or (h, w, C) image; `sigma` in pixels, borders mirrored."""
    found: np.ndarray = gaussian_filter(image, sigma, mode="mirror", radius=math.ceil(3 * sigma), axes=(0, 1))
    return found


def _tents(luma: np.ndarray) -> list[np.ndarray]:
    """NumPy version of `tents` at the knots `_LUMA`."""
    return [np.interp(luma, _LUMA, tent).astype(np.float32) for tent in np.eye(len(_LUMA))]


def normalised_regressors(s: Any, mask: Any) -> list[tuple[Maps, ...]]:
    """Normalise the maps of each picture and channel.

    Args:
        s: (N, h, w, 3) noise-free pictures, Y'CbCr in 8-bit steps.
        mask: (N, h, w) weight of each pixel.

    Returns:
        for each picture and channel: the (K, h w) maps and a (K, K) matrix. The product of a map with a
        residual is its amplitude [8-bit steps, root mean square]. The matrix turns the amplitudes into
        regression coefficients.
    """
    return parallel_map(lambda pair: _of_picture(*pair), list(zip(np.asarray(s), np.asarray(mask))))


def _of_picture(s: np.ndarray, mask: np.ndarray) -> tuple[Maps, ...]:
    found = sorted(regressors(s).items())
    own = (np.stack([m for _, (c, m) in found if c == channel]) for channel in range(3))
    return tuple(_normalised(maps, mask) for maps in own)


def _normalised(maps: np.ndarray, m: np.ndarray) -> Maps:
    flat = (maps * m).reshape(len(maps), -1)
    gram = (flat @ flat.T).astype(np.float64)
    norm = np.sqrt(np.diag(gram) * m.sum()) + 1e-6
    ridge = 1e-3 / (m.sum() + 1) * np.eye(len(maps))
    inverse = np.linalg.inv(gram / np.outer(norm, norm) + ridge)
    return jnp.asarray(flat / norm[:, None].astype(np.float32)), jnp.asarray(inverse, jnp.float32)


@functools.cache
def mean_names() -> tuple[str, ...]:
    """Names "mean axis map" of all maps, channel by channel, in the order of `normalised_regressors`."""
    channels = {name: c for name, (c, _) in regressors(np.zeros((8, 8, 3), np.float32)).items()}
    return tuple(f"mean {name}" for c in range(3) for name in sorted(channels) if channels[name] == c)
