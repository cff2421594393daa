"""The reference phone's own demosaickers and denoisers, in NumPy: none of the simulator's code."""

from typing import Any

import numpy as np

LUMA = np.array([0.25, 0.5, 0.25])


def color_filters(shape: tuple[int, ...], cfa: str) -> np.ndarray:
    """(H, W, 3) of 0 and 1: the colour of each photosite."""
    cell = np.eye(3)[["RGB".index(c) for c in cfa]].reshape(2, 2, 3)
    h, w = shape[:2]
    return np.tile(cell, (h // 2 + 1, w // 2 + 1, 1))[:h, :w]


def _correlate(plane: np.ndarray, kernel: Any) -> np.ndarray:
    kernel = np.asarray(kernel, float)
    ry, rx = kernel.shape[0] // 2, kernel.shape[1] // 2
    padded = np.pad(plane, ((ry, ry), (rx, rx)), mode="reflect")
    h, w = plane.shape
    out = np.zeros((h, w))
    for (i, j), weight in np.ndenumerate(kernel):
        if weight:
            out += weight * padded[i : i + h, j : j + w]
    return out


def _spread(plane: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Weighted means of the masked neighbours, for every pixel."""
    kernel = np.outer([1, 2, 1], [1, 2, 1])
    return np.where(mask > 0, plane, _correlate(plane * mask, kernel) / _correlate(mask, kernel))


def _bilinear(raw: np.ndarray, filters: np.ndarray) -> np.ndarray:
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4
    green = np.where(filters[..., 1] > 0, raw, _correlate(raw, cross))
    return np.stack([_spread(raw, filters[..., 0]), green, _spread(raw, filters[..., 2])], -1)


def _gradient_corrected(raw: np.ndarray, filters: np.ndarray) -> np.ndarray:
    """Green from its neighbours plus the curvature of the pixel's own colour; red and blue as differences."""
    line = np.array([-1, 2, 4, 2, -1]) / 8
    cross = np.zeros((5, 5))
    cross[2], cross[:, 2] = line, line
    return _differences(raw, np.where(filters[..., 1] > 0, raw, _correlate(raw, cross)), filters)


def _directional(raw: np.ndarray, filters: np.ndarray) -> np.ndarray:
    """Green along the direction that changes less (Hamilton & Adams 1997); red and blue as differences."""
    mean, bend = np.array([[0, 1, 0, 1, 0]]) / 2, np.array([[-1, 0, 2, 0, -1]]) / 4
    step = np.array([[0, 1, 0, -1, 0]])
    means, steps, bends = ([_correlate(raw, k), _correlate(raw, k.T)] for k in (mean, step, bend))
    across, down = (m + b for m, b in zip(means, bends))
    change_x, change_y = (abs(s) + abs(4 * b) for s, b in zip(steps, bends))
    directed = np.where(change_x < change_y, across, down)
    green = np.where(np.isclose(change_x, change_y), (across + down) / 2, directed)
    return _differences(raw, np.where(filters[..., 1] > 0, raw, green), filters)


def _differences(raw: np.ndarray, green: np.ndarray, filters: np.ndarray) -> np.ndarray:
    red, blue = (green + _spread(raw - green, filters[..., c]) for c in (0, 2))
    return np.stack([red, green, blue], -1)


DEMOSAICKERS = {"bilinear": _bilinear, "gradient": _gradient_corrected, "directional": _directional}


def denoise(camera: np.ndarray, luma_filter: str, strength: float, chroma_sigma: float) -> np.ndarray:
    """Luma by a filter of `LUMA_FILTERS` and chroma by a blur, on square roots, where shot noise is even."""
    rooted = np.sqrt(np.clip(camera, 0, None))
    luma = rooted @ LUMA
    chroma = [gaussian(rooted[..., c] - luma, chroma_sigma) for c in (0, 2)]
    luma = LUMA_FILTERS[luma_filter](luma, strength)
    red, blue = luma + chroma[0], luma + chroma[1]
    green = (luma - LUMA[0] * red - LUMA[2] * blue) / LUMA[1]
    return np.clip(np.stack([red, green, blue], -1), 0, None) ** 2


def gaussian(plane: np.ndarray, sigma: float) -> np.ndarray:
    radius = int(np.ceil(3 * sigma))
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)[None]
    taps = taps / taps.sum()
    return _correlate(_correlate(plane, taps), taps.T)


def _bilateral(plane: np.ndarray, strength: float) -> np.ndarray:
    """Means of 5x5 neighbours that differ by little."""
    total, weights = np.zeros_like(plane), np.zeros_like(plane)
    for i, j in np.ndindex(5, 5):
        moved = np.pad(plane, 2, mode="reflect")[i : i + plane.shape[0], j : j + plane.shape[1]]
        near = np.exp(-((i - 2) ** 2 + (j - 2) ** 2) / 4.5)
        weight = near / (1 + ((moved - plane) / strength) ** 2) ** 2
        total, weights = total + weight * moved, weights + weight
    return total / weights


def _wiener(plane: np.ndarray, strength: float) -> np.ndarray:
    """Local linear estimate: what varies less than `strength` is averaged."""
    box = np.full((5, 5), 1 / 25)
    mean = _correlate(plane, box)
    variance = np.clip(_correlate(plane**2, box) - mean**2, 1e-12, None)
    return mean + np.clip(1 - strength**2 / variance, 0, 1) * (plane - mean)


LUMA_FILTERS = {"bilateral": _bilateral, "wiener": _wiener, "gaussian": gaussian}
