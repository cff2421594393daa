"""How the denoisers of a diagnosis are trained."""

import dataclasses
from pathlib import Path

from jaxisp.errors import InputError


@dataclasses.dataclass(frozen=True)
class Downstream:
    """How the denoisers are trained.

    Attributes:
        steps: updates of each, on 8 patches of 48x48 px.
        seeds: one denoiser an arm and seed: of its first weights and its patches.
        keep: a file for the figures of denoisers that are done: a second call with the same data and
            simulators trains those that are missing only. None: nothing is kept.
    """

    steps: int = 500
    seeds: tuple[int, ...] = (0, 1, 2)
    keep: Path | None = None

    def __post_init__(self) -> None:
        if self.steps < 1 or not self.seeds:
            raise InputError(f"downstream: {self.steps} steps, {len(self.seeds)} seeds; expected 1 or more")
