"""What registration compares: planes of ranks, normalised in each neighbourhood."""

import numpy as np

from jaxisp.color import LUMA_601

SMALLEST = 16  # px of the shorter side
SAMPLE = 100_000  # pixels that are ranked
_COARSE = 384  # px of the longer side where the search starts
_PART = 64  # px of the shorter side that this leaves: a part of a large picture must not be all chance
_FINE = 1024  # px of the longer side where it ends


def luma(name: str, image: np.ndarray) -> np.ndarray:
    array = np.asarray(image, np.float32)
    plane = (array @ np.asarray(LUMA_601, np.float32) if array.ndim == 3 else array).astype(np.float64)
    if min(plane.shape) < SMALLEST:
        raise ValueError(f"{name}: {plane.shape[0]}x{plane.shape[1]} px is too small to be aligned")
    if not np.isfinite(plane).all():
        raise ValueError(f"{name}: holds NaN or infinite values")
    return plane


def factors(*shapes: tuple[int, ...]) -> list[int]:
    """Reductions from the coarsest to the finest that is worth while."""
    longest, shortest = max(n for s in shapes for n in s[:2]), min(n for s in shapes for n in s[:2])
    finest = 1
    while longest // finest > _FINE:
        finest *= 2
    factors = [finest]
    while longest // factors[0] > _COARSE and shortest // factors[0] >= 2 * _PART:
        factors.insert(0, 2 * factors[0])
    return factors


def reduce(plane: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor; what is left over is cut off."""
    h, w = (n // factor for n in plane.shape)
    return plane[: h * factor, : w * factor].reshape(h, factor, w, factor).mean(axis=(1, 3))


def normalise(plane: np.ndarray, radius: int = 8) -> np.ndarray:
    """Zero mean and unit variance in each neighbourhood of the ranks, which no monotone curve changes."""
    ranked = ranks(plane)
    smooth = blur(ranked)
    detail = smooth - box(smooth, radius)
    variance = box(detail**2, radius) + 1e-12
    # of white noise the blur leaves 0.094 times what it takes away; what is all noise counts little
    trust = np.clip(1 - 0.094 * box((ranked - smooth) ** 2, radius) / variance, 0.05, 1)
    deviation = np.sqrt(variance)
    out = trust * detail / (deviation + deviation.mean())
    return out / (out.std() + 1e-9)


def ranks(plane: np.ndarray) -> np.ndarray:
    """The share of pixels that are darker, in (0, 1)."""
    sample = plane.ravel()[:: plane.size // SAMPLE + 1]
    levels, counts = np.unique(sample, return_counts=True)
    return np.interp(plane, levels, (np.cumsum(counts) - 0.5 * counts) / sample.size)


def blur(plane: np.ndarray) -> np.ndarray:
    """Binomial, standard deviation 1 px: keeps interpolation error and noise out of the estimate."""
    for axis in (0, 1):
        padded = np.pad(plane, [(2, 2) if a == axis else (0, 0) for a in (0, 1)], mode="reflect")
        moved = [np.take(padded, np.arange(k, k + plane.shape[axis]), axis) for k in range(5)]
        plane = (moved[0] + moved[4] + 4 * (moved[1] + moved[3]) + 6 * moved[2]) / 16
    return plane


def box(plane: np.ndarray, radius: int) -> np.ndarray:
    """Mean of (2 radius + 1)**2 neighbours, reflected at the border."""
    width = 2 * radius + 1
    for axis in (0, 1):
        padding = [(radius + 1, radius) if a == axis else (0, 0) for a in (0, 1)]
        total = np.cumsum(np.pad(plane, padding, mode="symmetric"), axis=axis)
        n = plane.shape[axis]
        ends, starts = (np.take(total, np.arange(first, first + n), axis) for first in (width, 0))
        plane = (ends - starts) / width
    return plane
