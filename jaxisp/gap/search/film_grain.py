"""Film grain in RAW+JPEG pairs: noise of the JPEG that the RAW does not have, detected by its energy.

No simulator predicts grain pixel by pixel, so adding it lowers no squared error. It does explain how large
the error is. The energy of grain is measured in flat areas as a function of luma. Four parts are subtracted:

- energy that the picture's own detail predicts: the residual of a denoiser follows the RAW's noise;
- energy that grows with the energy of the detail around: another demosaicker or denoiser than the base's;
- the floor of rounding and compression;
- the share that is a function of the picture's values: rounding to few levels, dithered or not.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_gradient_magnitude
from scipy.optimize import nnls

from jaxisp.color import ycbcr_to_rgb_planes
from jaxisp.gap.axes.interval import interval
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.objective.pixels import tiled
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.trial import Bars, Cause, Trial

_FLAT = 0.35  # share of the pixels that count as flat
_BINS = 8
_FEW = 200  # least number of flat pixels in a bin
_HUES, _DEPTHS = 6, (0.33, 0.67, 0.9)
_WINDOWS = (1.0, 2.0, 4.0)  # px, that the detail's energy is averaged over
_GRID = 8  # px; dither patterns have 8x8 pixels or fewer


@dataclasses.dataclass(frozen=True)
class Residual:
    """The pictures that grain is measured in.

    Attributes:
        target: (N, h, w, 3) the camera's pictures, Y'CbCr in 8-bit steps.
        current: (N, h, w, 3) the simulator's pictures, likewise.
        counted: (N, h, w) weight of each pixel.
        counts: (N,) sums of `counted`.
        split: grain is measured on the fitted pairs; its closure is measured on the held-out pairs.
    """

    target: np.ndarray
    current: np.ndarray
    counted: np.ndarray
    counts: np.ndarray
    split: Split


def grain_trial(
    seen: Residual,
    floor: np.ndarray,
    z: np.ndarray,
    scale: float,
    least: float,
    explained: np.ndarray,
) -> Trial:
    """Measure the share of the gap that film grain accounts for.

    Args:
        seen: the pictures; those of the simulator include the causes found so far.
        floor: (N, h, w, 3) error of rounding and of the file's compression, Y'CbCr in 8-bit steps.
        z: coordinates of the simulator, which grain leaves unchanged.
        scale: the gap above the floor.
        least: share of `scale` that the lower end of the interval must exceed.
        explained: (N, h, w, 3) the simulator's pictures with all effects that the search accepted, named or
            not, in which grain is measured: what an effect explains is no grain.
    """
    held = list(seen.split.held_out)
    best = dataclasses.replace(seen, current=explained)
    residual, flat = best.target - best.current, _flat(best)
    energy = _unpredicted(best, residual, flat) - (floor**2).sum(-1)
    expected = _independent(best.current, energy, flat, seen.split.fit)
    expected = expected * (1 - _follows_values(best, residual, floor, flat))
    residual = seen.target - seen.current
    found, grainy, bottom = (
        tiled(seen.counted * square, seen.counts)[held]
        for square in ((residual**2).sum(-1), expected, (floor**2).sum(-1))
    )
    left = found - grainy
    after = bottom + np.abs(left - bottom)
    drop = found - after
    low, high = interval(drop, scale)
    means = float(np.nanmean(found)), float(np.nanmean(after))
    params = {"std": float(np.sqrt(expected[flat].mean() / 3) / 255)}
    closed = float(np.nanmean(drop)) / scale
    return Trial("film_grain", z, *means, closed, low, high, Bars(least), params=params)


def with_grain(causes: Sequence[Cause], grain: Trial, floor: float, criteria: Criteria) -> list[Cause]:
    """Add film grain to the causes if it is large enough, in the order of decreasing closure.

    The remainder of another effect in flat areas is smaller than a leading cause, and smaller than half of
    the remaining gap.
    """
    drop = grain.gain
    little = grain.closed < criteria.leading or drop < criteria.grain_of_rest * (grain.before - floor)
    if little or not grain.accepted(criteria):
        return list(causes)
    first = [c for c in causes if c[0].closed >= grain.closed]
    before = first[-1][0].after if first else (causes[0][0].before if causes else grain.before)
    moved = [
        (dataclasses.replace(t, before=t.before - drop, after=t.after - drop), alike)
        for t, alike in causes[len(first) :]
    ]
    return [*first, (dataclasses.replace(grain, before=before, after=before - drop), []), *moved]


def _flat(seen: Residual) -> np.ndarray:
    """Mask (N, h, w) of the areas where the simulator's picture is flat."""
    slope = gaussian_gradient_magnitude(seen.current[..., 0], (0, 1.5, 1.5))
    counts = seen.counted > 0
    return np.asarray((slope < np.quantile(slope[counts], _FLAT)) & counts)


def _unpredicted(seen: Residual, residual: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Energy (N, h, w) of the residual's detail that the picture's own detail does not predict.

    The prediction is fitted separately for each colour. Only detail counts: a smooth residual in flat areas
    is an error of colour.
    """
    details = np.concatenate([_detail(seen.current, sigma) for sigma in (1.0, 3.0)], -1)
    learnt = _of(flat, seen.split.fit)
    left = _detail(residual, 3.0)
    color = _colors(seen.current, flat)
    for k in range(color.max() + 1):
        own = color == k
        if (own & learnt).sum() >= _FEW:
            share, *_ = np.linalg.lstsq(details[own & learnt], left[own & learnt], rcond=None)
            left[own] -= details[own] @ share
    return np.asarray((left**2).sum(-1))


def _colors(picture: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Colour class (N, h, w) of each pixel: grey, or one of six hues in three degrees of saturation."""
    cb, cr = picture[..., 1], picture[..., 2]
    chroma = np.hypot(cb, cr)
    depth = np.searchsorted(np.quantile(chroma[flat], _DEPTHS), chroma)
    hue = ((np.arctan2(cr, cb) / (2 * np.pi) + 0.5) * _HUES).astype(int).clip(0, _HUES - 1)
    return np.asarray(np.where(depth == 0, 0, 1 + (depth - 1) * _HUES + hue))


def _follows_values(seen: Residual, residual: np.ndarray, floor: np.ndarray, flat: np.ndarray) -> float:
    """Share in [0, 1] of the residual's detail that depends on R, G or B and the position in an 8x8 grid.

    The function is estimated on the fitted and on the held-out pairs. The product of both estimates is free
    of the bias by chance.
    """
    values = _to_rgb(seen.current)
    fine, bottom = (_to_rgb(_detail(d, 3.0)) for d in (residual, floor))
    sides = [_of(flat, half) for half in (seen.split.fit, seen.split.held_out)]
    height, width = flat.shape[1:]
    place = np.add.outer(np.arange(height) % _GRID * _GRID, np.arange(width) % _GRID)
    shared = energy = 0.0
    for c in range(3):
        cell = np.clip(values[..., c], 0, 255).astype(int) * _GRID**2 + place
        counts = [np.bincount(cell[side], minlength=256 * _GRID**2) for side in sides]
        sums = [np.bincount(cell[side], fine[..., c][side], 256 * _GRID**2) for side in sides]
        both = (counts[0] > 0) & (counts[1] > 0)
        first, second = (s[both] / n[both] for s, n in zip(sums, counts))
        count = (counts[0] + counts[1])[both]
        shared += float((count * first * second).sum() / max(count.sum(), 1))
        energy += float((fine[flat][:, c] ** 2).mean() - (bottom[flat][:, c] ** 2).mean())
    return float(np.clip(shared / max(energy, 1e-6), 0, 1))


def _of(flat: np.ndarray, which: Sequence[int]) -> np.ndarray:
    """Restrict the flat areas (N, h, w) to these pairs."""
    return np.asarray(np.isin(np.arange(len(flat)), which)[:, None, None] & flat)


def _to_rgb(steps: np.ndarray) -> np.ndarray:
    return np.stack([np.asarray(p) for p in ycbcr_to_rgb_planes(*np.moveaxis(steps, -1, 0))], -1)


def _detail(picture: np.ndarray, sigma: float) -> np.ndarray:
    return np.asarray(picture - gaussian_filter(picture, (0, sigma, sigma, 0)))


def _independent(
    current: np.ndarray, energy: np.ndarray, flat: np.ndarray, fit_on: Sequence[int]
) -> np.ndarray:
    """Mean energy (N, h, w) of flat areas at each pixel's luma that does not grow with the detail around.

    What a wrong base does to the noise of the RAW grows with this noise: locally, by chance, even where the
    noise is uniform. So the energy is a sum of a level for each range of luma and of powers of the detail's
    own energy, all at least 0. Only the levels are grain.
    """
    learnt, luma = _of(flat, fit_on), current[..., 0]
    square = (_detail(current, 1.0) ** 2).sum(-1)
    detail = np.stack([gaussian_filter(square, (0, width, width))[learnt] for width in _WINDOWS], -1)
    values, seen = energy[learnt], luma[learnt]
    edges = np.quantile(seen, np.linspace(0, 1, _BINS + 1))
    which = np.clip(np.searchsorted(edges, seen, "right") - 1, 0, _BINS - 1)
    full = [k for k in range(_BINS) if (which == k).sum() >= _FEW]
    if not full:
        return np.zeros_like(energy)
    unit = np.median(detail[:, 1]) + 1e-6
    levels = (which[:, None] == np.array(full)).astype(float)
    columns = np.concatenate([levels, detail / unit, (detail / unit) ** 2], 1)
    weight = (1 / (1 + detail[:, 1:2] / unit)) * levels.sum(1, keepdims=True)  # quiet places tell more
    gram, right = (columns * weight).T @ (columns * weight), (columns * weight).T @ (values * weight[:, 0])
    # as least squares of the same normal equations, which are few where pixels are many
    root = np.linalg.cholesky(gram + 1e-9 * np.trace(gram) * np.eye(len(gram)))
    means = nnls(root.T, np.linalg.solve(root, right))[0][: len(full)]
    return np.interp(luma, [seen[which == k].mean() for k in full], means)
