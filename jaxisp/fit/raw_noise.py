"""The noise of a sensor, stated by a RAW file or read off its picture."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import nnls

from jaxisp.cfa import check_bayer
from jaxisp.io.raw import Raw

_BLOCK = 8
_LEVELS = 16
_FLAT_SHARE = 0.2  # of the blocks of one level, the flattest
_FEW = 20  # blocks that make a point of the line
_POINTS = 8  # that make a line
_CLIPPED = 0.95
_MEDIAN = 0.945  # of the variances of flat blocks of white noise, over their mean: as 30 simulations have it
# Knows no plane, and is of unit norm (Immerkaer 1996).
_DETAIL = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6


class RawNoise(NamedTuple):
    """Noise as light falls on the sensor, and the gains of R, G, B that then balance it.

    Args:
        shot: variance per unit of light.
        read: standard deviation in the dark.
        gains: the white balance as shot, green 1.
        measured: read off the picture, as the file states nothing.
    """

    shot: float
    read: float
    gains: tuple[float, float, float]
    measured: bool


def raw_noise(raw: Raw) -> RawNoise | None:
    """What the file states of its green photosites, else what its picture shows; None where it shows nothing.

    A file that was balanced before it was written has its gains in its noise: light of one sensor that
    was multiplied by g has g times the variance for the same level.
    """
    stated = raw.noise_profile
    gains = np.asarray(raw.white_balance, float)
    if stated is None:
        found = estimate_raw_noise(raw.mosaic, raw.cfa)
        if found is None:
            return None
        shot, read = found[1]
        if raw.white_balanced:
            gains = np.clip(found[:, 0] / shot, 0.125, 8.0) if (found[:, 0] > 0).all() else np.ones(3)
    else:
        shot, read = stated[1]
    r, g, b = (float(v) for v in gains)
    return RawNoise(float(shot), float(read), (r, g, b), stated is None)


def estimate_raw_noise(mosaic: np.ndarray, cfa: str) -> np.ndarray | None:
    """Variance against light of R, G and B, from the flat parts of one picture.

    Each colour's photosites are pictures of their own. Their second difference in both directions knows
    no plane, so that its mean square over a block is the variance of the noise where the picture is flat;
    flat is what hardly changes once smoothed, so that noise does not choose its own blocks. The median of
    the blocks of one level is a point; points far above the line through all (texture) are left out.

    Args:
        mosaic: (H, W) linear light, black is 0 and white is 1, negative values kept.
        cfa: Bayer pattern from the top-left, such as "RGGB".

    Returns:
        (3, 2): shot and read of R, G and B in `variance = shot * x + read**2`; None where the picture
        is smaller than some 450x450 pixels or clipped. An upper bound where all of it is textured.

    Raises:
        ValueError: unknown pattern, not (H, W), or not finite.

    Source: Foi et al. 2008, "Practical Poissonian-Gaussian noise modeling and fitting for single-image
    raw-data"; the operator is that of Immerkaer 1996, "Fast noise variance estimation".
    """
    check_bayer(cfa)
    if mosaic.ndim != 2 or not np.isfinite(mosaic).all():
        raise ValueError(f"expected an (H, W) mosaic of finite values, got {mosaic.shape}")
    found = []
    for colour in "RGB":
        planes = [mosaic[i // 2 :: 2, i % 2 :: 2] for i, c in enumerate(cfa) if c == colour]
        points = np.concatenate([_flat_blocks(np.asarray(plane, np.float32)) for plane in planes], axis=1)
        if points.shape[1] < _POINTS * _FEW:
            return None
        found.append(_line(*points))
    return np.asarray(found)


def _flat_blocks(plane: np.ndarray) -> np.ndarray:
    """(2, N): level and variance."""
    smooth = ndimage.gaussian_filter(plane, 3.0)
    variance = (_blocks(ndimage.convolve(plane, _DETAIL)) ** 2).mean(-1)
    level, change = _blocks(smooth).mean(-1), np.ptp(_blocks(smooth), -1)
    own = _blocks(plane)
    seen = (own.max(-1) < _CLIPPED) & ((own == 0).mean(-1) < 0.1)  # not clipped at white, nor at black
    level, variance, change = level[seen], variance[seen], change[seen]
    parts = np.array_split(np.argsort(level), _LEVELS)
    flat = [part[change[part] <= np.quantile(change[part], _FLAT_SHARE)] for part in parts if part.size]
    kept = np.concatenate([np.zeros(0, int), *flat])
    return np.stack([level[kept], variance[kept]])


def _blocks(plane: np.ndarray) -> np.ndarray:
    """(N, 64)."""
    h, w = (n // _BLOCK for n in plane.shape)
    cut = plane[: h * _BLOCK, : w * _BLOCK].reshape(h, _BLOCK, w, _BLOCK)
    return cut.swapaxes(1, 2).reshape(h * w, _BLOCK * _BLOCK)


def _line(level: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Shot and read of the line through the medians of levels, their errors a share of their size."""
    groups = np.array_split(np.argsort(level), min(_LEVELS, level.size // _FEW))
    light = np.asarray([max(level[g].mean(), 0.0) for g in groups])
    height = np.asarray([np.median(variance[g]) for g in groups]) / _MEDIAN
    scale = height = np.maximum(height, 1e-12)
    kept = np.ones(len(groups), bool)
    for _ in range(4):
        terms = np.stack([light, np.ones_like(light)], axis=1) / scale[:, None]
        (shot, square), _ = nnls(terms[kept], (height / scale)[kept])
        scale = np.maximum(shot * light + square, 1e-12)
        kept = height / scale < 1.5 * np.median(height / scale)
    return float(shot), float(np.sqrt(square))
