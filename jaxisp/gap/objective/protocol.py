"""What a search needs of an objective."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.objective.starts import Ladders
from jaxisp.gap.simulator.model import Choice, Model


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
