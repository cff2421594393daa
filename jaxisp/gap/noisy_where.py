"""Clean+noisy pairs: the axes that a gap lies on, by what the statistics of each differ by."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.measured import Rows
from jaxisp.gap.noisy_units import axis_of, present
from jaxisp.gap.statistics import feature_names

_SPILT = frozenset(("tail", "frequency", "intensity", "channel", "lag", "edge", "saturation", "hue"))
"""Axes that whatever stands in one place shows on too: to a picture's statistics its pixels are outliers."""
_PLACE = "fixed_pattern"
_BROAD = 8.0  # px: shading, which is smooth, is no matter of place
_SURELY = 5.0  # standard deviations of a median over scenes: of 10^5 pixels one may be so far off by chance
_LEAST_NOISE = 0.5  # 8-bit steps
_DEVIATION = 1.4826  # of a normal distribution, by its median


def located(difference: np.ndarray, weights: np.ndarray) -> list[dict[str, Any]]:
    """The axes by their share of what the gap has above what is harmless and chance.

    Args:
        difference: (F,) of the statistics' means over pairs, in their units, times the roots of the weights.
        weights: (F,) how much each counts.
    """
    names, above = feature_names(), _above(difference, weights)
    axes = np.array([axis_of(name) for name in names])
    in_units, counted = difference / np.sqrt(weights), weights * present(weights).mean()  # of those, mean one
    found = [
        {
            "axis": axis,
            "share": own / (sum(above.values()) + 1e-9),
            "p_value": _p_value(float((in_units[axes == axis] ** 2).mean())),
            "bins": [_short(n) for n, a in zip(names, axes) if a == axis],
            "profile": [float(v) for v in in_units[axes == axis]],
            "weights": [float(v) for v in counted[axes == axis]],
            "unit": "what is harmless or chance",
        }
        for axis, own in above.items()
    ]
    return _ranked(found)


def credited(rows: Rows, difference: np.ndarray, without: np.ndarray, weights: np.ndarray) -> Rows:
    """The rows of `located`, with what other axes only have of things that stand in one place as that one's.

    Args:
        rows: of the first.
        difference, without: (F,) as there, with what stands in one place and without it.
        weights: (F,).
    """
    above, left = _above(difference, weights), _above(without, weights)
    total = sum(above.values()) + 1e-9
    spilt = {a: max(above[a] - left[a], 0.0) / total for a in _SPILT if a in above}
    moved = spilt | {_PLACE: -sum(spilt.values())}
    surely = min((row["p_value"] for row in rows if spilt.get(row["axis"], 0.0) > 0), default=1.0)

    def own(row: dict[str, Any]) -> dict[str, Any]:
        p_value = min(row["p_value"], surely) if row["axis"] == _PLACE else row["p_value"]
        return row | {"share": row["share"] - moved.get(row["axis"], 0.0), "p_value": p_value}

    return _ranked([own(row) for row in rows])


def in_one_place(residual: np.ndarray, scenes: Sequence[str]) -> np.ndarray:
    """Where pictures differ from what they should be in most scenes alike, by far more than elsewhere.

    Args:
        residual: (N, h, w, 3) in 8-bit steps.
        scenes: the name of each pair's scene.

    Returns:
        (h, w) bool; nowhere if the scenes are fewer than three.
    """
    from scipy.ndimage import binary_dilation

    each = [np.equal(scenes, name) for name in sorted(set(scenes))]
    if len(each) < 3:
        return np.zeros(residual.shape[1:3], bool)
    apart = np.stack([_standardised(residual[own].mean(0)) for own in each])
    repeated = np.median(apart, 0) * np.sqrt(2 * len(each) / np.pi)
    usual = np.maximum(_DEVIATION * np.median(np.abs(repeated), (0, 1)), 1.0)  # more: each pixel is its own
    return np.asarray(binary_dilation((np.abs(repeated) > _SURELY * usual).any(-1)))


def _standardised(residual: np.ndarray) -> np.ndarray:
    """(h, w, 3) its fine part in standard deviations of the noise around."""
    from scipy.ndimage import gaussian_filter

    fine = residual - gaussian_filter(residual, (_BROAD, _BROAD, 0))
    usual = np.median(np.abs(fine), (0, 1))
    around = gaussian_filter(np.minimum(np.abs(fine), 4 * usual), (_BROAD, _BROAD, 0))
    return np.asarray(fine / (np.sqrt(np.pi / 2) * around + _LEAST_NOISE))


def _above(difference: np.ndarray, weights: np.ndarray) -> dict[str, float]:
    axes, excess = np.array([axis_of(name) for name in feature_names()]), difference**2 - weights
    axes, excess = axes[present(weights)], excess[present(weights)]
    return {str(axis): max(float(excess[axes == axis].sum()), 0.0) for axis in dict.fromkeys(axes)}


def _ranked(rows: Rows) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: -float(str(row["share"])))


def _short(name: str) -> str:
    """A statistic's name without its axis."""
    kind, _, what = name.split(" ", 2)
    return f"{kind} {what}"


def _p_value(mean_square: float) -> float:
    """Of a mean square of differences in units of what is harmless, taken for four independent ones."""
    from scipy.stats import chi2

    return float(chi2.sf(4 * mean_square, 4))
