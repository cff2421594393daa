"""Whether the accepted causes account for the gap, or only look like what makes it.

What the library does not have is imitated by what it has: that closes the largest part of the gap, and leaves
or spoils the rest. So it is looked at where the gap lay before and where it lies after.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.case import Gap
from jaxisp.gap.objective.protocol import Measured
from jaxisp.gap.search.refit import FARTHEST
from jaxisp.gap.simulator.effects import AXES, CLEAN_NOISY, EFFECTS, RAW_JPEG

ACCOUNTED = {RAW_JPEG: ((0.5, 0.67),), CLEAN_NOISY: ((0.3, 0.85), (1.2, 0.93))}
"""Where causes leave more than the first of these above the floor, in floors, all together must close the
second of the gap. Statistics are imitated more closely than pixels, but where these come nearer by
`FARTHEST` too. See docs/diagnosis.md for the cameras."""
_MAIN = 0.1
"""What share of the gap an axis must have to be one that it lies on."""
_KEPT, _SEEN = {RAW_JPEG: 0.3, CLEAN_NOISY: 0.5}, {RAW_JPEG: 0.15, CLEAN_NOISY: 0.5}
"""What share of that, and of the floor, may be left there."""
_FORMLESS = {
    RAW_JPEG: {"lag", "tail", "block_phase"},
    CLEAN_NOISY: {*AXES} - {"row", "column", "radius", "orientation", "fixed_pattern", "neighbourhood"},
}
"""Axes that any error of form shows on, and rounding and compression. Of statistics all but those of place
and direction: how much of the noise a filter takes out, and at which scale, is a matter of its form."""
_SURE = {RAW_JPEG: 0.01, CLEAN_NOISY: np.inf}
"""The p-value below which an axis has something left; statistics have chance in their unit."""
_CLEARLY, _FAR = 3.0, 0.5
"""How many times the noise a bias must be to say that edges are elsewhere; what share of it may be left."""


class Shown(NamedTuple):
    """What shows of the gap at a point, on the held-out pairs.

    Attributes:
        error: the mean square that the axes' shares are of.
        rows: the axes, as verdicts are decided by them.
        distance, noise: mean squares over pixels of what the real pictures are from the simulated ones on
            average, and of the simulator's noise; 0 where pixels are what is compared.
        where: the axes as they are reported: what stands in one place is on that axis alone.
    """

    error: float
    rows: Rows
    distance: float = 0.0
    noise: float = 0.0
    where: Rows = ()


def shown(problem: Measured, held: Sequence[int]) -> Shown:
    """Where the problem stands."""
    held = list(held)
    error, rows = float(problem.errors(problem.z)[held].mean()), problem.located(held)
    where = problem.credited(rows, held)
    distances, noise = problem.distances(problem.model.still(problem.z)), problem.scatter(problem.z)
    if distances is None or noise is None:
        return Shown(error, rows, where=where)
    return Shown(error, rows, float(distances[held].mean()), float(noise[held].mean()), where)


def accounted(kind: str, causes: Sequence[str], before: Shown, after: Shown, gap: Gap, left: float) -> bool:
    """Whether causes account for a gap.

    Args:
        kind: of the data.
        causes: names of effects.
        before, after: what shows without and with them.
        gap: before.
        left: the gap with them.
    """
    more, closed = (left - gap.floor) / gap.unit, (gap.before - left) / gap.scale
    nearer = after.distance < (1 - FARTHEST) * before.distance  # no stranger brought pixels as near
    if any(more >= most and closed < least for most, least in ACCOUNTED[RAW_JPEG if nearer else kind]):
        return False
    if kept_axes(kind, causes, before, after, gap):
        return False
    noise = max(before.noise, after.noise)  # the real one's, about: a base that lacks much has less, or more
    off, left_off = before.distance - noise, after.distance - noise
    return off <= _CLEARLY * noise or left_off <= _FAR * off


def kept_axes(kind: str, causes: Sequence[str], before: Shown, after: Shown, gap: Gap) -> list[str]:
    """The axes that the gap lay on and still does, though no cause shows on them: the form of one that is not
    quite right is left on its own."""
    own = {*_FORMLESS[kind], *(axis for name in causes for axis in EFFECTS[name].axes)}
    none = 0.0 if kind == RAW_JPEG else gap.floor  # shares of statistics are of what is above it
    first, last = (max(state.error - none, 0.0) for state in (before, after))
    then = {row["axis"]: first * row["share"] for row in before.rows if row["axis"] not in own}
    now = {row["axis"]: last * row["share"] for row in after.rows if row["p_value"] < _SURE[kind]}
    main = {axis: was for axis, was in then.items() if was > _MAIN * gap.scale}
    return [a for a, was in main.items() if now.get(a, 0.0) > max(_KEPT[kind] * was, _SEEN[kind] * gap.unit)]
