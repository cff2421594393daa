"""From stacks of frames to the figures of a sensor, each with its standard error.

Source: EMVA Standard 1288, release 4.0 (2021): photon transfer, and nonuniformity split into rows, columns
and pixels. Tails: Martinez & Iglewicz 1984, "Some properties of the Tukey g and h family of distributions"
(kurtosis of Tukey's h).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from jaxisp.calibrate.frames import (
    BLOCK,
    MEAN,
    Stack,
    Tick,
    blocks,
    check_same_sensor,
    high_passed,
    interactions,
    line_squares,
    profiles,
    raw_files,
    read_stacks,
)
from jaxisp.calibrate.noise import Calibrated, Figure, Noise
from jaxisp.errors import InputError
from jaxisp.io.files import PathLike

FREE = (BLOCK - 1) ** 2
"""Degrees of freedom of a block's interactions."""
HIGHEST, CLIPPED = 0.7, 0.95
"""Levels: the mean up to which photon transfer is fitted (EMVA: 70 % of saturation), and what no pixel of a
block may reach."""
HOT = 8.0
"""Standard deviations of a dark frame's pixels beyond which one is hot or dead."""
COARSE = 0.24
"""Variance [DN**2] below which rounding hides the read noise (EMVA 1288)."""
_GROUPS = 20  # of blocks that the jackknife leaves out in turn


def calibrate(
    flats: PathLike,
    darks: PathLike,
    *,
    failed: list[tuple[str, str]] | None = None,
    tick: Tick = lambda done, total, text: None,
) -> Calibrated:
    """Measure a sensor's noise.

    Args:
        flats: a folder of RAW frames of an even light (or any scene that does not move), two or more of each
            light and exposure; more lights tell more. Or one file's path.
        darks: a folder of RAW frames with the lens covered, two or more of each exposure; at two exposure
            times they tell the dark signal.
        failed: is given (file, reason) of frames that cannot be read, and the rest goes on; None: the first
            one ends it.
        tick: called with (done, total, text).

    Returns:
        the noise at each ISO number that has both kinds of frames.

    Raises:
        InputError: a file cannot be read, frames are not of one sensor, or no ISO number has two flat frames
            of one light and two dark frames.
    """
    dark = read_stacks(raw_files(darks), tick, "dark", failed)
    flat = read_stacks(raw_files(flats), tick, "flat", failed)
    check_same_sensor(dark[0].first, dark[0].total.shape, flat[0].first, flat[0].total.shape)
    notes: list[str] = []
    found = []
    for iso in dict.fromkeys(s.iso for s in flat):
        own = [s for s in flat if s.iso == iso and s.count > 1]
        covered = _usable_darks([s for s in dark if s.iso == iso], notes)
        name = "frames without an ISO number" if iso is None else f"ISO {iso:g}"
        if own and covered:
            found.append(_measured(iso, own, covered, name, notes))
        else:
            what = "two flat frames of one light" if covered else "two dark frames"
            notes.append(f"{name}: left out, as there are no {what}")
        notes += [
            f"{s.names[0]}: left out, as no other frame has its light and exposure"
            for s in flat
            if s.iso == iso and s.count == 1
        ]
    if not found:
        raise InputError(f"{flats}: {'; '.join([*notes, *(reason for _, reason in failed or ())])}")
    first = flat[0].first
    camera = f"{first.make} {first.model}".strip()
    return Calibrated(camera, tuple(sorted(found, key=lambda n: n.iso or 0)), tuple(notes))


def _usable_darks(darks: Sequence[Stack], notes: list[str]) -> list[Stack]:
    """Those of several frames; where all are single, the frames together, whatever their exposures."""
    several = [s for s in darks if s.count > 1]
    if several or len(darks) < 2:
        return several
    first = dataclasses.replace(darks[0], exposure=None, names=list(darks[0].names))
    for other in darks[1:]:
        first.join(other)
    notes.append(f"{', '.join(first.names)}: single dark frames, taken as of one exposure")
    return [first]


class Points(NamedTuple):
    """Blocks of a stack: level above black, temporal and spatial variance, how many frames, the place of the
    cell; all (N,)."""

    level: np.ndarray
    temporal: np.ndarray
    spatial: np.ndarray
    frames: np.ndarray
    place: np.ndarray


class Fit(NamedTuple):
    """Coefficients of a linear fit and their covariance."""

    coefficients: np.ndarray
    covariance: np.ndarray

    def figure(self, index: int) -> Figure:
        return Figure(float(self.coefficients[index]), float(np.sqrt(self.covariance[index, index])))


def points(stack: Stack, black: np.ndarray, bad: np.ndarray) -> Points:
    """The usable blocks of a stack.

    Args:
        stack: the frames.
        black: (4,) level of no light at the places of the cell.
        bad: (4, h, w) blocks to leave out.
    """
    mean = blocks(stack.mean)
    of_mean = (interactions(mean) ** 2).sum((-2, -1))
    temporal = (stack.squares - stack.count * of_mean) / ((stack.count - 1) * FREE)
    spatial = of_mean / FREE - temporal / stack.count
    level = mean.mean((-2, -1)) - black[:, None, None]
    kept = ~bad & (level <= HIGHEST) & (stack.largest < CLIPPED)
    place = np.broadcast_to(np.arange(4)[:, None, None], level.shape)
    count = np.full(kept.sum(), stack.count)
    return Points(level[kept], temporal[kept], spatial[kept], count, place[kept])


def together(parts: Sequence[Points]) -> Points:
    return Points(*(np.concatenate(columns) for columns in zip(*parts)))


def photon_transfer(found: Points) -> Fit:
    """Temporal variance against level: shot, and the square of read."""
    terms = np.stack([found.level, np.ones_like(found.level)], 1)
    free = (found.frames - 1) * FREE
    return _line(terms, found.temporal, lambda fitted: fitted**2 * 2 / free)


def nonuniformity(found: Points, transfer: Fit) -> Fit:
    """Spatial variance against the square of the level: squares of PRNU and of DSNU."""
    terms = np.stack([found.level**2, np.ones_like(found.level)], 1)
    shot, square = transfer.coefficients
    share = np.maximum(shot * found.level + square, 1e-12) / found.frames  # what is left of the temporal

    def spread(fitted: np.ndarray) -> np.ndarray:
        free = (found.frames - 1) * FREE
        return 2 * (np.maximum(fitted, 0) + share) ** 2 / FREE + 2 * share**2 / free

    return _line(terms, found.spatial, spread)


def _line(terms: np.ndarray, values: np.ndarray, variance: Callable[[np.ndarray], np.ndarray]) -> Fit:
    """Weighted least squares; the weights follow from the fit, never from the values themselves."""
    fitted = np.full(len(values), max(values.mean(), 1e-15))
    for _ in range(6):
        weight = 1 / np.maximum(variance(fitted), 1e-30)
        square = np.linalg.pinv(terms.T @ (weight[:, None] * terms))
        coefficients = square @ (terms.T @ (weight * values))
        fitted = np.maximum(terms @ coefficients, 1e-15)
    left = values - terms @ coefficients
    scaled = terms * (weight * left)[:, None]  # the errors that the blocks show, whatever their law
    covariance = square @ (scaled.T @ scaled) @ square
    return Fit(coefficients, covariance * len(values) / max(len(values) - terms.shape[1], 1))


def _measured(
    iso: float | None, flats: Sequence[Stack], darks: Sequence[Stack], name: str, notes: list[str]
) -> Noise:
    signal, black, black_error = dark_signal(darks)
    longest = max(darks, key=lambda s: s.count)
    hot, share = _hot(longest)
    if share > 0:
        notes.append(f"{name}: {100 * share:.3g} % of the pixels are hot or dead; their blocks are left out")
    if hot.mean() > 0.5:
        hot = np.zeros_like(hot)
        notes[-1] = f"{name}: {100 * share:.3g} % of the pixels are hot or dead: too many to leave out"
    dark_points = together([points(s, black, hot) for s in darks])
    parts = [points(s, black, hot) for s in flats]
    all_points = together([dark_points, *parts])
    if not sum(len(p.level) for p in parts):
        raise InputError(f"{name}: flat frames are brighter than {100 * HIGHEST:.0f} % of white, or clipped")
    transfer = photon_transfer(all_points)
    uneven = nonuniformity(all_points, transfer)
    first = flats[0].first
    step = 1 / (first.white - float(first.black.mean())) if first.white > 1 else 0.0  # floats are not rounded
    lines = line_noise(longest, float(dark_points.temporal.mean()), float(dark_points.spatial.mean()))
    size = longest.total.shape
    fixed = np.hypot(*(lines[f"{n}_fixed"].value / np.sqrt(k) for n, k in zip(("row", "column"), size)))
    figures = {
        "shot": transfer.figure(0),
        "read": _root(transfer.figure(1)),
        **lines,
        "prnu": _root(uneven.figure(0)),
        "dsnu": _root(uneven.figure(1)),
        "tail": tail(longest, hot, step),
        "black": Figure(float(black.mean()), float(np.hypot(black_error, fixed))),
        "hot_pixels": Figure(share, float(np.sqrt(share / longest.total.size))),
    }
    if signal is not None:
        figures["dark_signal"] = signal
    read = transfer.figure(1).value
    if step and read < COARSE * step**2:
        notes.append(
            f"{name}: read noise is below {np.sqrt(COARSE):.2f} DN: rounding hides it, and `read` is a bound"
        )
        del figures["tail"]
    if max(s.lowest for s in darks) > 0.2:
        notes.append(f"{name}: dark frames are cut at black, so that read noise is larger than found")
    by_place = [
        photon_transfer(Points(*(a[all_points.place == k] for a in all_points))).figure(0) for k in range(4)
    ]
    return Noise(
        iso,
        {n: figures[n] for n in sorted(figures)},
        black=float(first.black.mean()),
        white=first.white,
        cfa=first.cfa,
        shot_by_place=tuple(by_place),
        stated=_stated(first.noise_profile),
        frames=(sum(s.count for s in flats), sum(s.count for s in darks)),
        points=(all_points.level, all_points.temporal, all_points.spatial),
        profiles=tuple(high_passed(p) for pair in profiles(longest.mean) for p in pair),
    )


def _stated(profile: np.ndarray | None) -> tuple[float, float] | None:
    """Shot and read of green as the DNG states them."""
    return None if profile is None else (float(profile[1][0]), float(profile[1][1]))


def _root(square: Figure) -> Figure:
    """The square root, 0 where the square is no more than its error."""
    if square.value <= square.error:
        return Figure(0.0, float(np.sqrt(max(square.error, 0))))
    root = float(np.sqrt(square.value))
    return Figure(root, square.error / (2 * root))


def dark_signal(darks: Sequence[Stack]) -> tuple[Figure | None, np.ndarray, float]:
    """Level a second in the dark; (4,) black, the level without light and time; and its standard error.

    The error is that of means between frames; what is fixed in rows and columns is not in it. With one
    exposure time the signal is not known, and black is the mean.
    """
    means = np.array([[s.mean[y::2, x::2].mean() for y in (0, 1) for x in (0, 1)] for s in darks])
    count = np.array([s.count for s in darks], float)
    apart = sum(((np.asarray(s.means) - np.mean(s.means)) ** 2).sum() for s in darks) / sum(count - 1)
    times = [s.exposure for s in darks]
    known = np.array([t for t in times if t is not None])
    if len(set(known)) < 2 or len(known) < len(times):
        return None, count @ means / count.sum(), float(np.sqrt(apart / count.sum()))
    terms = np.stack([known, np.ones(len(known))], 1)
    square = np.linalg.inv(terms.T @ (count[:, None] * terms))
    rate, black = square @ (terms.T @ (count[:, None] * means))
    errors = np.sqrt(apart * np.diag(square))
    return Figure(float(rate.mean()), float(errors[0])), black, float(errors[1])


def _hot(stack: Stack) -> tuple[np.ndarray, float]:
    """(4, h, w) blocks with a hot or dead pixel, and the share of such pixels."""
    own = blocks(stack.mean)
    own = own - np.median(own, (-2, -1), keepdims=True)  # a mean would spread a hot pixel over its block
    width = 1.4826 * np.median(np.abs(own))
    out = np.abs(own) > HOT * width if width > 0 else np.zeros(own.shape, bool)
    return np.asarray(out.any((-2, -1))), float(out.mean())


def line_noise(stack: Stack, temporal: float, spatial: float) -> dict[str, Figure]:
    """Noise of rows and columns, temporal and fixed, from dark frames.

    A profile's variance is that of the lines and a share of the pixels'. A moving mean of k lines leaves
    1 - 1/k of a white profile's.
    """
    found = {}
    kernel = -np.full(MEAN, 1 / MEAN)
    kernel[MEAN // 2] += 1
    share = float((kernel**2).sum())
    overlap = float((np.correlate(kernel, kernel, "full") ** 2).sum())
    fixed_sums = line_squares(stack.mean)
    for axis, name in enumerate(("row", "column")):
        count = sum(len(high_passed(p)) for p in profiles(stack.mean)[axis])
        free = count * share**2 / overlap  # independent lines that err as much
        pixels = stack.total.shape[1 - axis]
        frames = stack.count - 1
        squares, of_mean = stack.lines[axis].sum(), fixed_sums[axis].sum()
        moving = (squares - stack.count * of_mean) / (frames * count * share)
        still = of_mean / (count * share)
        moving_error = moving * np.sqrt(2 / (free * frames))
        square = Figure(moving - temporal / pixels, moving_error)
        own = max(square.value, 0.0)
        fixed = Figure(
            still - moving / stack.count - spatial / pixels,
            float(np.hypot(still * np.sqrt(2 / free), moving_error / stack.count)),
        )
        found[f"{name}_temporal"] = _root(square)
        found[f"{name}_fixed"] = _root(fixed)
        both = Figure(own + max(fixed.value, 0.0), float(np.hypot(square.error, fixed.error)))
        found[name] = _root(both)
    return found


def kurtosis(h: float) -> float:
    """Of Tukey's h-distribution, 3 for a Gaussian."""
    return float(3 * (1 - 2 * h) ** 3 / (1 - 4 * h) ** 2.5)


def tail(stack: Stack, bad: np.ndarray, step: float) -> Figure:
    """Tukey's h of the read noise, from the fourth moment of differences of dark frames.

    The fourth cumulant of a sum of independent draws is that of one times the sum of fourth powers of their
    weights, so that those of the projection are undone exactly. Rounding by `step` is taken away.
    """
    squares, fourths = stack.pair_squares[~bad], stack.pair_fourths[~bad]
    centre = np.zeros((BLOCK, BLOCK))
    centre[0, 0] = 1
    weights = interactions(centre)
    second, fourth = (weights**2).sum(), (weights**4).sum()

    def excess(keep: np.ndarray) -> float:
        number = keep.sum() * BLOCK**2 * (stack.count - 1)
        m2, m4 = squares[keep].sum() / number, fourths[keep].sum() / number
        cumulant = (m4 - 3 * m2**2) / (2 * fourth) + step**4 / 120
        variance = m2 / (2 * second) - step**2 / 12
        return float(cumulant / max(variance, 1e-30) ** 2)

    group = np.arange(len(squares)) % _GROUPS
    value = excess(np.ones(len(squares), bool))
    left_out = np.array([excess(group != k) for k in range(_GROUPS)])
    error = float(np.sqrt((_GROUPS - 1) / _GROUPS * ((left_out - left_out.mean()) ** 2).sum()))
    highest = 0.2499
    h = 0.0 if value <= 0 else highest
    if 0 < value < kurtosis(highest) - 3:
        h = float(brentq(lambda x: kurtosis(x) - 3 - value, 0, highest))
    slope = (kurtosis(h + 1e-6) - kurtosis(h)) / 1e-6
    return Figure(h, error / slope)
