"""An effect refitted with the base: where it ended, what it closes, and whether that is accepted."""

import dataclasses

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.simulator.model import Variant


@dataclasses.dataclass(frozen=True)
class Whole:
    """The gap above the floor that closure is a share of: its size, and the part (N, U) of each held-out
    pair's units, clustered as their drops are."""

    size: float
    parts: np.ndarray


@dataclasses.dataclass(frozen=True)
class Bars:
    """What a trial is judged by beside the criteria.

    Attributes:
        least: share of the gap that the lower end of the interval must be above.
        plainly: likewise, where pixels show the effect by themselves.
        rest: share of the gap that earlier causes leave.
    """

    least: float
    plainly: float = np.inf
    rest: float = 1.0


@dataclasses.dataclass(frozen=True)
class Trial:
    """An effect refitted with the base: where it ended, and the share of the gap it closes there.

    Attributes:
        effect: its name.
        z: where the fit ended.
        before, after: the held-out gap without and with it.
        closed: share of the gap that it closes.
        low, high: of a bootstrap's 90 % interval of that.
        bars: what it is judged by.
        choice: what the base became with it; None where it stayed as it was.
        params: the effect's own parameters, where `z` has none for it.
        farther: share by which pixels are farther from the real ones with it.
        surely: lower end of the share where a scene that has more of the gap is drawn with it, widened where
            scenes are few.
        cleared: share of the pixels' distance beyond the noise that goes with it.
        error: what it leaves on the fitted pairs.
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

    @property
    def gain(self) -> float:
        """By how much it lowers the gap."""
        return self.before - self.after

    def possible(self, criteria: Criteria) -> bool:
        """Whether it leaves pixels about where they are, or nearer."""
        return self.farther < criteria.farthest

    def shown(self, criteria: Criteria) -> bool:
        """Whether pixels alone show it: they come nearer by as much as no out-of-library
        effect's have, or by half of what they are off."""
        plainly = self.farther < -criteria.nearer and self.cleared > criteria.cleared
        return self.farther < -criteria.farthest or plainly

    def accepted(self, criteria: Criteria) -> bool:
        """Whether the effect surely closes some of the gap."""
        if self.low <= criteria.smallest or not self.possible(criteria):
            return False
        most = self.closed > criteria.most_of_rest * self.bars.rest
        sure = criteria.smallest * (self.bars.rest if most else 1.0)
        by_statistics = self.low > self.bars.least and self.surely > sure
        return by_statistics or (self.shown(criteria) and self.low > self.bars.plainly)


Cause = tuple[Trial, list[str]]
"""An accepted trial, and the effects that these pairs cannot tell from it."""
