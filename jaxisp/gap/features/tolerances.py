"""The tolerance of each statistic (the difference that is harmless) and its weight in the gap."""

import functools
from collections.abc import Sequence

import numpy as np

from jaxisp.gap.features.residual_statistics import feature_names

TOLERANCES: dict[str, float] = {
    "mean cfa_phase": 0.04, "mean edge": 0.06, "mean frequency": 0.5, "mean hue": 0.3,
    "mean intensity": 0.2, "mean neighbourhood": 0.15, "mean orientation": 0.12, "mean radius": 0.1,
    "mean saturation": 0.12, "comb block_phase": 0.025, "comb intensity": 0.015, "corr channel": 0.03,
    "corr lag": 0.05, "corr row": 0.04, "corr column": 0.04, "logvar block_phase": 0.03,
    "logvar cfa_phase": 0.05, "logvar edge": 0.06, "logvar frequency": 0.08, "logvar intensity": 0.16,
    "logvar radius": 0.05, "pattern row": 0.02, "pattern column": 0.02, "pattern fixed_pattern": 0.006,
    "pattern tail": 0.01, "tail tail": 0.12, "code intensity": 0.03, "levels intensity": 0.03,
    "corr orientation": 0.03, "coarse fixed_pattern": 0.03, "change frame": 0.1,
}  # fmt: skip
"""Tolerances: differences of cameras that lack no effect, averaged over pairs, with chance subtracted.

Means and changes are in 8-bit steps; the others are logarithms or correlations. docs/diagnosis.md describes
the cameras."""

_SHARED = ("pattern", "coarse", "change")  # these statistics compare a picture with other scenes or frames
_ABSENT = 1e-12
"""Weight of statistics that the pictures cannot show. It is above 0 because units are divided by it."""
_MOST = 30.0
"""Upper limit of `emphasis`."""


def axis_of(name: str) -> str:
    """The axis (second word) of a statistic's name."""
    return name.split()[1]


def group_of(name: str) -> str:
    """The group of a statistic. All groups have the same total weight.

    A group holds the statistics of one axis; statistics of the mean and of the noise have separate groups.
    """
    kind, axis = name.split()[:2]
    return f"{kind} {axis}" if kind in ("mean", "code", "comb", "levels") else f"noise {axis}"


@functools.cache
def tolerances() -> np.ndarray:
    """Tolerance (F,) of each statistic, in its own unit."""
    return np.array([_tolerance(name) for name in feature_names()])


def _tolerance(name: str) -> float:
    return TOLERANCES[" ".join(name.split()[:2])]


@functools.cache
def repeats() -> np.ndarray:
    """Variance (F,) of the mean over pairs, relative to independent pairs.

    It is 2 for statistics that compare two pairs, since each comparison enters both pairs.
    """
    return np.array([2.0 if name.startswith(_SHARED) else 1.0 for name in feature_names()])


@functools.cache
def noise_only() -> np.ndarray:
    """Indicator (F,): 1 for statistics of the noise, 0 for statistics of the mean."""
    return np.array([float(not name.startswith("mean")) for name in feature_names()])


@functools.cache
def by_place() -> np.ndarray:
    """Indicator (F,): 1 for noise statistics that a quarter of a frame can show; spots are too large."""
    spots = np.array([name.startswith("coarse") for name in feature_names()])
    return noise_only() * ~spots


@functools.cache
def of_few_pixels() -> np.ndarray:
    """Indicator (F,): 1 for statistics that few pixels dominate: tails and repeated patterns."""
    return np.array([float(name.startswith(("tail", "pattern"))) for name in feature_names()])


def _by_group(values: np.ndarray) -> np.ndarray:
    """Replace each of the values (..., F) by the mean over its group."""
    groups = np.array([group_of(name) for name in feature_names()])
    found = np.empty_like(values)
    for group in set(groups):
        own = groups == group
        found[..., own] = values[..., own].mean(-1, keepdims=True)
    return found


def units(scatter: np.ndarray, uneven: np.ndarray) -> np.ndarray:
    """Squared unit (N, F) in which the difference of each statistic is measured.

    Args:
        scatter: (N, F) chance variance of the mean over a half of the pairs.
        uneven: (N, F) the same variance, estimated from differences between quarters of the frame. The
            estimate is rough, so its mean over a group is used, except for statistics of `of_few_pixels`.
    """
    squares = tolerances() ** 2 + scatter
    few = np.maximum(squares, uneven * of_few_pixels())
    return np.asarray(few * np.maximum(_by_group(uneven / squares), 1.0))


def emphasis(squares: np.ndarray) -> np.ndarray:
    """Factor on a statistic's weight, from its squared difference in units; clipped to [1, `_MOST`]."""
    return np.asarray(np.clip(squares, 1.0, _MOST))


def emphasised(plain: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Weights (F,) of mean one that favour statistics with large differences.

    Without this, one large difference would vanish among many small ones.

    Args:
        plain: (F,) `weights`.
        more: (F,) `emphasis` of the differences on the fitted pairs.
    """
    found = plain * more
    return np.asarray(found / found.mean())


@functools.cache
def weights(repeated: bool = False) -> np.ndarray:
    """Weights (F,) of mean one, with the same total for each group.

    Args:
        repeated: whether any scene has several frames. If not, changes between frames do not count.
    """
    groups = [group_of(name) for name in feature_names()]
    counts = {g: groups.count(g) for g in groups}
    if not repeated:
        del counts["noise frame"]
    return np.array([len(groups) / (len(counts) * counts[g]) if g in counts else _ABSENT for g in groups])


def present(weights: np.ndarray) -> np.ndarray:
    """Mask (F,) bool of the statistics that the pictures can show; `weights` may be emphasised."""
    return weights > 1e3 * _ABSENT


def left_by_shift(
    apart: np.ndarray, scale: np.ndarray, weights: np.ndarray, fit: Sequence[int], held: Sequence[int]
) -> float:
    """The held-out gap after a constant shift of each statistic.

    The shift is the mean difference of the fitted pairs, shrunk by chance and tolerance (the positive-part
    estimator of James and Stein 1961).

    Args:
        apart: (N, F) differences in units.
        scale: (N, F) factors that turned differences into units; they include the roots of the weights.
        weights: (F,) weights of the statistics.
        fit: indices of the pairs that the shift is learnt from.
        held: indices of the pairs that the gap is measured on.
    """
    learn, test = list(fit), list(held)
    wanted = apart[learn].mean(0)
    kept = np.clip(1 - weights / np.maximum(wanted**2, 1e-12), 0, 1)
    shift = kept * wanted / np.maximum(scale[learn].mean(0), 1e-12)
    return float(((apart[test] - scale[test] * shift).mean(0) ** 2).mean())
