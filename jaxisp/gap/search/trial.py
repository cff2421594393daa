"""Trials: an effect refitted with the base, its closure, and the rules for accepting it."""

import dataclasses

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.simulator.model import Variant


@dataclasses.dataclass(frozen=True)
class Whole:
    """The gap above the floor; closures are shares of it.

    Attributes:
        size: the gap above the floor.
        parts: (scenes, U) its parts by scene and unit of the held-out pairs, grouped as the drops are.
    """

    size: float
    parts: np.ndarray


@dataclasses.dataclass(frozen=True)
class Bars:
    """Thresholds of a trial that depend on the gap, in addition to the criteria.

    Attributes:
        least: share of the gap that the lower end of the interval must exceed.
        plainly: likewise, for an effect that pixels show on their own.
        rest: share of the gap that earlier causes leave.
    """

    least: float
    plainly: float = np.inf
    rest: float = 1.0


@dataclasses.dataclass(frozen=True)
class Trial:
    """An effect refitted with the base.

    Attributes:
        effect: its name.
        z: coordinates at the end of the fit.
        before: held-out gap without the effect.
        after: held-out gap with it.
        closed: share of the gap that it closes.
        low: lower end of the 90 % bootstrap interval of `closed`.
        high: upper end of that interval.
        bars: thresholds of the trial.
        choice: demosaicker that replaced the base's; None if the base kept its own.
        params: the effect's parameters, if it has none in `z`.
        farther: relative increase of the pixels' squared distance to the real ones; negative if it falls.
        surely: lower end of an interval whose bootstrap draws the gap of a scene along with its drop. It is
            widened if there are few scenes.
        cleared: share of the pixels' squared distance beyond the noise that the effect removes.
        error: remaining error on the fitted pairs.
        learnt: share of the gap that it closes on the fitted pairs.
        drops: (N, U) its drop of the gap by pair and unit of the held-out pairs.
        changes: (N, U) mean square of what it changes there, in the unit of the gap.
    """

    effect: str
    z: np.ndarray
    before: float
    after: float
    closed: float
    low: float
    high: float
    bars: Bars
    choice: Variant | None = None
    params: dict[str, float] = dataclasses.field(default_factory=dict)
    farther: float = 0.0
    surely: float = np.inf
    cleared: float = 0.0
    error: float = np.inf
    learnt: float = 0.0
    drops: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)), compare=False)
    changes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)), compare=False)

    @property
    def gain(self) -> float:
        """The drop of the gap."""
        return self.before - self.after

    def share_of(self, factor: float) -> "Trial":
        """The same trial, its closure a share of a gap that is 1 / `factor` times as large."""
        ends = (self.closed * factor, self.low * factor, self.high * factor)
        return dataclasses.replace(self, closed=ends[0], low=ends[1], high=ends[2])

    def possible(self, criteria: Criteria) -> bool:
        """Whether pixels come closer to the real ones, or move away by less than `Criteria.farthest`."""
        return self.farther < criteria.farthest

    def shown(self, criteria: Criteria) -> bool:
        """Whether pixels alone show the effect.

        They come closer than they do for imitations of out-of-library effects, or by a large share
        (`Criteria.cleared`) of their distance beyond the noise.
        """
        plainly = self.farther < -criteria.nearer and self.cleared > criteria.cleared
        return self.farther < -criteria.farthest or plainly

    def accepted(self, criteria: Criteria) -> bool:
        """Whether the effect closes a part of the gap beyond doubt."""
        if self.low <= criteria.smallest or not self.possible(criteria):
            return False
        most = self.closed > criteria.most_of_rest * self.bars.rest
        sure = criteria.smallest * (self.bars.rest if most else 1.0)
        by_statistics = self.low > self.bars.least and self.surely > sure
        return by_statistics or (self.shown(criteria) and self.low > self.bars.plainly)


Cause = tuple[Trial, list[str]]
"""An accepted trial, and the effects that these pairs cannot distinguish from it."""
