"""Whether the accepted causes account for the gap, or only look like what makes it.

What the library does not have is imitated by what it has: that closes the largest part of the gap, and leaves
or spoils the rest. So it is looked at where the gap lay before and where it lies after.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxisp.gap.effects import CLEAN_NOISY, EFFECTS, RAW_JPEG
from jaxisp.gap.measured import Gap, Measured
from jaxisp.gap.noisy_units import group_of

Rows = Sequence[dict[str, Any]]
"""Axes, as `where` of report.json has them."""

ACCOUNTED = {RAW_JPEG: 0.67, CLEAN_NOISY: 0.5}
"""What all causes together must close where more is left than where nothing is missing."""
_MAIN, _KEPT, _SEEN = 0.1, 0.3, 0.15
"""What share of the gap an axis must have to be one that it lies on; what share of that, and of the floor,
may be left there."""
_FORMLESS = ("lag", "tail", "block_phase")
"""Axes that any error of form shows on, and rounding and compression."""
_SURE = 0.01
"""The p-value below which an axis has something left."""
_BROAD = 0.15
"""By what share the misfit of all statistics must fall. See docs/diagnosis.md for the cameras."""
_NEAR, _NEARLY_ALL = 0.75, 0.95
"""What is left tells nothing where it is less than this share of what may be, or all but closed."""
_FAR = 0.5
"""What share of a bias above the noise may be left."""


class Shown(NamedTuple):
    """What shows of the gap at a point, on the held-out pairs.

    Attributes:
        error: the mean square that the axes' shares are of.
        rows: the axes.
        bias, noise: mean squares over pixels of what noise-free pictures are off by, and of the simulator's
            noise; 0 where pixels are what is compared.
    """

    error: float
    rows: Rows
    bias: float = 0.0
    noise: float = 0.0


def shown(problem: Measured, held: Sequence[int]) -> Shown:
    """Where the problem stands."""
    held = list(held)
    error, rows = float(problem.errors(problem.z)[held].mean()), problem.located(held)
    distances, noise = problem.distances(problem.z), problem.scatter(problem.z)
    if distances is None or noise is None:
        return Shown(error, rows)
    scatter = float(noise[held].mean())
    return Shown(error, rows, float(distances[held].mean()) - scatter, scatter)


def accounted(
    kind: str, causes: Sequence[str], before: Shown, after: Shown, gap: Gap, left: float, excess: float
) -> bool:
    """Whether causes account for a gap.

    Args:
        kind: of the data.
        causes: names of effects.
        before, after: what shows without and with them.
        gap: before.
        left: the gap with them.
        excess: the share of the floor by which a gap may be above it, whatever they close.
    """
    more, may, closed = left - gap.floor, excess * gap.floor, (gap.before - left) / gap.scale
    if more >= may and closed < ACCOUNTED[kind]:
        return False
    if kind == RAW_JPEG:
        return not kept_axes(causes, before, after, gap)
    if _far(before, after):
        return False
    little = more < _NEAR * may or closed >= _NEARLY_ALL
    return little or misfit(after.rows) <= (1 - _BROAD) * misfit(before.rows)


def kept_axes(causes: Sequence[str], before: Shown, after: Shown, gap: Gap) -> list[str]:
    """The axes that the gap of RAW+JPEG pairs lay on and still does, though no cause shows on them: the form
    of one that is not quite right is left on its own."""
    own = {*_FORMLESS, *(axis for name in causes for axis in EFFECTS[name].axes)}
    then = {row["axis"]: before.error * row["share"] for row in before.rows if row["axis"] not in own}
    now = {row["axis"]: after.error * row["share"] for row in after.rows if row["p_value"] < _SURE}
    main = {axis: was for axis, was in then.items() if was > _MAIN * gap.scale}
    return [a for a, was in main.items() if now.get(a, 0.0) > max(_KEPT * was, _SEEN * gap.floor)]


def misfit(rows: Rows) -> float:
    """Sum over groups of statistics of the logarithm of their mean square, in units of what is harmless or
    chance: many that are somewhat off count as much as one that is far off. What a cause of another kind
    spoils is seen beside what it closes."""
    squares: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        for name, value in zip(row["bins"], row["profile"]):
            what, rest = name.split(" ", 1)
            squares[group_of(f"{what} {row['axis']} {rest}")].append(value**2)
    return sum(math.log(max(sum(own) / len(own), 1.0)) for own in squares.values())


def _far(before: Shown, after: Shown) -> bool:
    """Whether pictures were off by more than noise, and are by more than half of that."""
    return before.bias > before.noise and after.bias > _FAR * before.bias
