"""Gauss-Newton with Levenberg-Marquardt damping, over all chunks of all pairs."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from jaxisp.fit import model, noise
from jaxisp.fit.program import GEOMETRY, Given, Normal, Problem, Trial, normal_equations, sums_of, trial
from jaxisp.fit.sharing import CAMERA, IMAGE
from jaxisp.fit.tiles import Chunk
from jaxisp.pipeline import Params

HOLD = 1e-5  # what a parameter one unit from its start counts: keeps what is unidentifiable where it was
HOLD_ZONES = 1e-3  # of the zones of the tone curve, so that gamma and s-curve explain what they can
HOLD_PLACE = 1e-2  # of the geometry, from what the alignment found
LONGEST = 1.5  # step on the real line
SMALLEST = 1e-2  # curvature that damping assumes at least

_COMPILED: set[Problem] = set()


class View(NamedTuple):
    """The tiles of one pair as they are fitted: demosaicked, and where they lie."""

    chunks: tuple[Chunk, ...]
    geometry: np.ndarray


@dataclasses.dataclass(frozen=True)
class State:
    """A fit under way: one vector for the camera, one a pair for the image and its geometry."""

    camera: np.ndarray
    images: tuple[np.ndarray, ...]
    places: tuple[np.ndarray, ...]
    damping: float = 1e-2
    objective: float = float("inf")
    done: int = 0
    idle: int = 0

    def moved(self, step: np.ndarray, **changes: Any) -> "State":
        flat = np.concatenate([self.camera, *self.images, *self.places]) + step
        sizes = [len(v) for v in (self.camera, *self.images, *self.places)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        n = len(self.images)
        return dataclasses.replace(
            self, camera=parts[0], images=tuple(parts[1 : 1 + n]), places=tuple(parts[1 + n :]), **changes
        )


@dataclasses.dataclass(frozen=True)
class Equations:
    """All chunks together: the Hessian and the gradient of the objective in the order of a `State`."""

    objective: float
    matrix: np.ndarray
    vector: np.ndarray
    data: np.ndarray
    """The part of `matrix` that the pixels give, in squared levels."""
    loss: float
    weight: float
    sums: np.ndarray


class Fit:
    """One problem on given tiles: evaluates, and takes Gauss-Newton steps.

    Args:
        problem: the discrete choices and which parameters move.
        fixed: the parameters that do not.
        views: the tiles of each pair.
        start: what parameters are held near.
        median: footprint of the median filter.
        now: whose mean loss counts as 1; the start's unless given.
        statistics: what one noise statistic a tolerance off counts against that loss. It is 0 until tone
            and colour are right: before, the noise would be matched by bending them.
        correction: what the JPEG encoder, which is not in the loss, adds to each statistic.
    """

    def __init__(
        self,
        problem: Problem,
        fixed: Params,
        views: Sequence[View],
        start: State,
        *,
        median: str | None = None,
        now: State | None = None,
        statistics: float = 0.0,
        correction: np.ndarray | float = 0.0,
    ):
        self.statistics, self.correction = statistics, correction
        self.median = np.int32(model.MEDIANS.index(median))
        self.problem, self.fixed, self.views, self.start = problem, fixed, tuple(views), start
        own = [np.asarray(sums_of(c.target, c), np.float64) for v in views for c in v.chunks]
        self.wanted: np.ndarray = np.sum(own, axis=0)
        stages = (
            [stage for stage, _ in problem.layout.names[CAMERA]],
            [stage for stage, _ in problem.layout.names[IMAGE]],
        )
        holds = [[HOLD_ZONES if s == "zone_curve" else HOLD for s in names] for names in stages]
        place = [HOLD_PLACE] * len(GEOMETRY)
        self._hold = np.concatenate([holds[0], *[holds[1]] * len(views), *[place] * len(views)])
        self.scale = 1.0
        self._warm_up()
        self.scale = max(self.loss(now or start), 1e-7)

    def _warm_up(self) -> None:
        """Compile the two programs side by side, where they are not compiled yet."""
        if self.problem in _COMPILED:
            return
        _COMPILED.add(self.problem)
        view = self.views[0]
        given, vector = self._given(view), self._vector(self.start, 0)
        with ThreadPoolExecutor(1) as pool:
            other = pool.submit(normal_equations, self.problem, given, vector, view.chunks[0])
            trial(self.problem, given, vector, view.chunks[0])
            other.result()

    def loss(self, state: State) -> float:
        """Mean robust loss of the pixels."""
        total, weight, _ = self._sum(state)
        return total / weight

    def objective(self, state: State) -> float:
        total, weight, sums = self._sum(state)
        return self._objective(state, total / weight, sums)

    def _sum(self, state: State) -> tuple[float, float, np.ndarray]:
        total, weight, sums = 0.0, 0.0, np.zeros_like(self.wanted)
        for _, _, part in self.trials(state):
            total, weight = total + float(part.loss), weight + float(part.weight)
            sums = sums + np.asarray(part.sums)
        return total, weight, noise.rounded(sums)

    def trials(self, state: State) -> Iterator[tuple[int, Chunk, Trial]]:
        """All chunks rendered: which pair, the chunk, and what came of it."""
        for i, view in enumerate(self.views):
            for chunk in view.chunks:
                yield i, chunk, trial(self.problem, self._given(view), self._vector(state, i), chunk)

    def _given(self, view: View) -> Given:
        return Given(self.fixed, self.median, view.geometry)

    def _vector(self, state: State, pair: int) -> np.ndarray:
        return np.concatenate([state.camera, state.images[pair], state.places[pair]]).astype(np.float32)

    def _deviation(self, state: State) -> np.ndarray:
        return _flat(state) - _flat(self.start)

    def _objective(self, state: State, loss: float, sums: np.ndarray) -> float:
        held = (self._hold * self._deviation(state) ** 2).sum()
        misfit = _softened(noise.misfit(sums, self.wanted) + self.correction)[0]
        return float(loss / self.scale + self.statistics * misfit + held)

    def equations(self, state: State) -> Equations:
        """The objective at a state, its gradient and its Gauss-Newton matrix."""
        cameras, images = len(state.camera), len(state.images[0])
        size = len(self._hold)
        data, vector, total, weight = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
        sums, slopes = np.zeros_like(self.wanted), np.zeros((size, len(self.wanted)))
        for i, view in enumerate(self.views):
            own = cameras + images * i + np.arange(images)
            place = cameras + images * len(self.views) + len(GEOMETRY) * i + np.arange(len(GEOMETRY))
            index = np.concatenate([np.arange(cameras), own, place])
            for chunk in view.chunks:
                part = _numpy(
                    normal_equations(self.problem, self._given(view), self._vector(state, i), chunk)
                )
                data[np.ix_(index, index)] += part.matrix
                vector[index] += part.vector
                slopes[index] += part.slopes
                sums += part.sums
                total, weight = total + float(part.loss), weight + float(part.weight)
        sums = noise.rounded(sums)
        matrix, right = data / (weight * self.scale), vector / (weight * self.scale)
        rows = noise.misfit(sums, self.wanted) + self.correction
        jacobian = _slopes_of_misfit(sums, self.wanted, slopes)
        soft = _softened(rows)[1]
        matrix = matrix + self.statistics * (jacobian * soft) @ jacobian.T + np.diag(self._hold)
        right = right + self.statistics * (jacobian * soft) @ rows + self._hold * self._deviation(state)
        objective = self._objective(state, total / weight, sums)
        return Equations(objective, matrix, right, data, total, weight, sums)

    def run(
        self,
        state: State,
        steps: int,
        tick: Callable[[State], Any] = lambda state: None,
        tolerance: float = 2e-4,
    ) -> State:
        """At most `steps` Gauss-Newton steps; ends where they no longer lower the objective."""
        while state.done < steps and state.idle < 2:
            before = self.equations(state)
            state = self._step(dataclasses.replace(state, objective=before.objective), before)
            gain = before.objective - state.objective
            state = dataclasses.replace(
                state, idle=state.idle + 1 if gain < tolerance * before.objective else 0
            )
            tick(state)
        return state

    def _step(self, state: State, at: Equations) -> State:
        damping, diagonal = state.damping, at.matrix.diagonal() + SMALLEST
        for _ in range(5):
            step = np.linalg.solve(at.matrix + damping * np.diag(diagonal), -at.vector)
            step = np.clip(step, -LONGEST, LONGEST)
            there = state.moved(step)
            value = self.objective(there)
            if np.isfinite(value) and value < at.objective:
                return dataclasses.replace(
                    there, objective=value, damping=max(damping / 5, 1e-5), done=state.done + 1
                )
            damping *= 6
        return dataclasses.replace(state, damping=min(damping, 1e3), done=state.done + 1)


def _flat(state: State) -> np.ndarray:
    return np.concatenate([state.camera, *state.images, *state.places])


def _softened(rows: np.ndarray) -> tuple[float, np.ndarray]:
    """A robust sum of squares, and the weight of each: a statistic far off must not outweigh the picture."""
    root = np.sqrt(1 + (rows / 3) ** 2)
    return float((rows**2 * 2 / (1 + root)).sum()), 1 / root


def _slopes_of_misfit(sums: np.ndarray, wanted: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """(n, m): how each statistic moves with each parameter, by the chain rule."""
    base = noise.misfit(sums, wanted)
    step = 1e-3
    return np.stack([(noise.misfit(sums + step * s, wanted) - base) / step for s in slopes])


def _numpy(part: Normal) -> Normal:
    return Normal(*(np.asarray(p, np.float64) for p in part))
