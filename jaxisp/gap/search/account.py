"""Test whether the accepted causes account for the gap or only imitate its true cause.

If the true cause is an out-of-library effect, effects of the library imitate it. They close the largest part
of the gap and leave or worsen the rest. The test therefore compares the axes of the gap before and after.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxisp.gap.axes import Rows
from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.objective.protocol import Evidence, Point
from jaxisp.gap.simulator.effects import EFFECTS


class Shown(NamedTuple):
    """The gap at a point, by axis, on the held-out pairs.

    Attributes:
        error: mean square that the shares of the axes refer to.
        rows: the axes, as used for the verdict.
        distance: mean squared difference over pixels between the real pictures and the mean of the simulated
            ones; 0 for RAW+JPEG pairs.
        noise: mean square of the simulator's noise over pixels; 0 for RAW+JPEG pairs.
        where: the axes as reported, with leaked shares of a fixed pattern moved to its own axis.
    """

    error: float
    rows: Rows
    distance: float = 0.0
    noise: float = 0.0
    where: Rows = ()


def shown(evidence: Evidence, point: Point) -> Shown:
    """Measure the gap at a point."""
    held, model = list(evidence.split.held_out), point.model
    error, (rows, where) = float(point.errors[held].mean()), evidence.located(point)
    distances, noise = evidence.distances(model, model.still(point.z)), evidence.scatter(model, point.z)
    if distances is None or noise is None:
        return Shown(error, rows, where=where)
    return Shown(error, rows, float(distances[held].mean()), float(noise[held].mean()), where)


def accounted(
    criteria: Criteria, causes: Sequence[str], before: Shown, after: Shown, gap: Gap, left: float
) -> bool:
    """Whether the causes account for the gap.

    Args:
        criteria: of the kind of pairs.
        causes: names of effects.
        before: the gap by axis without them.
        after: the gap by axis with them.
        gap: the gap without them.
        left: the gap with them.
    """
    more, closed = (left - gap.floor) / gap.unit, (gap.before - left) / gap.scale
    nearer = after.distance < (1 - criteria.farthest) * before.distance  # never seen for an imitation
    bars = criteria.accounted_nearer if nearer else criteria.accounted
    if any(more >= most and closed < least for most, least in bars):
        return False
    if kept_axes(criteria, causes, before, after, gap):
        return False
    noise = max(before.noise, after.noise)  # an estimate of the real noise, which a poor base may miss
    off, left_off = before.distance - noise, after.distance - noise
    return off <= criteria.clearly_off * noise or left_off <= criteria.still_off * off


def kept_axes(criteria: Criteria, causes: Sequence[str], before: Shown, after: Shown, gap: Gap) -> list[str]:
    """Axes on which the gap was large and stays so, among those on which no cause acts.

    The axes of the causes are exempt: a cause whose form is only approximately right leaves a gap there.
    """
    own = {*criteria.formless, *(axis for name in causes for axis in EFFECTS[name].axes)}
    none = gap.floor if criteria.above_floor else 0.0
    first, last = (max(state.error - none, 0.0) for state in (before, after))
    then = {row["axis"]: first * row["share"] for row in before.rows if row["axis"] not in own}
    now = {row["axis"]: last * row["share"] for row in after.rows if row["p_value"] < criteria.sure}
    main = {axis: was for axis, was in then.items() if was > criteria.main_axis * gap.scale}
    return [
        axis
        for axis, was in main.items()
        if now.get(axis, 0.0) > max(criteria.kept * was, criteria.seen * gap.unit)
    ]
