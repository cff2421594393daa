"""What is diagnosed: the evidence, the base that stands before it, and the size of the gap."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Evidence, Point
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.pipeline import Params, Stage

Tick = Callable[[int, int, str], Any]
"""Told (done, total, text) as work goes on."""


class Floor(NamedTuple):
    """The gap of a right simulator: what chance, rounding and the files' own compression leave.

    Attributes:
        each: (N,) by pair.
        ci: the 90 % interval [low, high] of its mean over the held-out pairs.
    """

    each: np.ndarray
    ci: tuple[float, float]


class Gap(NamedTuple):
    """On the held-out pairs, at the base; `least` is the unit where the floor is below.

    `floor_ci` is the 90 % interval of the floor; None where it was not measured.
    """

    before: float
    floor: float
    least: float = 0.0
    floor_ci: tuple[float, float] | None = None

    @property
    def scale(self) -> float:
        """What counts as the whole of it."""
        return max(self.before - self.floor, 0.02 * self.floor, 1e-6)

    @property
    def unit(self) -> float:
        """What differences that are harmless are a share of."""
        return max(self.floor, self.least)

    def exceeds(self, share: float) -> bool:
        """Whether it is above the floor by this share of the unit."""
        return self.before >= self.floor + share * self.unit


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """What is diagnosed: the evidence with a base before it, and what may be the gap's cause.

    Attributes:
        kind: of the pairs.
        criteria: what the verdict is decided by.
        pairs: what is compared.
        evidence: what the search minimises.
        point: where the base stands.
        floors: (N,) the gap of each pair that a right simulator would leave, at the base.
        absorbed: what the base absorbed of each effect that is part of it; None where that was not measured.
        offered: effects that are tried.
        pixels, statistics: `evidence` by its own type, for what only pixels or only statistics tell.
        stored: (N, h, w, 3) what the files do to the pictures, where grain is to be told from it.
        given: what the base is, where it was given; None where a plain one was fitted.
        open_nodes: what of a given base was fitted beside its coordinates.
        seen: effects that the files themselves show.
        unidentifiable: effects that are part of the base and that these pairs cannot show.
        outliers: pairs that were left out, each with the reason.
        reference: (N, H, W, 3) encoded sRGB, where there are clean pictures: these in the noisy ones' tones.
        floor_ci: the 90 % interval of the floor at the base; None where it is not known.
        floor_at: the floor, measured at a point; None where it is the same everywhere. What a file's
            compression takes of a soft picture is less than what it takes of a sharp one.
        reference_gap: what the base leaves on a reference set, where one was given: the floor is no lower.
        encoder: the stage that rounds or compresses as the files' headers state, and its parameters; None
            where the base has it.
        from_file: nodes whose parameters each RAW file states.
        about: further facts on the base, for report.json.
    """

    kind: str
    criteria: Criteria
    pairs: Pairs
    evidence: Evidence
    point: Point
    floors: np.ndarray
    absorbed: Mapping[str, float | None]
    offered: list[str]
    pixels: PixelObjective | None = None
    statistics: StatisticsObjective | None = None
    stored: np.ndarray | None = None
    given: str | None = None
    open_nodes: tuple[str, ...] = ()
    seen: tuple[str, ...] = ()
    unidentifiable: tuple[str, ...] = ()
    outliers: Mapping[str, str] = dataclasses.field(default_factory=dict)
    reference: np.ndarray | None = None
    floor_ci: tuple[float, float] | None = None
    floor_at: Callable[[Point], Floor] | None = None
    reference_gap: float | None = None
    encoder: tuple[Stage, Params] | None = None
    from_file: tuple[str, ...] = ()
    about: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def split(self) -> Split:
        """The pairs that are fitted, and those held out."""
        return self.evidence.split

    def gap(self) -> Gap:
        """At the base."""
        held = list(self.split.held_out)
        before = float(np.nanmean(self.evidence.units(self.point)[held]))
        floor = float(self.floors[held].mean())
        return Gap(before, min(floor, before), self.criteria.least_unit, self.floor_ci)

    def gap_above(self, gap: Gap, point: Point) -> Gap:
        """The gap at the base, above the floor that a point has."""
        if self.floor_at is None:
            return gap
        floor = self.floor_at(point)
        mean = float(floor.each[list(self.split.held_out)].mean())
        return gap._replace(floor=min(mean, gap.before), floor_ci=floor.ci)
