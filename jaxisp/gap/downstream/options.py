"""Training options of the denoisers of a diagnosis."""

import dataclasses
from pathlib import Path

from jaxisp.errors import InputError


@dataclasses.dataclass(frozen=True)
class Downstream:
    """Training options of the denoisers.

    Attributes:
        steps: number of updates, each on 8 patches of 48x48 px; at least 1.
        seeds: seeds of initial weights and patches; each arm trains one denoiser for each seed.
        keep: file that stores the figures of trained denoisers. Another call with the same data and
            simulators trains only the missing ones. None: nothing is stored.
    """

    steps: int = 500
    seeds: tuple[int, ...] = (0, 1, 2)
    keep: Path | None = None

    def __post_init__(self) -> None:
        if self.steps < 1 or not self.seeds:
            raise InputError(f"downstream: {self.steps} steps, {len(self.seeds)} seeds; expected 1 or more")
