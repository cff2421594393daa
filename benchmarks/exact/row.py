"""One row of the table of exactness."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """What was compared, and how it came out.

    Attributes:
        stage: what of ours.
        reference: what it is compared with, and its version.
        ran: the cases, in words.
        worst: the worst figure over all of them.
        must: its bound, an upper one unless `at_least`.
        unit: of both.
    """

    stage: str
    reference: str
    ran: str
    worst: float
    must: float
    unit: str = ""
    at_least: bool = False

    @property
    def passed(self) -> bool:
        """False for NaN too."""
        return bool(self.worst >= self.must if self.at_least else self.worst <= self.must)


def largest(got: Any, want: Any) -> float:
    """The largest absolute difference, in double precision; NaN where either has one."""
    return float(np.max(np.abs(np.asarray(got, np.float64) - np.asarray(want, np.float64))))
