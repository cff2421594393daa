"""Gauss-Newton with Levenberg-Marquardt damping, over all chunks of all pairs."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jax.sharding import Mesh

from jaxisp.fit import model, noise
from jaxisp.fit.problem import GEOMETRY, Given, Normal, Problem
from jaxisp.fit.sharing import CAMERA, IMAGE, as_arrays
from jaxisp.fit.spread import Call, each
from jaxisp.fit.state import Equations, Place, Slopes, State, View
from jaxisp.fit.tiles import Chunk
from jaxisp.fit.usual import KINDS, linearised
from jaxisp.pipeline import Params

PATCH = 10.0  # px whose residuals are about as good as one independent one, at the least
HOLD = 1e-5  # what a parameter one unit from its start counts: keeps what shows in nothing where it was
HOLD_ZONES = 1e-3  # of the zones of the tone curve, so that gamma and s-curve explain what they can
HOLD_PLACE = 1e-2  # of the geometry, from what the alignment found
HOLD_BENT = 1e-4  # of the scale under a lens: what the alignment found holds part of the distortion
FEWEST = 3  # surfaces whose scores tell how they vary
SMALLEST_LOSS = 1e-7  # that counts as 1
LONGEST = 1.5  # step on the real line
SMALLEST = 1e-2  # curvature that damping assumes at least
CHORDS = 2  # more steps with one Jacobian, for each costs a tenth of another
WORTH = 2e-3  # of the objective, that such a step must gain


class Fit:
    """One problem on given tiles: evaluates, and takes Gauss-Newton steps.

    The files' own JPEG encoder is rendered, or denoising and sharpening would be bent towards what it
    takes away.

    Args:
        problem: the discrete choices and which parameters move.
        fixed: the parameters that do not.
        views: the tiles of each pair.
        start: what parameters are held near.
        design: the discrete choices.
        now: whose mean loss counts as 1; the start's unless given.
        scale: that loss, where it is known: objectives of several designs compare only with the same.
        statistics: what one noise statistic a tolerance off counts against that loss. It is 0 until tone
            and colour are right: before, the noise would be matched by bending them.
        patches: px whose residuals are about as good as one independent one, by kind of parameters; see
            `patches_at`. They say how much the pixels count against what is known of real cameras.
        mesh: devices that the chunks are spread over; see `spread.each`.
    """

    def __init__(
        self,
        problem: Problem,
        fixed: Params,
        views: Sequence[View],
        start: State,
        design: model.Design,
        *,
        now: State | None = None,
        scale: float | None = None,
        statistics: float = 0.0,
        patches: Mapping[str, float] = dict.fromkeys(KINDS, PATCH),
        mesh: Mesh | None = None,
    ):
        self.statistics, self.encodes = statistics, True
        self.design, self.mesh = design, mesh
        self.median = np.int32(model.MEDIANS.index(design.median))
        self.bends = np.bool_(design.lens)
        self.moving = problem.moving(design.lens, design.median is not None)
        self.problem, self.fixed, self.views, self.start = problem, as_arrays(fixed), tuple(views), start
        self.wanted = np.sum([view.sums for view in views], axis=0)
        stages = (
            [stage for stage, _ in problem.layout.names[CAMERA]],
            [stage for stage, _ in problem.layout.names[IMAGE]],
        )
        holds = [[HOLD_ZONES if s == "zone_curve" else HOLD for s in names] for names in stages]
        place = [HOLD_PLACE] * 2 + [HOLD_BENT if design.lens else HOLD_PLACE] * 2
        self._hold = np.concatenate([holds[0], *[holds[1]] * len(views), *[place] * len(views)])
        # minus two log posteriors are loss / (patch variance) + deviations**2, and the variance of a residual
        # is half a pixel's mean loss (luma, and Cb and Cr at a half); this is in units of the mean loss
        self.patches = {kind: np.float32(patches[kind]) for kind in KINDS}
        self._pixels = np.stack([view.pixels for view in views])
        self._share = 1 / (2 * max(self._pixels.sum(), 1))
        self._origin = problem.layout.bounded(fixed, start.camera, start.images[0])
        self.scale = 1.0
        self.scale = max(self.loss(now or start), SMALLEST_LOSS) if scale is None else scale

    def loss(self, state: State) -> float:
        """Mean robust loss of the pixels."""
        return self.place(state).loss

    def misfit(self, state: State) -> np.ndarray:
        """How far the noise statistics are off, in tolerances: see `noise.misfit`."""
        return self.place(state).rows

    def objective(self, state: State) -> float:
        """What the fit lowers: the loss against that of `now`, the statistics, and the pull of the start."""
        return self.place(state).objective

    def trials(self, state: State, near: Any = None) -> list[tuple[int, Chunk, Normal]]:
        """All chunks rendered: which pair, the chunk, and what came of it; `near` as of `spread.each`."""
        parts, _ = self.each(lambda at: self._call(state, at[0], at[1], still=True), self._chunks, near)
        return [(*at, part) for at, part in zip(self._chunks, parts)]

    def each(self, call: Callable[[Any], Call], items: Sequence[Any], near: Any = None) -> Any:
        """`spread.each` on the devices of this fit."""
        return each(self.problem, call, items, self.mesh, near)

    def _call(self, state: State, pair: int, chunk: Chunk, still: bool = False) -> Call:
        given = self.given(pair)
        if still:
            given = given._replace(moving=np.zeros_like(self.moving))
        return given, self.vector(state, pair), chunk

    @property
    def _chunks(self) -> list[tuple[int, Chunk]]:
        """All of them, with their pair."""
        return [(i, chunk) for i, view in enumerate(self.views) for chunk in view.chunks]

    def without_sampling(self) -> "Fit":
        """The same, with chroma sampling left to an encoder."""
        other = self.without_encoder()
        other.fixed = self.fixed | as_arrays(model.sampled(None))
        return other

    def beside(self, other: "Fit") -> "Fit":
        """The same camera on the pairs of another fit."""
        moved = copy.copy(self)
        moved.views = other.views
        return moved

    def without_encoder(self) -> "Fit":
        """The same, compared before the encoder."""
        other = copy.copy(self)
        other.encodes = False
        return other

    def given(self, pair: int, geometry: np.ndarray | None = None) -> Given:
        """What is known of a pair; `geometry`: another shift and scale than the alignment's."""
        view = self.views[pair]
        absent = self.problem.encoder.init() if self.problem.encoder else {}
        encoder = absent if view.encoder is None else view.encoder
        geometry = view.geometry if geometry is None else geometry
        encodes = np.bool_(self._encodes(pair))
        return Given(self.fixed, self.median, geometry, self.bends, encodes, encoder, self.moving)

    def _encodes(self, pair: int) -> bool:
        return self.encodes and self.views[pair].encoder is not None

    def _eight_bits(self, pair: int, sums: Any) -> np.ndarray:
        """The sums for the noise statistics as rounding leaves them, where the encoder did not round yet."""
        return np.asarray(sums, np.float64) if self._encodes(pair) else noise.rounded(sums)

    def vector(self, state: State, pair: int) -> np.ndarray:
        """That of one pair: camera, image and geometry."""
        return np.concatenate([state.camera, state.images[pair], state.places[pair]]).astype(np.float32)

    def _index(self, pair: int) -> np.ndarray:
        """Where the columns of one pair stand among all."""
        cameras, images = len(self.start.camera), len(self.start.images[0])
        own = cameras + images * pair + np.arange(images)
        place = cameras + images * len(self.views) + len(GEOMETRY) * pair + np.arange(len(GEOMETRY))
        return np.concatenate([np.arange(cameras), own, place])

    def _pull(self, state: State) -> tuple[float, np.ndarray, np.ndarray]:
        """What deviations from the start and from real cameras count, with gradient and curvature."""
        deviation = _flat(state) - _flat(self.start)
        value, vector = float(self._hold @ deviation**2), self._hold * deviation
        matrix, cameras = np.diag(self._hold), len(state.camera)
        layout, start = self.problem.layout, self._origin
        pairs = len(self.views) if len(state.images[0]) else 1
        for i in range(pairs):
            index = self._index(i)[: cameras + len(state.images[i])]
            stated = not self.design.sampling  # where there is a JPEG file
            vectors = state.camera, state.images[i]
            found = linearised(layout, stated, self.fixed, start, self.patches, *vectors)
            rows, jacobian = (np.asarray(part, np.float64) for part in found)
            share = self._share / pairs
            value += share * float(rows @ rows)
            vector[index] += share * (jacobian.T @ rows)
            matrix[np.ix_(index, index)] += share * (jacobian.T @ jacobian)
        return value, vector, matrix

    def place(self, state: State, near: Equations | None = None) -> Place:
        """The objective at a state, and its gradient with the Jacobians of a place nearby."""
        vector, total, weight = np.zeros(len(self._hold)), 0.0, 0.0
        sums = np.zeros_like(self.wanted)
        for i, _, part in self.trials(state, near.jacobians if near else None):
            total, weight = total + float(part.loss), weight + float(part.weight)
            sums = sums + self._eight_bits(i, part.sums)
            vector[self._index(i)] += np.asarray(part.chord)
        rows = noise.misfit(sums, self.wanted)
        misfit, soft = _softened(rows)
        pull, pulls, _ = self._pull(state)
        objective = total / weight / self.scale + self.statistics * misfit + pull
        gradient = vector / (weight * self.scale) + pulls
        if near is not None:
            gradient += self.statistics * (near.slopes * soft) @ rows
        return Place(float(objective), gradient, total / weight, rows)

    @staticmethod
    def mean_loss(known: Slopes) -> float:
        """What `loss` is where these slopes are."""
        return sum(float(part.loss) for part in known.parts) / sum(float(part.weight) for part in known.parts)

    def slopes(self, state: State) -> Slopes:
        """All chunks with their derivatives at a state."""
        return Slopes(*self.each(lambda at: self._call(state, at[0], at[1]), self._chunks))

    def equations(self, state: State, known: Slopes | None = None) -> Equations:
        """The objective at a state, its gradient and its Gauss-Newton matrix; `known`: its slopes."""
        size = len(self._hold)
        data, vector, total, weight = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
        sums, slopes = np.zeros_like(self.wanted), np.zeros((size, len(self.wanted)))
        scores = np.zeros((len(self.views), len(self._pixels[0]), size))
        parts, jacobians = known or self.slopes(state)
        for (i, _), part in zip(self._chunks, parts):
            index = self._index(i)
            data[np.ix_(index, index)] += np.asarray(part.matrix, np.float64)
            vector[index] += np.asarray(part.vector, np.float64)
            scores[i][:, index] += np.asarray(part.scores, np.float64)
            slopes[index] += np.asarray(part.slopes, np.float64)
            sums += self._eight_bits(i, part.sums)
            total, weight = total + float(part.loss), weight + float(part.weight)
        there = self._pixels > 0
        apart = scores[there] - self._pixels[there][:, None] / self._pixels.sum() * vector
        rows = noise.misfit(sums, self.wanted)
        misfit, soft = _softened(rows)
        jacobian = _slopes_of_misfit(sums, self.wanted, slopes)
        pull, pulls, stiffness = self._pull(state)
        share = 1 / (weight * self.scale)
        matrix = share * data + self.statistics * (jacobian * soft) @ jacobian.T + stiffness
        right = share * vector + self.statistics * (jacobian * soft) @ rows + pulls
        objective = float(share * total + self.statistics * misfit + pull)
        return Equations(objective, matrix, right, data, apart, total, weight, jacobian, jacobians)

    def patches_at(self, state: State, known: Slopes | None = None) -> dict[str, float]:
        """By kind of parameters: how many pixels' residuals are about as good as one independent one."""
        at, names = self.equations(state, known), self.problem.layout.names
        stages = [stage for stage, _ in (*names[CAMERA], *names[IMAGE] * len(self.views))]
        return {kind: patch_at(at, np.flatnonzero(np.isin(stages, own))) for kind, (_, own) in KINDS.items()}

    def run(
        self,
        state: State,
        steps: int,
        tick: Callable[[State], Any] = lambda state: None,
        tolerance: float = 1e-3,
        known: Slopes | None = None,
    ) -> State:
        """At most `steps` Gauss-Newton steps; ends where they no longer lower the objective.

        Args:
            state: where to start.
            steps: at most.
            tick: called after each.
            tolerance: share of the objective that a step must gain, or the one after it.
            known: the slopes at `state`.
        """
        while state.done < steps and state.idle < 2:
            known = known or self.slopes(state)
            before = self.equations(state, known)
            after = self._step(dataclasses.replace(state, objective=before.objective), before)
            gain = before.objective - after.objective
            if gain > 0:
                known = None  # as large as all that was rendered
            state = dataclasses.replace(
                after, idle=after.idle + 1 if gain < tolerance * before.objective else 0
            )
            del before
            tick(state)
        return state

    def beginning(self, state: State, at: Equations, place: Place | None = None) -> State:
        """A few steps with the equations of another choice, or of a place nearby; each only renders.

        Args:
            state: where to start.
            at: the equations.
            place: what `place` gives for both, where that is known.

        Returns:
            where they end; `idle` where a step lowered the objective no more: they would end there again.
        """
        place = place or self.place(state, at)
        for _ in range(1 + CHORDS):
            there, further = self._moved(state, at, place.vector, state.damping)
            if not further.objective < place.objective:
                state = dataclasses.replace(state, idle=1)
                break
            state, place = there, further
        return dataclasses.replace(state, objective=place.objective)

    def _step(self, state: State, at: Equations) -> State:
        """One step, damped until it lowers the objective; then on with the same matrix while that pays."""
        damping = state.damping
        for _ in range(5):
            there, place = self._moved(state, at, at.vector, damping)
            if place.objective < at.objective:
                break
            damping *= 6
        else:
            return dataclasses.replace(state, damping=min(damping, 1e3), done=state.done + 1)
        for _ in range(CHORDS):
            further, value = self._moved(there, at, place.vector, damping)
            if not value.objective < place.objective - WORTH * at.objective:
                break
            there, place = further, value
        return dataclasses.replace(
            there, objective=place.objective, damping=max(damping / 5, 1e-5), done=state.done + 1
        )

    def _moved(self, state: State, at: Equations, vector: np.ndarray, damping: float) -> tuple[State, Place]:
        diagonal = at.matrix.diagonal() + SMALLEST
        step = np.linalg.solve(at.matrix + damping * np.diag(diagonal), -vector)
        there = state.moved(np.clip(step, -LONGEST, LONGEST))
        return there, self.place(there, at)


def patch_at(at: Equations, columns: np.ndarray) -> float:
    """How many pixels' residuals are about as good as one independent one, PATCH at least.

    Were residuals independent, the scores of the surfaces would vary as the curvature says. How much more
    they vary is measured, and it includes what no camera of this kind can render: that is alike in all that
    has one colour. Directions that the pixels say nothing of are left out.

    Source: Pauli, Racugno and Ventura 2011, "Bayesian composite marginal likelihoods": the magnitude
    adjustment; with the clusters' scores of Liang and Zeger 1986, "Longitudinal data analysis using
    generalized linear models".
    """
    count = len(at.scores)
    if count < FEWEST or not len(columns):
        return PATCH
    scores, data = at.scores[:, columns], at.data[np.ix_(columns, columns)]
    variance = at.loss / at.weight / 2
    told = np.linalg.inv(data + PATCH * variance * np.eye(len(data)))
    vary = np.einsum("ci,ij,cj", scores, told, scores) * count / (count - 1)
    return max(PATCH, float(vary / max(np.einsum("ij,ji", told, data) * variance, 1e-12)))


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
