"""What the search for a cause needs of a problem, and which of its pairs are fitted."""

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxisp.errors import InputError
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG
from jaxisp.gap.simulator.model import Choice, Model

Rows = Sequence[dict[str, Any]]
"""Axes, as `where` of report.json has them."""

Ladders = list[list[np.ndarray]]
"""Points to begin at; those of one list differ in how much noise the base has, from rung to rung more."""


class Measured(Protocol):
    """What the search needs; see `jaxisp.gap.objective.pixels.Problem`."""

    model: Model
    z: np.ndarray
    columns: dict[int, np.ndarray]
    choices: Sequence[Choice]
    rival: Choice | None  # beside which effects are screened too: the base may owe its own to one of them
    references: Mapping[int, float]  # where a coordinate does what the file does anyway
    fresh: Sequence[int]  # coordinates whose columns change with every step

    def placed(self, z: np.ndarray, i: int, value: float) -> np.ndarray: ...
    def noisier(self, z: np.ndarray, i: int) -> Ladders: ...
    def starts(self, own: Sequence[int]) -> list[Ladders]: ...
    def units(self, z: np.ndarray) -> np.ndarray: ...
    def errors(self, z: np.ndarray) -> np.ndarray: ...
    def distances(self, z: np.ndarray) -> np.ndarray | None: ...
    def scatter(self, z: np.ndarray) -> np.ndarray | None: ...
    def located(self, held: Sequence[int]) -> Rows: ...
    def credited(self, rows: Rows, held: Sequence[int]) -> Rows: ...
    def clustered(self, values: np.ndarray, which: Sequence[int]) -> np.ndarray: ...
    def scenes(self, which: Sequence[int]) -> int | None: ...
    def compute(self, which: Sequence[int], steps: Mapping[int, float] | None = None) -> None: ...
    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]: ...
    def move_to(self, z: np.ndarray) -> None: ...
    def choose(self, choice: Choice) -> None: ...
    def take(self, which: Sequence[int]) -> "Measured": ...


class Part:
    """Some of the pairs of a problem that can be measured only together."""

    choices: Sequence[Choice] = ()

    def __init__(self, whole: Any, which: Sequence[int]) -> None:
        self.__dict__["_whole"], self.__dict__["_which"] = copy.copy(whole), list(which)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._whole, name, value)

    def units(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(self._whole.units(z)[self._which])

    def errors(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(self._whole.errors(z)[self._which])

    def distances(self, z: np.ndarray) -> np.ndarray | None:
        found = self._whole.distances(z)
        return None if found is None else np.asarray(found[self._which])

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        gram, slope = self._whole.normal(which)
        return gram[self._which], slope[self._which]


@dataclasses.dataclass(frozen=True)
class Split:
    """Pairs that parameters are fitted on, and those that every figure comes from."""

    fit: tuple[int, ...]
    held_out: tuple[int, ...]


LEAST_UNIT = {RAW_JPEG: 4.0, CLEAN_NOISY: 0.0}
"""The floor that thresholds are shares of, at least. In squared 8-bit steps most compressed files have 4 to
36; what is harmless is no smaller where a file is not compressed, and its floor 0.1."""
NULL_EXCESS = {RAW_JPEG: 0.5, CLEAN_NOISY: 1.0}
"""How far above the floor, as a share of it, the gap of a camera that lacks nothing may be: its demosaicker
and its order of steps are not quite the base's."""
NULL_DROP = {RAW_JPEG: 0.1, CLEAN_NOISY: 0.7}
"""By how much, as a share of the floor, an effect may lower that camera's gap all the same;
`experiments.null_drops` measures it (RAW+JPEG: docs/results/null-drops.json)."""


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
