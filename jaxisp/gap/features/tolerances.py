"""Which difference of each statistic is harmless, and how much it counts."""

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
"""Differences that cameras lacking nothing show, averaged over pairs, chance taken off: 8-bit steps for
means and changes, logarithms and correlations for the rest. See docs/diagnosis.md for the cameras."""

_SHARED = ("pattern", "coarse", "change")  # what is looked for in other scenes or frames
_ABSENT = 1e-12
"""The weight of statistics that pictures cannot show: above 0, since units are divided by it."""
_MOST = 30.0
"""How many times as much as another a statistic can count at most for what the fitted pairs show of it."""


def axis_of(name: str) -> str:
    """The axis of the contract that a statistic belongs to."""
    return name.split()[1]


def group_of(name: str) -> str:
    """Statistics of one axis count as much together as those of another; those of the mean and of the noise
    are apart."""
    kind, axis = name.split()[:2]
    return f"{kind} {axis}" if kind in ("mean", "code", "comb", "levels") else f"noise {axis}"


@functools.cache
def tolerances() -> np.ndarray:
    """(F,) the differences that are taken for harmless."""
    return np.array([_tolerance(name) for name in feature_names()])


def _tolerance(name: str) -> float:
    return TOLERANCES[" ".join(name.split()[:2])]


@functools.cache
def repeats() -> np.ndarray:
    """(F,) how much more the mean over pairs scatters than it would were they independent: what two pairs
    share counts for both."""
    return np.array([2.0 if name.startswith(_SHARED) else 1.0 for name in feature_names()])


@functools.cache
def noise_only() -> np.ndarray:
    """(F,) 1 for the statistics of noise, 0 for those of the mean."""
    return np.array([float(not name.startswith("mean")) for name in feature_names()])


@functools.cache
def by_place() -> np.ndarray:
    """(F,) 1 for the statistics of noise that a quarter of a frame has too: spots are as large."""
    spots = np.array([name.startswith("coarse") for name in feature_names()])
    return noise_only() * ~spots


@functools.cache
def of_few_pixels() -> np.ndarray:
    """(F,) 1 for the statistics that a few pixels decide on: of tails, and of what repeats."""
    return np.array([float(name.startswith(("tail", "pattern"))) for name in feature_names()])


def _by_group(values: np.ndarray) -> np.ndarray:
    """(..., F) the mean over the group of each statistic."""
    groups = np.array([group_of(name) for name in feature_names()])
    found = np.empty_like(values)
    for group in set(groups):
        own = groups == group
        found[..., own] = values[..., own].mean(-1, keepdims=True)
    return found


def units(scatter: np.ndarray, uneven: np.ndarray) -> np.ndarray:
    """(N, F) the square of what each statistic's difference is measured in.

    Args:
        scatter: (N, F) the variance of its mean over a half by chance.
        uneven: (N, F) the same as the quarters of the frame differ. It is a rough figure: a group's mean
            counts, but where a few pixels decide.
    """
    squares = tolerances() ** 2 + scatter
    few = np.maximum(squares, uneven * of_few_pixels())
    return np.asarray(few * np.maximum(_by_group(uneven / squares), 1.0))


def emphasis(squares: np.ndarray) -> np.ndarray:
    """How much more what differs by more than its unit counts, by squared differences in units."""
    return np.asarray(np.clip(squares, 1.0, _MOST))


def emphasised(plain: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(F,) weights of mean one, where what has more of the gap counts more: one statistic shall not drown
    in many.

    Args:
        plain: (F,) `weights`.
        more: (F,) the emphasis by what the fitted pairs differ in.
    """
    found = plain * more
    return np.asarray(found / found.mean())


@functools.cache
def weights(repeated: bool = False) -> np.ndarray:
    """(F,) of mean one: each group counts the same.

    Args:
        repeated: whether any scene has several frames; else what changes between them does not count.
    """
    groups = [group_of(name) for name in feature_names()]
    counts = {g: groups.count(g) for g in groups}
    if not repeated:
        del counts["noise frame"]
    return np.array([len(groups) / (len(counts) * counts[g]) if g in counts else _ABSENT for g in groups])


def present(weights: np.ndarray) -> np.ndarray:
    """(F,) bool, what pictures can show; emphasised or not."""
    return weights > 1e3 * _ABSENT


def left_by_shift(
    apart: np.ndarray, scale: np.ndarray, weights: np.ndarray, fit: Sequence[int], held: Sequence[int]
) -> float:
    """The gap of the held-out pairs where each statistic is moved by what the fitted pairs differ in, less
    what chance and what is harmless have of that (the positive part of James and Stein 1961).

    Args:
        apart: (N, F) differences in units.
        scale: (N, F) what they were multiplied by for that.
        weights: (F,) of the statistics, which are in `scale`.
        fit, held: pairs; what is learnt of the first is taken off the others.
    """
    learn, test = list(fit), list(held)
    wanted = apart[learn].mean(0)
    kept = np.clip(1 - weights / np.maximum(wanted**2, 1e-12), 0, 1)
    shift = kept * wanted / np.maximum(scale[learn].mean(0), 1e-12)
    return float(((apart[test] - scale[test] * shift).mean(0) ** 2).mean())
