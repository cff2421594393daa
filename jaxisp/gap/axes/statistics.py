"""Axes of the gap of clean+noisy pairs, from the differences of the statistics on each axis."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.axes.interval import Draws
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.features.tolerances import axis_of, present, repeats

_LEAKED = frozenset(("tail", "frequency", "intensity", "channel", "lag", "edge", "saturation", "hue"))
"""Axes that a fixed pattern leaks into: its pixels are outliers in the statistics of a picture."""
_PLACE = "fixed_pattern"
_BROAD = 8.0  # px, sigma of a high-pass filter that removes shading
_SURELY = 5.0  # standard deviations of a median over scenes; by chance, one of 10^5 pixels may exceed it
_LEAST_NOISE = 0.5  # 8-bit steps
_DEVIATION = 1.4826  # ratio of standard deviation to median absolute deviation of a normal distribution

Above = dict[str, np.ndarray]
"""A value by axis: one number, or (D,) for D bootstrap draws."""


def located(
    difference: np.ndarray,
    weights: np.ndarray,
    apart: np.ndarray,
    scenes: Sequence[str],
) -> list[dict[str, Any]]:
    """Rank the axes by their share of the gap beyond tolerance and chance.

    Args:
        difference: (F,) mean differences of the statistics over pairs, in units, times roots of `weights`.
        weights: (F,) weights of the statistics.
        apart: (N, F) differences of each pair; `difference` is their mean.
        scenes: (N,) name of each pair's scene.

    Returns:
        rows like those of `regression.where`, largest share first. `ci` is [low, high], the 90 % bootstrap
        interval of the share over scenes with fixed units; None if there is one scene. `size` is the mean
        squared difference in units. `p_value` is the probability of that size by chance.
    """
    names = feature_names()
    axes = np.array([axis_of(name) for name in names])
    # scaled so that the weights of the statistics that are present have mean one
    in_units, counted = difference / np.sqrt(weights), weights * present(weights).mean()
    shares = _shares(_above(difference**2 - weights, weights))
    draws = Draws.of(scenes)
    ci: dict[str, list[float] | None] = dict.fromkeys(shares)
    if draws is not None:
        drawn = _shares(_above(_excess(difference, apart, draws, weights), weights))
        ci = _intervals(draws, shares, drawn)
    found = [
        {
            "axis": axis,
            "share": float(share),
            "ci": ci[axis],
            "size": float((in_units[axes == axis] ** 2).mean()),
            "p_value": _p_value(float((in_units[axes == axis] ** 2).mean())),
            "bins": [_short(n) for n, a in zip(names, axes) if a == axis],
            "profile": [float(v) for v in in_units[axes == axis]],
            "weights": [float(v) for v in counted[axes == axis]],
            "unit": "what is harmless or chance",
        }
        for axis, share in shares.items()
    ]
    return _ranked(found)


def reattributed(
    rows: Rows,
    difference: np.ndarray,
    without: np.ndarray,
    weights: np.ndarray,
    apart: Sequence[np.ndarray],
    scenes: Sequence[str],
) -> Rows:
    """Move the shares that a fixed pattern leaked into other axes to the axis "fixed_pattern".

    Args:
        rows: result of `located` for `difference`.
        difference: (F,) differences of all pixels, as in `located`.
        without: (F,) differences without the pixels of the fixed pattern.
        weights: (F,) weights of the statistics.
        apart: two (N, F) differences of each pair, with and without these pixels. The leaked share is
            computed anew for each bootstrap draw, so that `ci` belongs to the corrected share.
        scenes: (N,) name of each pair's scene.

    Returns:
        the corrected rows, largest share first.
    """
    above, left = (_above(own**2 - weights, weights) for own in (difference, without))
    leaked = _leaked(above, left)
    draws, shares = Draws.of(scenes), _moved(above, left)
    ci: dict[str, list[float] | None] = dict.fromkeys(shares)
    if draws is not None:
        both = zip((difference, without), apart)
        drawn = _moved(*(_above(_excess(mean, own, draws, weights), weights) for mean, own in both))
        ci = _intervals(draws, shares, drawn)
    size = max(row["size"] for row in rows if row["axis"] == _PLACE or leaked.get(row["axis"], 0.0) > 0)
    surely = {"size": size, "p_value": _p_value(size)}

    def own(row: dict[str, Any]) -> dict[str, Any]:
        axis = row["axis"]
        return row | {"share": float(shares[axis]), "ci": ci[axis]} | (surely if axis == _PLACE else {})

    return _ranked([own(row) for row in rows])


def in_one_place(residual: np.ndarray, scenes: Sequence[str]) -> np.ndarray:
    """Find pixels whose residual is large and similar in most scenes.

    Args:
        residual: (N, h, w, 3) Y'CbCr in 8-bit steps.
        scenes: (N,) name of each pair's scene.

    Returns:
        mask (h, w) bool of these pixels and their neighbours; all False with fewer than three scenes.
    """
    from scipy.ndimage import binary_dilation

    each = [np.equal(scenes, name) for name in sorted(set(scenes))]
    if len(each) < 3:
        return np.zeros(residual.shape[1:3], bool)
    apart = np.stack([_standardised(residual[own].mean(0)) for own in each])
    repeated = np.median(apart, 0) * np.sqrt(2 * len(each) / np.pi)
    # above 1 if every pixel has an offset of its own, as with PRNU
    usual = np.maximum(_DEVIATION * np.median(np.abs(repeated), (0, 1)), 1.0)
    return np.asarray(binary_dilation((np.abs(repeated) > _SURELY * usual).any(-1)))


def _standardised(residual: np.ndarray) -> np.ndarray:
    """High-pass part of a residual (h, w, 3), in standard deviations of the noise around each pixel."""
    from scipy.ndimage import gaussian_filter

    fine = residual - gaussian_filter(residual, (_BROAD, _BROAD, 0))
    usual = np.median(np.abs(fine), (0, 1))
    around = gaussian_filter(np.minimum(np.abs(fine), 4 * usual), (_BROAD, _BROAD, 0))
    return np.asarray(fine / (np.sqrt(np.pi / 2) * around + _LEAST_NOISE))


def _excess(difference: np.ndarray, apart: np.ndarray, draws: Draws, weights: np.ndarray) -> np.ndarray:
    """Squared differences (D, F) of bootstrap draws, minus the weights.

    The units already contain the variance between scenes. The variance that the bootstrap adds is therefore
    removed: the mean over draws equals the value (F,) of all pairs.
    """
    off = np.sqrt(repeats()) * (draws.means(apart) - apart.mean(0))
    squares = (difference + off) ** 2
    return np.asarray(squares - squares.mean(0) + difference**2 - weights)


def _above(excess: np.ndarray, weights: np.ndarray) -> Above:
    """Sum of the excess (..., F) over the statistics of each axis, clipped at 0."""
    axes, counted = np.array([axis_of(name) for name in feature_names()]), present(weights)
    return {
        str(axis): np.maximum(excess[..., counted & (axes == axis)].sum(-1), 0.0)
        for axis in dict.fromkeys(axes[counted])
    }


def _intervals(draws: Draws, shares: Above, drawn: Above) -> dict[str, list[float] | None]:
    return {axis: draws.interval(float(share), drawn[axis]) for axis, share in shares.items()}


def _shares(above: Above) -> Above:
    total = sum(above.values()) + 1e-9
    return {axis: own / total for axis, own in above.items()}


def _leaked(above: Above, left: Above) -> Above:
    """Share of each axis that disappears without the pixels of the fixed pattern."""
    total = sum(above.values()) + 1e-9
    return {a: np.maximum(above[a] - left[a], 0.0) / total for a in above if a in _LEAKED}


def _moved(above: Above, left: Above) -> Above:
    """Shares of the axes, with the leaked shares moved to "fixed_pattern"."""
    leaked = _leaked(above, left)
    moved = leaked | {_PLACE: -sum(leaked.values())}
    return {axis: share - moved.get(axis, 0.0) for axis, share in _shares(above).items()}


def _ranked(rows: Rows) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: -float(str(row["share"])))


def _short(name: str) -> str:
    """A statistic's name without its axis."""
    kind, _, what = name.split(" ", 2)
    return f"{kind} {what}"


def _p_value(mean_square: float) -> float:
    """P-value of a mean squared difference in units; an axis counts as four independent statistics."""
    from scipy.stats import chi2

    return float(chi2.sf(4 * mean_square, 4))
