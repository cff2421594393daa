"""What the search for a cause needs of a problem, and which of its pairs are fitted."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxisp.errors import InputError
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG

LEAST_UNIT = {RAW_JPEG: 4.0, CLEAN_NOISY: 0.0}
"""The floor that thresholds are shares of, at least. In squared 8-bit steps most compressed files have 4 to
36; what is harmless is no smaller where a file is not compressed, and its floor 0.1."""
NULL_EXCESS = {RAW_JPEG: 0.5, CLEAN_NOISY: 1.0}
"""How far above the floor, as a share of it, the gap of a camera that lacks nothing may be: its demosaicker
and its order of steps are not quite the base's."""
NULL_DROP = {RAW_JPEG: 0.1, CLEAN_NOISY: 0.7}
"""By how much, as a share of the floor, an effect may lower that camera's gap all the same;
`experiments.null_drops` measures it (RAW+JPEG: docs/results/null-drops.md)."""


class Gap(NamedTuple):
    """On the held-out pairs, at the base; `least` is the unit where the floor is below."""

    before: float
    floor: float
    least: float = 0.0

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


@dataclasses.dataclass(frozen=True)
class Case:
    """What is diagnosed: the problem at its base, who is held out, and what may be its cause.

    Attributes:
        floors: (N,) the gap of each pair that a right simulator would leave.
        absorbed: what the base took up of each effect that is part of it; None where that was not measured.
        offered: effects that are tried.
        stored: what the file does to the pictures, where grain is to be told from it.
        given: what the base is, where it was given; None where a plain one was fitted.
        open_nodes: what of a given base was fitted beside its coordinates.
        seen: effects that the files themselves show, whatever else explains the gap.
        unsaid: effects that are part of the base and that these pairs say nothing of.
        strays: pairs that were left out, since the base's tones do not carry over to them.
        reference: (N, H, W, 3) encoded sRGB, where there are clean pictures: these in the noisy ones' tones.
    """

    kind: str
    problem: Any
    split: Split
    floors: np.ndarray
    absorbed: Mapping[str, float | None]
    offered: list[str]
    stored: np.ndarray | None = None
    given: str | None = None
    open_nodes: tuple[str, ...] = ()
    seen: tuple[str, ...] = ()
    unsaid: tuple[str, ...] = ()
    strays: tuple[str, ...] = ()
    reference: np.ndarray | None = None


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


Tick = Callable[[int, int, str], Any]


MOST_CAUSES = 3
