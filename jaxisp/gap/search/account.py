"""Whether the accepted causes account for the gap, or only look like what makes it.

An effect that the library lacks is imitated by those it has: they close the largest part of the gap, and
leave or spoil the rest. So the axes of the gap before and after are compared.
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxisp.gap.axes import Rows
from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.objective.protocol import Evidence, Point
from jaxisp.gap.simulator.effects import EFFECTS


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


def shown(evidence: Evidence, point: Point) -> Shown:
    """At a point."""
    held, model = list(evidence.split.held_out), point.model
    error, (rows, where) = float(point.errors[held].mean()), evidence.located(point)
    distances, noise = evidence.distances(model, model.still(point.z)), evidence.scatter(model, point.z)
    if distances is None or noise is None:
        return Shown(error, rows, where=where)
    return Shown(error, rows, float(distances[held].mean()), float(noise[held].mean()), where)


def accounted(
    criteria: Criteria, causes: Sequence[str], before: Shown, after: Shown, gap: Gap, left: float
) -> bool:
    """Whether causes account for a gap.

    Args:
        criteria: of the kind of pairs.
        causes: names of effects.
        before, after: what shows without and with them.
        gap: before.
        left: the gap with them.
    """
    more, closed = (left - gap.floor) / gap.unit, (gap.before - left) / gap.scale
    nearer = after.distance < (1 - criteria.farthest) * before.distance  # as no out-of-library effect brought
    bars = criteria.accounted_nearer if nearer else criteria.accounted
    if any(more >= most and closed < least for most, least in bars):
        return False
    if kept_axes(criteria, causes, before, after, gap):
        return False
    noise = max(before.noise, after.noise)  # the real one's, about: a base that lacks much has less, or more
    off, left_off = before.distance - noise, after.distance - noise
    return off <= criteria.clearly_off * noise or left_off <= criteria.still_off * off


def kept_axes(criteria: Criteria, causes: Sequence[str], before: Shown, after: Shown, gap: Gap) -> list[str]:
    """The axes that the gap lay on and still does, though no cause shows on them: the form of one that is not
    quite right is left on its own."""
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
