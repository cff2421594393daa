"""Profiles: how the residual changes along each axis, in a few bins."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from jaxisp.gap.axes import pixel_features
from jaxisp.gap.axes.pixel_features import CHROMA, LAGS, LUMA, POLAR_AXES, RADII, SECTORS, STRENGTHS, Scene

PLAIN = ("Y", "Cb", "Cr")
POLAR = ("Y", "along chroma", "across chroma")
_AROUND = np.arange(-60, 61, 15)
_DIRECTIONS = {"horizontal": (0, 1), "falling": (1, 1), "vertical": (1, 0), "rising": (1, -1)}
_BANDS = ("< 3 px", "3 to 5 px", "5 to 9 px", "9 to 17 px", "> 17 px")
_SIGMAS = (2, 3, 4, 5)


class Profiles:
    """Sums for the profile of each axis, accumulated scene by scene.

    Args:
        period: of the colour filter array [px].
    """

    def __init__(self, period: int) -> None:
        self._period = period
        self._sums: dict[str, Any] = {}
        self._labels: dict[str, list[Any]] = {
            "radius": [round((i + 0.5) / RADII, 4) for i in range(RADII)],
            "intensity": [float(a + b) / 2 for a, b in pairwise(LUMA)],
            "hue": [360 / SECTORS * (i + 0.5) for i in range(SECTORS)],
            "saturation": [float(a) for a in CHROMA[:-1]],
            "cfa_phase": [f"{y},{x}" for y in range(period) for x in range(period)],
            "block_phase": [f"{y},{x}" for y in range(8) for x in range(8)],
            "edge": list(STRENGTHS[:-1]),
            "neighbourhood": [float(a) for a in _AROUND],
            "frequency": list(_BANDS),
            "orientation": list(_DIRECTIONS),
            "channel": list(PLAIN),
            "lag": [f"{dy},{dx}" for dy, dx in LAGS],
            "tail": list(_SIGMAS),
        }
        self._scenes = 0

    def add(
        self,
        s: Scene,
        residual: np.ndarray,
        polar: np.ndarray,
        detail: np.ndarray,
        weight: np.ndarray,
        flat: np.ndarray,
    ) -> None:
        """Add one scene.

        Args:
            s: the scene.
            residual: (h, w, 3) Y'CbCr in 8-bit steps.
            polar: (h, w, 3) the residual with chroma in polar form, see `Scene.polar`.
            detail: (h, w, 3) the residual minus its mean 4 to 6 px away.
            weight: (h, w) weight of each pixel.
            flat: (h, w) weight of each pixel in flat areas, 0 elsewhere.
        """
        if not self._scenes:
            self._labels |= {"row": list(range(len(weight))), "column": list(range(weight.shape[1]))}
        self._scenes += 1
        for axis, index in self._indices(s).items():
            target = polar if axis in POLAR_AXES else residual
            self._add(axis, _by_bin(index, target, weight, len(self._labels[axis])))
        self._add("frequency", _band_energies(residual, weight))
        self._add("channel", np.concatenate([(residual**2 * weight[..., None]).sum((0, 1)), [weight.sum()]]))
        steps = [residual - _moved(residual, d) for d in _DIRECTIONS.values()]
        self._add("orientation", np.stack([(d**2 * weight[..., None]).sum((0, 1)) for d in steps]))
        lagged = [(detail * _moved(detail, d) * flat[..., None]).sum((0, 1)) for d in ((0, 0), *LAGS)]
        self._add("lag", np.stack(lagged))
        self._add("tail", _beyond(detail, flat))

    def add_frames(self, labels: Sequence[str], means: np.ndarray) -> None:
        """Add all frames: their labels (N,) and mean residuals (N, 3) in 8-bit steps."""
        self._labels["frame"] = list(labels)
        self._add("frame", np.concatenate([means, means**2, np.ones((len(means), 1))], 1))

    def _add(self, axis: str, sums: np.ndarray) -> None:
        self._sums[axis] = self._sums.get(axis, 0) + sums.astype(np.float64)

    def _indices(self, s: Scene) -> dict[str, np.ndarray]:
        period = self._period
        around = pixel_features.box(s.luma, 8) - s.luma
        return {
            "radius": np.minimum((s.radius * RADII).astype(int), RADII - 1),
            "row": s.rows,
            "column": s.columns,
            "intensity": np.digitize(s.luma, LUMA[1:-1]),
            "hue": s.sector,
            "saturation": np.digitize(s.chroma, CHROMA[1:-1]),
            "cfa_phase": s.rows % period * period + s.columns % period,
            "block_phase": s.rows % 8 * 8 + s.columns % 8,
            "edge": np.digitize(s.edge, STRENGTHS[1:-1]),
            "neighbourhood": np.clip(np.rint(around / 15).astype(int) + 4, 0, 8),
        }

    def of(self, axis: str, shares: np.ndarray) -> dict[str, Any]:
        """The profile of an axis, for the channel with the largest of the shares (3,).

        Returns:
            `bins`, `profile`, `unit` and `channel`; `channels` holds the share of each channel.
        """
        names = POLAR if axis in POLAR_AXES else PLAIN
        channel = int(np.argmax(shares))
        values, unit = self._values(axis, channel)
        return {
            "bins": self._labels.get(axis, []) if len(values) else [],
            "profile": [round(float(v), 5) for v in values],
            "unit": unit,
            "channel": names[channel],
            "channels": {n: round(float(s), 5) for n, s in zip(names, shares)},
        }

    def _values(self, axis: str, channel: int) -> tuple[np.ndarray, str]:
        sums = self._sums.get(axis)
        if sums is None:
            return np.zeros(0), ""
        if axis == "channel":
            return np.sqrt(sums[:3] / max(sums[3], 1e-9)), "rms, steps"
        if axis in ("frequency", "orientation"):
            return sums[:, channel] / max(sums[:, channel].sum(), 1e-9), "share of energy"
        if axis == "lag":
            return sums[1:, channel] / max(sums[0, channel], 1e-9), "correlation"
        if axis == "tail":
            return sums[:-1, channel] / max(sums[-1, channel], 1e-9), "share of samples beyond"
        count = np.maximum(sums[:, 6], 1e-9)
        if axis == "edge":
            return np.sqrt(sums[:, 3 + channel] / count), "rms, steps"
        return sums[:, channel] / count, "mean, steps"


def _by_bin(index: np.ndarray, target: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, 7) by bin: weighted values of 3 channels, their weighted squares, and the weight."""
    flat, w = index.ravel(), weight.ravel()
    values = target.reshape(-1, 3)
    columns = [values[:, c] * w for c in range(3)] + [values[:, c] ** 2 * w for c in range(3)] + [w]
    return np.stack([np.bincount(flat, v, count) for v in columns], -1)


def _moved(a: np.ndarray, by: tuple[int, int]) -> np.ndarray:
    return np.stack([pixel_features.shifted(a[..., c], *by) for c in range(3)], -1)


def _band_energies(residual: np.ndarray, weight: np.ndarray) -> np.ndarray:
    smooth = [residual]
    smooth += [
        np.stack([pixel_features.box(residual[..., c], r) for c in range(3)], -1) for r in (1, 2, 4, 8)
    ]
    bands = [a - b for a, b in pairwise(smooth)] + [smooth[-1]]
    return np.stack([(b**2 * weight[..., None]).sum((0, 1)) for b in bands])


def _beyond(detail: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Number of samples (5, 3) beyond 2, 3, 4 and 5 robust standard deviations, and of all samples."""
    values = np.abs(detail[flat > 0.5])
    if not len(values):
        return np.zeros((len(_SIGMAS) + 1, 3))
    scale = np.maximum(1.4826 * np.median(values, 0), 0.3)
    return np.stack([*((values > k * scale).sum(0) for k in _SIGMAS), np.full(3, len(values))])
