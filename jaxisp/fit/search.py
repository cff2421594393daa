"""The discrete choices, one after another, with one compiled program; and the phases of a fit."""

import copy
import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from jax.sharding import Mesh

from jaxisp.encoder import encoder_of
from jaxisp.fit import model, noise
from jaxisp.fit.begin import begin
from jaxisp.fit.journal import Journal
from jaxisp.fit.lens import SMALLEST, Lens
from jaxisp.fit.problem import GEOMETRY, Problem
from jaxisp.fit.program import COLOURS, colour_cells
from jaxisp.fit.sharing import CAMERA, FIXED, IMAGE, Layout, sharing
from jaxisp.fit.solve import SMALLEST_LOSS, Fit
from jaxisp.fit.state import Equations, Place, Slopes, State, View
from jaxisp.fit.tiles import Shot, with_source
from jaxisp.io import Jpeg
from jaxisp.params import map_specs
from jaxisp.pipeline import Params
from jaxisp.recipe import Recipe

STATISTICS = 0.004  # weight of each noise statistic in the last phase, against the loss of the one before
FAR, STRESSED = (
    2.0,
    4,
)  # tolerances that all intensities together may be off, and by what else they weigh more
MOST_TRIALS = 5  # of one kind of choice that get steps
GAIN = 0.998  # of the objective, that a more elaborate choice must reach
MIXED = 0.97  # of the objective, that a mix of two demosaickers must reach
PARTNERS, SHARES = 3, (0.2, 0.35, 0.5)  # demosaickers that the best is mixed with, and what they get
FIRST_STEPS, LAST_STEPS, LENS_STEPS = 10, 10, 2
START_STEPS = 4  # that each of several starts gets before one is chosen
SHOWS = 0.99  # of the objective, that the lens must reach
COARSE = 4  # groups of tiles that the phases before the last one take, where there are so many

Tick = Callable[[int, int, str], Any]
Near = Callable[[], Equations]


@dataclasses.dataclass(frozen=True)
class Options:
    """What the caller may settle: "auto" is searched for.

    Args:
        steps: most Gauss-Newton steps of each of the two main phases.
        demosaic: a stage, or "auto".
        median: a footprint, "none", or "auto".
        place: where denoising is; see `model.Design`.
        per_image: parameters that each image has of its own; see `sharing`.
        fixed: parameters that are not fitted, beside `FIXED_NAMES`.
        free: those of `FIXED_NAMES` that are.
        starts: how many of `model.starts` are tried.
        inserted: stages of the user's own.
        camera: the TOML of a camera to start from; "" for none.
    """

    steps: int
    demosaic: str
    median: str
    place: str
    per_image: tuple[str, ...]
    fixed: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    starts: int = 1
    inserted: tuple[model.Inserted, ...] = ()
    camera: str = ""

    @property
    def first(self) -> model.Design:
        demosaic = model.DEMOSAICKERS[0] if self.demosaic == "auto" else self.demosaic
        choices, _ = self.given
        own = {
            "demosaic": choices.get("demosaic") if self.demosaic == "auto" else None,
            "mixed": choices.get("mixed") if self.demosaic == "auto" else None,
            "passes": choices.get("passes") if self.demosaic == "auto" else None,
            "median": choices.get("median") if self.median == "auto" else None,
        }
        plain = model.Design(demosaic, median=self._median, place=self.place, inserted=self.inserted)
        return dataclasses.replace(plain, **{name: v for name, v in own.items() if v is not None})

    @functools.cached_property
    def given(self) -> tuple[dict[str, Any], Params]:
        """The choices and the parameters of the camera to start from; none without one."""
        if not self.camera:
            return {}, {}
        return model.of_camera(Recipe.from_toml(self.camera, "start"), self.inserted)

    @property
    def _median(self) -> str | None:
        return None if self.median in ("auto", "none") else self.median

    def problem(self, jpeg: Jpeg | None) -> Problem:
        """What is compiled, for files that state their chroma sampling, or for none."""
        start = model.start(self.inserted)
        flags = sharing(start, self.per_image, self.fixed, self.free)
        if jpeg:  # states it
            flags[model.SAMPLING] = map_specs(lambda spec, _: FIXED, flags[model.SAMPLING])
        own = encoder_of(jpeg)
        return Problem(self.place, Layout.of(start, flags), own[0] if own else None, self.inserted)

    @property
    def others(self) -> list[model.Design]:
        """Those that demosaick otherwise than the first and will be tried."""
        if self.demosaic != "auto":
            return []
        plain = [dataclasses.replace(self.first, demosaic=name, mixed=None) for name in model.DEMOSAICKERS]
        more = dataclasses.replace(self.first, passes=self.first.passes + 1)
        return [design for design in (*plain, more) if design != self.first]

    @property
    def trials(self) -> int:
        """How many discrete choices are tried at most."""
        demosaickers = 1 + MOST_TRIALS + 1 + len(SHARES) if self.demosaic == "auto" else 0
        return demosaickers + (len(model.MEDIANS) - 1 if self.median == "auto" else 0)


@dataclasses.dataclass
class Outcome:
    """Where a search ended: the design, its parameters and what was tried."""

    design: model.Design
    fit: Fit
    state: State
    start: Params
    losses: list[tuple[str, float]]
    tried: list[tuple[str, float]]


class Search:
    """Fits the shots: first everything with plain choices, then each choice a little, then the best.

    Args:
        shots: the pairs.
        options: what is settled.
        journal: where the states go.
        tick: progress.
        mesh: devices that the chunks are spread over.
    """

    def __init__(
        self,
        shots: Sequence[Shot],
        options: Options,
        journal: Journal,
        tick: Tick,
        mesh: Mesh | None = None,
    ):
        self.shots, self.options, self.journal, self.tick = tuple(shots), options, journal, tick
        self.mesh = mesh
        self.stated = all(shot.jpeg is not None for shot in self.shots)
        self.problem = options.problem(self.shots[0].jpeg if self.stated else None)
        self._total = self._planned()
        self._begin()

    def _begin(self) -> None:
        """Where these shots start from."""
        self.losses: list[tuple[str, float]] = []
        self.tried: list[tuple[str, float]] = []
        self._sources: dict[tuple[Any, ...], tuple[View, ...]] = {}
        self._ranked: list[str] = []  # demosaickers that got steps, the nearest first
        self._tallied = [_tallied(shot) for shot in self.shots]
        self._done = 0
        self._scale: float | None = None
        begun = begin(self.views(self.options.first), self._stated_lens())
        self.start = model.start(self.options.inserted) | begun | self.options.given[1]
        if self.stated:
            self.start |= model.sampled(self.shots[0].jpeg)
        self.origin = self._origin(self.start)

    def of(self, shots: Sequence[Shot]) -> "Search":
        """The same problem, compiled as it is, on other shots."""
        other = copy.copy(self)
        other.shots = tuple(shots)
        other._begin()
        return other

    def settled(self, design: model.Design, name: str) -> Outcome:
        """The main phases with choices that are made, from a start of its own."""
        fit = self._fit(design)
        state = self._run(f"{name} first", fit, self.origin, min(self.options.steps, FIRST_STEPS))
        return self.finish(design, state, name)

    def views(self, design: model.Design, whole: bool = True) -> tuple[View, ...]:
        """The tiles with the design's demosaicking, or some groups of them; those of the last few are kept.

        Some groups are for trials: a program for them, other than the first design's, need not be quick.
        """
        first = self.options.first
        key = design.demosaic, design.mixed, design.passes, whole
        once = not whole and key[:3] != (first.demosaic, first.mixed, first.passes)
        if key not in self._sources:
            while len(self._sources) > 1:
                self._sources.pop(next(iter(self._sources)))
            counts = [len(shot.chunks) for shot in self.shots] if whole else self._coarse()
            self._sources[key] = tuple(
                View(
                    tuple(with_source(c, shot.cfa, design, once=once) for c in shot.chunks[:count]),
                    shot.geometry,
                    sums[:count].sum(axis=0),
                    pixels[:count].sum(axis=0),
                    self._encoder(shot.jpeg),
                )
                for shot, count, (sums, pixels) in zip(self.shots, counts, self._tallied)
            )
        return self._sources[key]

    def _encoder(self, jpeg: Jpeg | None) -> Params | None:
        """The parameters of a file's own, where the encoder that is compiled is its."""
        own = encoder_of(jpeg)
        return own[1] if own and own[0] == self.problem.encoder else None

    def run(self) -> Outcome:
        """All phases."""
        return self.finish(*self._chosen())

    def _chosen(self) -> tuple[model.Design, State]:
        """The discrete choices, and where their trials ended.

        A trial takes a few steps that only render, with the equations of the first choice: what is fitted
        moves the picture almost alike after any demosaicker. A median has its own: its strength moves, too.
        """
        best, state = self._first()
        shared, own, again = self._near(best, state), best.median, True
        for group in (self._demosaickers, self._passes, self._more_passes, self._medians):
            others = list(group(best))
            if not others:
                continue
            first = self._try(group.__name__, best, state, shared) if again else self._same(best, state)
            trials = {best: first}
            for design, place in self._nearest(others, state, shared):
                near = shared if design.median == own else self._near(design, state)
                trials[design] = self._try(group.__name__, design, state, near, place)
            ranked = sorted(trials, key=lambda d: trials[d].objective)
            if group == self._demosaickers:
                self._ranked = [d.demosaic for d in ranked]
            if trials[ranked[0]].objective < GAIN * trials[best].objective:
                best = ranked[0]
            state = trials[best]
            again = not state.idle
        return self._mixed(best, state, shared if best.median == own else self._near(best, state))

    def _same(self, design: model.Design, state: State) -> State:
        """A trial that would end where it begins."""
        self.tried.append((design.text, state.objective))
        return state

    def _mixed(self, best: model.Design, state: State, near: Near) -> tuple[model.Design, State]:
        """The best choices, with another demosaicker mixed in where that is much nearer.

        A mix stands for a demosaicker that is not among those that are tried, so this comes last. A fit that
        takes none is the one without these trials, to the bit.
        """
        partners = [n for n in self._ranked if n in model.DEMOSAICKERS and n != best.demosaic][:PARTNERS]
        if best.mixed or best.demosaic not in model.DEMOSAICKERS or not partners:
            return best, state
        designs = {name: dataclasses.replace(best, mixed=(name, SHARES[1])) for name in partners}
        objectives = {name: self._fit(design).objective(state) for name, design in designs.items()}
        nearest = min(partners, key=objectives.__getitem__)
        if objectives[nearest] > state.objective:
            return best, state
        mixes = [dataclasses.replace(best, mixed=(nearest, share)) for share in SHARES]
        trials = {design: self._try("mixes", design, state, near) for design in (best, *mixes)}
        chosen = min(mixes, key=lambda d: trials[d].objective)
        if trials[chosen].objective < MIXED * trials[best].objective:
            return chosen, trials[chosen]
        return best, state

    def _nearest(
        self, designs: Sequence[model.Design], state: State, near: Near
    ) -> list[tuple[model.Design, Place | None]]:
        """Of many choices those nearest to the pictures before any step, and what was found there."""
        if len(designs) <= MOST_TRIALS:
            return [(design, None) for design in designs]
        places = {design: self._fit(design).place(state, near()) for design in designs}
        nearest = sorted(designs, key=lambda design: places[design].objective)
        return [(design, places[design]) for design in nearest[:MOST_TRIALS]]

    def _near(self, design: model.Design, state: State) -> Near:
        """The equations that trials go by, where one is not in the journal."""
        return functools.cache(lambda: self._fit(design).equations(state))

    def _first(self) -> tuple[model.Design, State]:
        """Everything with plain choices; the lens only where the alignment found one, or where it shows."""
        steps = min(self.options.steps, FIRST_STEPS)
        design = dataclasses.replace(self.options.first, sampling=not self.stated)
        bent = dataclasses.replace(design, lens=True)
        if float(self._stated_lens().k1):
            fit = self._fit(bent)
            return bent, self._run("first", fit, self._begun(fit), steps)
        fit = self._fit(design)
        state = self._run("first", fit, self._begun(fit), steps)
        tried = self._run("lens", self._fit(bent), _again(state), min(steps, LENS_STEPS))
        shows = tried.objective < SHOWS * state.objective and self._bends(tried)
        return (bent, tried) if shows else (design, state)

    def _begun(self, fit: Fit) -> State:
        """Where the first phase begins: of several starts the one that a few steps take furthest."""
        if self.options.starts == 1:
            return self.origin
        steps, ends = min(self.options.steps, START_STEPS), []
        for i, own in enumerate(model.starts()[: self.options.starts]):
            ends.append(self._run(f"start {i + 1}", fit, self._origin(self.start | own), steps))
            self.tried.append((f"start {i + 1}", ends[-1].objective))
        return _again(min(ends, key=lambda end: end.objective))

    def _stated_lens(self) -> Lens:
        return Lens(float(np.median([s.lens.k1 for s in self.shots])))

    def _bends(self, state: State) -> bool:
        """Whether distortion or lateral colour moves the corner by so much that it counts."""
        params = self.problem.layout.bounded(self.start, state.camera, state.images[0])
        corner = float(np.mean([s.chunks[0].corner for s in self.shots]))
        return max(abs(v) for v in Lens.of(params).in_the_corner(corner).values()) > SMALLEST

    def finish(self, design: model.Design, state: State, name: str = "last") -> Outcome:
        """The last phase, in two rounds: on from `state` with the noise statistics in the objective.

        Where a first round leaves them far off on the fitted tiles, they weigh more in the second.
        """
        steps, now, weight = -(-min(self.options.steps, LAST_STEPS) // 2), state, STATISTICS
        fit = self._fit(design, whole=True, scale=1.0)
        known: Slopes | None = (found := fit.slopes(state))
        scale: float | None = max(fit.mean_loss(found), SMALLEST_LOSS)
        patches = fit.patches_at(state, found)
        for turn in (1, 2):
            if design.lens and not self._bends(now):
                design = dataclasses.replace(design, lens=False)  # it stood in for what was chosen since
                known = scale = None
            fit = self._fit(design, whole=True, now=state, scale=scale, statistics=weight, patches=patches)
            scale = fit.scale
            now = self._run(f"{name} {turn}", fit, _again(now), steps, known)
            known = None
            if turn == 1 and np.abs(fit.misfit(now)[noise.TOGETHER]).max() > FAR:
                weight = STRESSED * STATISTICS
        return Outcome(design, fit, now, self.start, self.losses, self.tried)

    def _demosaickers(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.demosaic == "auto":
            for name in model.DEMOSAICKERS:
                if design.mixed or name != design.demosaic:
                    yield dataclasses.replace(design, demosaic=name, mixed=None)

    def _passes(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.demosaic == "auto":
            yield dataclasses.replace(design, passes=design.passes + 1)

    def _more_passes(self, design: model.Design) -> Iterator[model.Design]:
        if design.passes:
            yield from self._passes(design)

    def _medians(self, design: model.Design) -> Iterator[model.Design]:
        if self.options.median == "auto":
            for size in model.MEDIANS[1:]:
                yield dataclasses.replace(design, median=size)

    def _try(
        self, group: str, design: model.Design, state: State, near: Near, place: Place | None = None
    ) -> State:
        name = f"{group.strip('_')}: {design.text}"
        after, _ = self.journal.get(name)
        if after is None:
            after = self._fit(design).beginning(_again(state), near(), place)
            self.journal.put(name, after, finished=True)
            self._note(name, after)
        self.tried.append((design.text, after.objective))
        return after

    def _fit(self, design: model.Design, whole: bool = False, **options: Any) -> Fit:
        """The problem on all tiles, or, until the last phase, on some groups of them."""
        views = self.views(design, whole)
        if not whole:
            options["scale"] = self._scale
        given = {"now": self.origin, "mesh": self.mesh, **options}
        fit = Fit(self.problem, self.start, views, self.origin, design, **given)
        if not whole:
            self._scale = fit.scale
        return fit

    def _coarse(self) -> list[int]:
        """How many groups of tiles of each pair the phases before the last take: half, or COARSE in all."""
        counts = [len(shot.chunks) for shot in self.shots]
        own = self.problem.layout.size(IMAGE) > 0
        kept = [int(own)] * len(counts)
        wanted = max(sum(counts) // 2, min(COARSE, sum(counts)))
        while sum(kept) < wanted:  # evenly
            shares = [k / n if k < n else np.inf for k, n in zip(kept, counts)]
            kept[int(np.argmin(shares))] += 1
        return kept

    def _run(self, name: str, fit: Fit, state: State, steps: int, known: Slopes | None = None) -> State:
        """A phase; `known`: the slopes at `state`."""
        saved, finished = self.journal.get(name)
        if saved is not None and finished:
            return saved

        def after(now: State) -> None:
            self.journal.put(name, now, finished=False)
            self._note(name, now)

        state = fit.run(saved or state, steps, after, known=None if saved else known)
        self.journal.put(name, state, finished=True)
        return state

    def _note(self, name: str, now: State) -> None:
        self.losses.append((name, now.objective))
        self._done += 1
        self.tick(min(self._done, self._total - 1), self._total, f"{name} {now.objective:.4f}")

    def _origin(self, start: Params) -> State:
        layout, pairs = self.problem.layout, len(self.shots)
        images = tuple(layout.vector(start, IMAGE) for _ in range(pairs))
        places = tuple(np.zeros(len(GEOMETRY)) for _ in range(pairs))
        return State(layout.vector(start, CAMERA), images, places)

    def _planned(self) -> int:
        steps = self.options.steps
        return (
            min(steps, FIRST_STEPS)
            + min(steps, LAST_STEPS)
            + min(LENS_STEPS, steps)
            + (self.options.starts > 1) * self.options.starts * min(START_STEPS, steps)
            + self.options.trials
            + 6
        )


def _tallied(shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """(chunks, m) and (chunks, cells): `View.sums` and `View.pixels` of each."""
    sums, pixels = [], []
    for c in shot.chunks:
        sums.append(np.sum([noise.moments(*t) for t in zip(c.target, c.flat, c.edges)], axis=0, dtype=float))
        pixels.append(np.bincount(colour_cells(np, c.target).ravel(), np.ravel(c.mask), COLOURS**3))
    return np.stack(sums), np.stack(pixels)


def _again(state: State) -> State:
    """The state at the start of another phase."""
    return dataclasses.replace(state, done=0, idle=0, damping=1e-2, objective=np.inf)
