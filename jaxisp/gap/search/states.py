"""The gap by axis at a point of the search."""

from typing import NamedTuple

from jaxisp.gap.axes import Rows
from jaxisp.gap.objective.protocol import Evidence, Point


class Shown(NamedTuple):
    """The gap at a point, by axis, on the held-out pairs.

    Attributes:
        error: mean square that the shares of the axes refer to.
        rows: the axes, as used for the verdict.
        where: the axes as reported, with leaked shares of a fixed pattern moved to its own axis.
    """

    error: float
    rows: Rows
    where: Rows = ()


def shown(evidence: Evidence, point: Point) -> Shown:
    """Measure the gap at a point."""
    held, (rows, where) = list(evidence.split.held_out), evidence.located(point)
    return Shown(float(point.errors[held].mean()), rows, where)


def sized(evidence: Evidence, point: Point) -> Shown:
    """Likewise by shares alone, for signs: without p-values, and without what is reported."""
    return Shown(float(point.errors[list(evidence.split.held_out)].mean()), evidence.sized(point))
