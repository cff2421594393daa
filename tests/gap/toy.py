"""Evidence whose pictures are linear in a few numbers, for the search as it is: a base's, and one an
effect."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from jaxisp.gap.case import Case
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.objective.protocol import NormalEquations, Point
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.stepwise import Terms
from jaxisp.gap.search.trial import Whole
from jaxisp.gap.simulator.effects import Move
from jaxisp.gap.simulator.model import Coordinate, Model, Variant
from jaxisp.pipeline import Chain, stage

TILES, SIDE = 6, 8  # of each pair, and the numbers of a tile
SPLIT = Split((0, 2), (1, 3))
FLOOR = 1.0
_MOVE = Move("x", 0.1, -20.0, 20.0)


def model(effects: Sequence[str]) -> Model:
    """With a coordinate of the base and one of each effect."""
    base = (Coordinate("offset", _MOVE),)
    return Model(
        Chain((stage("srgb_oetf"),)), base, {name: (Coordinate(name, _MOVE),) for name in effects}, {}, {}
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """Pairs of numbers (N, P): `wanted`, and simulated as (P, Z) `design` times z, and what a variant adds.

    Attributes:
        beside: (P,) added times the parameter "variant" of the model.
        distance: of pixels, by which effects are on; None where errors are those of pixels.
        axes: by axis, a direction (P,) whose part of what is left is the axis's.
    """

    wanted: np.ndarray
    design: np.ndarray
    beside: np.ndarray
    split: Split = SPLIT
    names: tuple[str, ...] = ("a", "b", "c", "d")
    choices: tuple[Variant, ...] = ()
    rival: Variant | None = None
    references: Mapping[int, float] = dataclasses.field(default_factory=dict)
    distance: Callable[[set[str]], float] | None = None
    axes: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    follows = False
    compact = False

    def at(self, model: Model, z: np.ndarray) -> Point:
        variant = float(model.shared.get("variant", 0.0))
        left = self.wanted - self.design @ z - variant * self.beside
        return Point(model, z, (left**2).mean(1), (left,))

    def compute(self, point: Point, which: Sequence[int], steps: object = None) -> Point:
        return point.with_columns({**point.columns, **{i: self.design[:, i] for i in which}})

    def normal(self, point: Point, which: Sequence[int]) -> NormalEquations:
        columns, (left,) = np.stack([point.columns[i] for i in which]), point.shown
        gram = np.stack([columns @ columns.T] * len(left)) / left.shape[1]
        return NormalEquations(gram, left @ columns.T / left.shape[1])

    def follow(self, point: Point, to: Point) -> Point:
        return to

    def _take(self, which: Sequence[int], point: Point) -> tuple["Line", Point]:
        part = dataclasses.replace(
            self, wanted=self.wanted[list(which)], split=Split(tuple(range(len(which))), ())
        )
        return part, part.at(point.model, point.z).with_columns(point.columns)

    def fitted(self, point: Point) -> tuple["Line", Point]:
        return self._take(self.split.fit, point)

    def held_out(self, point: Point) -> tuple["Line", Point]:
        return self._take(self.split.held_out, point)

    def units(self, point: Point) -> np.ndarray:
        return (point.shown[0] ** 2).reshape(len(point.errors), TILES, SIDE).mean(2)

    def changes(self, one: Point, other: Point) -> np.ndarray:
        return ((other.shown[0] - one.shown[0]) ** 2).reshape(len(one.errors), TILES, SIDE).mean(2)

    def _of_pixels(self, of: float) -> np.ndarray:
        return np.full(len(self.wanted), of)

    def distances(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        if self.distance is None:
            return None
        on = {c.node for c, value in zip(model.coordinates, z) if abs(value) > 1e-9} - {"offset"}
        return self._of_pixels(self.distance(on))

    def scatter(self, model: Model, z: np.ndarray) -> np.ndarray | None:
        return None if self.distance is None else self._of_pixels(1.0)

    def scenes(self, which: Sequence[int]) -> int | None:
        return None

    def located(self, point: Point) -> tuple[list[dict[str, object]], list[dict[str, object]]]:
        left = point.shown[0][list(self.split.held_out)].mean(0)
        parts = {axis: float(left @ own) ** 2 / float(own @ own) for axis, own in self.axes.items()}
        whole = max(float(left @ left), 1e-12)
        rows = [{"axis": a, "share": v / whole, "p_value": 0.001, "size": v} for a, v in parts.items()]
        return rows, rows

    def sized(self, point: Point) -> list[dict[str, object]]:
        return self.located(point)[0]


def basis(count: int) -> np.ndarray:
    """(TILES SIDE, count) of mean square one and orthogonal in every tile, so that all tiles tell the
    same."""
    tile = np.linalg.qr(np.random.default_rng(0).normal(size=(SIDE, count + 1)))[0] * np.sqrt(SIDE)
    return np.tile(tile, (TILES, 1))


def line(directions: Mapping[str, Sequence[float]], truth: Sequence[float], **more: object) -> Line:
    """Evidence that lacks `truth`, in a space of so many dimensions, above a floor of one.

    Args:
        directions: by effect where in that space it moves the picture; the base's number moves none of it.
        truth: what is wanted.
        more: of `Line`; `beside` is a direction, too, and `axes` names the dimensions.
    """
    own = basis(len(truth) + 1)
    space, offset, rest = own[:, : len(truth)], own[:, len(truth)], own[:, -1]
    design = np.stack([offset, *(space @ np.asarray(d, float) for d in directions.values())], 1)
    wanted = np.stack([space @ np.asarray(truth, float) + np.sqrt(FLOOR) * rest] * 4)
    beside = space @ np.asarray(more.pop("beside", np.zeros(len(truth))), float)
    more["axes"] = {axis: space[:, k] for k, axis in enumerate(more.pop("axes", ()))}
    return Line(wanted, design, beside, **more)


def apart(closes: Mapping[str, float], gap: float = 10.0, **more: object) -> tuple[Line, Point]:
    """Evidence with effects that have nothing in common and close these shares of a gap, at its base."""
    shares = [*closes.values(), max(1 - sum(closes.values()), 0.0)]
    found = line(dict(zip(closes, np.eye(len(shares)))), np.sqrt(gap * np.array(shares)), **more)
    start = model(list(closes))
    return found, found.at(start, np.zeros(len(start.coordinates)))


def terms(evidence: Line, start: Point, kind: str = "clean+noisy", **more: object) -> Terms:
    """Of a search in which an effect must close a twentieth of the gap, and the first a quarter."""
    parts = evidence.units(start)[list(evidence.split.held_out)] - FLOOR
    criteria = dataclasses.replace(CRITERIA[kind], **{"least_of_rest": 0.0} | more.pop("criteria", {}))
    own = {"least": 0.05, "most": 3, "leading": 0.25} | more
    return Terms(criteria, Whole(float(parts.mean()), parts), **own)


def case(evidence: Line, start: Point, kind: str = "clean+noisy", **more: object) -> Case:
    """A diagnosis of it that offers every effect."""
    own = {
        "offered": list(start.model.effects),
        "absorbed": {},
        "floors": np.full(4, FLOOR),
    } | more
    return Case(kind=kind, criteria=CRITERIA[kind], pairs=None, evidence=evidence, point=start, **own)
