"""Where a gap of statistics lies: the axes, by how far the statistics of each differ."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.axes.interval import Draws
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.features.tolerances import axis_of, present, repeats

_LEAKED = frozenset(("tail", "frequency", "intensity", "channel", "lag", "edge", "saturation", "hue"))
"""Axes that a fixed pattern also shows on: its pixels are outliers to the statistics of a picture."""
_PLACE = "fixed_pattern"
_BROAD = 8.0  # px: shading is smooth, and not counted as a place
_SURELY = 5.0  # standard deviations of a median over scenes: of 10^5 pixels one may be so far off by chance
_LEAST_NOISE = 0.5  # 8-bit steps
_DEVIATION = 1.4826  # of a normal distribution, by its median

Above = dict[str, np.ndarray]
"""By axis, what it has: one number, or (D,) by draw."""


def located(
    difference: np.ndarray,
    weights: np.ndarray,
    apart: np.ndarray,
    scenes: Sequence[str],
) -> list[dict[str, Any]]:
    """The axes by their share of what the gap has above what is harmless and chance.

    Args:
        difference: (F,) of the statistics' means over pairs, in their units, times the roots of the weights.
        weights: (F,) how much each counts.
        apart: (N, F) of each pair, what `difference` is the mean of.
        scenes: (N,) the name of each pair's scene.

    Returns:
        as `where` does, largest share first; `ci` is [low, high], the 90 % interval of the share over draws
        of the scenes, units left as they are, or None of one scene; `size` is the mean square in units, and
        `p_value` that of chance.
    """
    names = feature_names()
    axes = np.array([axis_of(name) for name in names])
    in_units, counted = difference / np.sqrt(weights), weights * present(weights).mean()  # of those, mean one
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
    """The rows of `located`, with what other axes only have of things that stand in one place as that one's.

    Args:
        rows: of the first.
        difference, without: (F,) as there, with what stands in one place and without it.
        weights: (F,).
        apart: (N, F) of each pair, for both, as there. What moves is each draw's own, so that `ci` is of the
            share that is shown.
        scenes: (N,) as there.
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


def _excess(difference: np.ndarray, apart: np.ndarray, draws: Draws, weights: np.ndarray) -> np.ndarray:
    """(D, F) squares of the draws' differences above the weights. The chance of drawing is not added to that
    of the scenes themselves, which the units hold already: on average draws have what all (F,) have."""
    off = np.sqrt(repeats()) * (draws.means(apart) - apart.mean(0))
    squares = (difference + off) ** 2
    return np.asarray(squares - squares.mean(0) + difference**2 - weights)


def _above(excess: np.ndarray, weights: np.ndarray) -> Above:
    """By axis the sum of the excess (..., F), where it is positive."""
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
    """By axis the share that it has only of what stands in one place."""
    total = sum(above.values()) + 1e-9
    return {a: np.maximum(above[a] - left[a], 0.0) / total for a in above if a in _LEAKED}


def _moved(above: Above, left: Above) -> Above:
    """The shares, with what is leaked as that axis's own."""
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
    """Of a mean square of differences in units of what is harmless, taken for four independent ones."""
    from scipy.stats import chi2

    return float(chi2.sf(4 * mean_square, 4))
