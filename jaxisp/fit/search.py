"""The discrete choices, one after another, with one compiled program; and the phases of a fit."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from jaxisp.fit import model, noise
from jaxisp.fit.begin import begin
from jaxisp.fit.journal import Journal
from jaxisp.fit.program import GEOMETRY, Problem, sums_of
from jaxisp.fit.sharing import CAMERA, IMAGE, Layout, sharing
from jaxisp.fit.solve import Fit, State, View
from jaxisp.fit.tiles import Shot, with_source
from jaxisp.pipeline import Chain, Params, run_batch

STATISTICS = 0.004  # weight of each noise statistic in the last phase, against the loss of the one before
TRIAL = 1  # steps that each discrete choice gets: a second one changes no ranking
GAIN = 0.998  # of the objective, that a more elaborate choice must reach
FIRST_STEPS, LAST_STEPS = 14, 16

Tick = Callable[[int, int, str], Any]


@dataclasses.dataclass(frozen=True)
class Options:
    """What the caller may settle: "auto" is searched for.

    Args:
        steps: most Gauss-Newton steps of each of the two main phases.
        demosaic: a stage, or "auto".
        median: a footprint, "none", or "auto".
        place: where denoising is; see `model.Design`.
        per_image: parameters that each image has of its own; see `sharing`.
        fixed: parameters that are not fitted.
    """

    steps: int
    demosaic: str
    median: str
    place: str
    per_image: tuple[str, ...]
    fixed: tuple[str, ...]

    @property
    def first(self) -> model.Design:
        demosaic = model.DEMOSAICKERS[0] if self.demosaic == "auto" else self.demosaic
        return model.Design(demosaic, 0, self._median, self.place)

    @property
    def _median(self) -> str | None:
        return None if self.median in ("auto", "none") else self.median

    @property
    def trials(self) -> int:
        """How many discrete choices are tried at most."""
        demosaickers = len(model.DEMOSAICKERS) if self.demosaic == "auto" else 0
        return demosaickers + (len(model.MEDIANS) - 1 if self.median == "auto" else 0)


@dataclasses.dataclass
class Outcome:
    """Where a search ended: the design, its parameters and what was tried."""

    design: model.Design
    fit: Fit
    state: State
    start: Params
    losses: list[float]
    tried: list[tuple[str, float]]


class Search:
    """Fits the shots: first everything with plain choices, then each choice a little, then the best.

    Args:
        shots: the pairs.
        options: what is settled.
        journal: where the states go.
        tick: progress.
    """

    def __init__(self, shots: Sequence[Shot], options: Options, journal: Journal, tick: Tick):
        self.shots, self.options, self.journal, self.tick = tuple(shots), options, journal, tick
        self.losses: list[float] = []
        self.tried: list[tuple[str, float]] = []
        self._sources: dict[tuple[str, int], tuple[View, ...]] = {}
        self.start = begin(self.views(options.first))
        flags = sharing(self.start, options.per_image, options.fixed)
        self.problem = Problem(options.place, Layout.of(self.start, flags))
        self.origin = self._origin()
        self._done, self._total = 0, self._planned()

    def views(self, design: model.Design) -> tuple[View, ...]:
        """The tiles with the design's demosaicking; those of the last few designs are kept."""
        key = design.demosaic, design.passes
        if key not in self._sources:
            while len(self._sources) > 1:
                self._sources.pop(next(iter(self._sources)))
            self._sources[key] = tuple(
                View(tuple(with_source(c, shot.cfa, design) for c in shot.chunks), _geometry(shot))
                for shot in self.shots
            )
        return self._sources[key]

    def run(self) -> Outcome:
        """All phases."""
        design, steps = self.options.first, self.options.steps
        state = self._run("first", self._fit(design), self.origin, min(steps, FIRST_STEPS))
        best = design
        for group in (self._demosaickers, self._passes, self._medians):
            others = list(group(best))
            if not others:
                continue
            trials = {d: self._try(group.__name__, d, state) for d in others}
            plain = self._fit(best, now=self.origin).objective(state)
            self.tried.append((best.text, plain))
            chosen = min(trials, key=lambda d: trials[d].objective)
            if trials[chosen].objective < GAIN * plain:
                best, state = chosen, trials[chosen]
        return self.finish(best, state)

    def finish(self, design: model.Design, state: State, name: str = "last") -> Outcome:
        """The last phase, in two rounds: on from `state` with the noise statistics in the objective."""
        steps, now = -(-min(self.options.steps, LAST_STEPS) // 2), state
        for turn in (1, 2):
            correction = self._encoder(self._fit(design, whole=True, now=now), now)
            fit = self._fit(design, whole=True, now=state, statistics=STATISTICS, correction=correction)
            fresh = dataclasses.replace(now, done=0, idle=0, damping=1e-2, objective=np.inf)
            now = self._run(f"{name} {turn}", fit, fresh, steps)
        return Outcome(design, fit, now, self.start, self.losses, self.tried)

    def _encoder(self, fit: Fit, state: State) -> np.ndarray:
        """What each file's JPEG encoder adds to the noise statistics, in tolerances."""
        before, after = np.zeros_like(fit.wanted), np.zeros_like(fit.wanted)
        for pair, chunk, part in fit.trials(state):
            own = np.asarray(part.sums, np.float64)
            chain, tables = model.with_jpeg(Chain((), "encoder"), self.shots[pair].jpeg)
            before += own
            if tables:
                tiles = np.round(np.clip(part.render, 0, 1) * 255) / 255
                after += np.asarray(sums_of(run_batch(chain, tables, tiles.astype(np.float32)), chunk))
            else:
                after += noise.rounded(own)
        return noise.misfit(after, fit.wanted) - noise.misfit(noise.rounded(before), fit.wanted)

    def _demosaickers(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.demosaic == "auto":
            for name in model.DEMOSAICKERS:
                if name != design.demosaic:
                    yield dataclasses.replace(design, demosaic=name)

    def _passes(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.demosaic == "auto":
            yield dataclasses.replace(design, passes=1)

    def _medians(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.median == "auto":
            for size in model.MEDIANS[1:]:
                yield dataclasses.replace(design, median=size)

    def _try(self, group: str, design: model.Design, state: State) -> State:
        fresh = dataclasses.replace(state, done=0, idle=0, damping=1e-2, objective=np.inf)
        fit = self._fit(design, now=self.origin)
        after = self._run(f"{group.strip('_')}: {design.text}", fit, fresh, min(TRIAL, self.options.steps))
        self.tried.append((design.text, after.objective))
        return after

    def _fit(self, design: model.Design, whole: bool = False, **options: Any) -> Fit:
        """The problem on all tiles, or, until the last phase, on every second group of them."""
        views = self.views(design)
        if not whole:
            views = tuple(View(view.chunks[::2], view.geometry) for view in views)
        return Fit(self.problem, self.start, views, self.origin, median=design.median, **options)

    def _run(self, name: str, fit: Fit, state: State, steps: int) -> State:
        saved, finished = self.journal.get(name)
        if saved is not None and finished:
            return saved

        def after(now: State) -> None:
            self.losses.append(now.objective)
            self._done += 1
            self.journal.put(name, now, finished=False)
            self.tick(min(self._done, self._total - 1), self._total, f"{name} {now.objective:.4f}")

        state = fit.run(saved or state, steps, after)
        self.journal.put(name, state, finished=True)
        return state

    def _origin(self) -> State:
        layout, pairs = self.problem.layout, len(self.shots)
        images = tuple(layout.vector(self.start, IMAGE) for _ in range(pairs))
        places = tuple(np.zeros(len(GEOMETRY)) for _ in range(pairs))
        return State(layout.vector(self.start, CAMERA), images, places)

    def _planned(self) -> int:
        steps = self.options.steps
        return (
            min(steps, FIRST_STEPS)
            + min(steps, LAST_STEPS)
            + min(TRIAL, steps) * (self.options.trials + 3)
            + 1
        )


def _geometry(shot: Shot) -> np.ndarray:
    a = shot.alignment
    return np.asarray([a.dy, a.dx, a.scale_y, a.scale_x], np.float32)
