"""What a fit and a search ask of an objective, and the points that they pass and return.

An objective and a point are immutable: a step makes another point, a change of units another objective.
Threads share both.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from jaxisp.gap.axes import Rows
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.simulator.model import Model, Variant


@dataclasses.dataclass(frozen=True, eq=False)
class Point:
    """A model at a place, with what an objective found there.

    Attributes:
        model: the simulator.
        z: (Z,) where it is, in the model's coordinates.
        errors: (N,) mean square error of each pair, in the objective's unit.
        shown: what the errors are of: pictures, or statistics and means of blocks.
        columns: by coordinate, the change of `shown` per unit of z, as far as computed.
        normals: by coordinates, normal equations that were computed here; their columns may be gone.
    """

    model: Model
    z: np.ndarray
    errors: np.ndarray
    shown: tuple[np.ndarray, ...] = ()
    columns: Mapping[int, np.ndarray] = dataclasses.field(default_factory=dict)
    normals: Mapping[tuple[int, ...], "NormalEquations"] = dataclasses.field(default_factory=dict)

    @property
    def error(self) -> float:
        """The mean over pairs."""
        return float(self.errors.mean())

    def with_columns(self, columns: Mapping[int, np.ndarray]) -> "Point":
        """The same point with these columns in place of its own."""
        return dataclasses.replace(self, columns=dict(columns))


class NormalEquations(NamedTuple):
    """Of each pair: (N, K, K) products of columns, and (N, K) of columns with what is left."""

    gram: np.ndarray
    slope: np.ndarray


class Objective(Protocol):
    """What a fit minimises: the mean of `Point.errors`."""

    @property
    def follows(self) -> bool:
        """Whether columns may be taken along to another point."""

    @property
    def compact(self) -> bool:
        """Whether columns are so small that those of all effects can be kept at once."""

    def at(self, model: Model, z: np.ndarray) -> Point:
        """Evaluate the errors of a model at z."""

    def compute(self, point: Point, which: Sequence[int], steps: Mapping[int, float] | None = None) -> Point:
        """Add the columns of these coordinates that the point lacks, as secants.

        Args:
            point: where.
            which: the coordinates.
            steps: how far some are moved, where that is not the model's own probe.
        """

    def normal(self, point: Point, which: Sequence[int]) -> NormalEquations:
        """The normal equations for these columns of the point."""

    def follow(self, point: Point, to: Point) -> Point:
        """The point `to` with the columns of `point`, corrected by what the way there showed."""


class Evidence(Objective, Protocol):
    """What a search needs beside: which pairs are held out, and what they say."""

    @property
    def split(self) -> Split:
        """The pairs that are fitted, and those held out."""

    @property
    def names(self) -> tuple[str, ...]:
        """(N,) of the pairs."""

    @property
    def choices(self) -> Sequence[Variant]:
        """Variants of the base that no coordinate describes."""

    @property
    def rival(self) -> Variant | None:
        """The variant beside which effects are screened too: the base may owe its own to one of them."""

    @property
    def references(self) -> Mapping[int, float]:
        """By coordinate, the value at which it does what the file does anyway."""

    def fitted(self, point: Point) -> tuple["Evidence", Point]:
        """The objective of the fitted pairs alone, for a fit that starts at this point; and the point
        there."""

    def held_out(self, point: Point) -> tuple["Evidence", Point]:
        """The objective reporting the held-out pairs alone, and the point there."""

    def units(self, point: Point) -> np.ndarray:
        """(N, U) parts that the error of each pair is the mean of, for intervals."""

    def changes(self, one: Point, other: Point) -> np.ndarray:
        """(N, U) mean square of what two points show differently, in the unit and the parts of `units`."""

    def distances(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """(N,) mean square distance of pixels from what is simulated on average; None where `errors` are
        it."""

    def scatter(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        """(N,) mean square of the simulated noise; None where nothing is random."""

    def located(self, point: Point) -> tuple[Rows, Rows]:
        """The axes of the held-out pairs' error: as verdicts use them, and as they are reported."""

    def sized(self, point: Point) -> Rows:
        """The axes of the held-out pairs' error by their shares alone, which signs look at; p-values may be
        missing."""

    def scenes(self, which: Sequence[int]) -> int | None:
        """How many independent scenes these pairs show; None where tiles are drawn beside pairs."""
