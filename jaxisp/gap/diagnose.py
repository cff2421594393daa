"""Where the gap lies, which effect causes it, and how far it shrinks: the whole diagnosis of a data set."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.encoder import no_encoder
from jaxisp.errors import InputError
from jaxisp.gap.axes.null_bank import CLEAR, held_against_nulls
from jaxisp.gap.base import raw_jpeg
from jaxisp.gap.case import NULL_DROP, NULL_EXCESS, Case, Downstream, Gap, Rows, Split
from jaxisp.gap.downstream.ceiling import reducible
from jaxisp.gap.features.spectra import held_out_spreads
from jaxisp.gap.objective.pixels import Problem, floor_difference, floor_errors, to_steps
from jaxisp.gap.pairs.align_clean import on_each_other
from jaxisp.gap.pairs.align_raw import Laid, in_one_frame
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import of_one_sampling
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.report import advice
from jaxisp.gap.report.record import (
    NO_COLOURS,
    NO_HEADER,
    STATED,
    TAKEN_UP,
    base_row,
    cause_row,
    ranking_rows,
)
from jaxisp.gap.search.refit import interval
from jaxisp.gap.search.stepwise import Tick
from jaxisp.gap.search.verdict import MOST_CAUSES, Found, gap_at, searched
from jaxisp.gap.simulator.effects import RAW_JPEG
from jaxisp.gap.simulator.model import Model
from jaxisp.io.datasets import Loaded, open_dataset
from jaxisp.recipe import Recipe

METRIC = {
    RAW_JPEG: "mean square difference of camera's and simulator's picture in Y'CbCr, squared 8-bit steps, "
    "summed over the three channels, large errors of single edges weighed down",
    "clean+noisy": "mean square difference of the statistics of the residual, mean error included, in "
    "units of what is harmless or chance (squared), those weighed up that differ on the fitted pairs",
}


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What was found. `report` is report.json; `pictures` shows one held-out pair, and how what is left in
    all of them is spread over frequencies and neighbours."""

    report: dict[str, Any]
    pictures: dict[str, Any] = dataclasses.field(repr=False)

    @property
    def verdict(self) -> str:
        """ "effect", "none" or "unknown"."""
        return str(self.report["verdict"])

    @property
    def causes(self) -> list[str]:
        """The accepted effects, the largest first."""
        return [cause["effect"] for cause in self.report["causes"]]

    def save(self, folder: str | Path) -> Path:
        """Write report.json and report.html into a folder; returns the page."""
        from jaxisp.gap.report.page import write_report

        return write_report(self.report, self.pictures, folder)


def diagnose(
    dataset: str | Path,
    camera: Recipe | None = None,
    *,
    recipe: Recipe | None = None,
    exclude: Sequence[str] = (),
    downstream: Downstream | None = None,
    seed: int = 0,
    tick: Tick = lambda done, total, text: None,
) -> Diagnosis:
    """Diagnose the gap between a simulated camera and a real one's pictures.

    Args:
        dataset: a folder of RAW+JPEG or clean+noisy pairs.
        camera: the simulator, mosaic to encoded sRGB, as `jaxisp.fit` makes it; its parameters are
            believed. A plain camera is fitted to the pairs where none is given. For clean+noisy pairs the
            curve and matrix that take the clean picture to its sensor are fitted, and the sensor's noise,
            unless the camera has noise of its own.
        recipe: the simulator of clean+noisy pairs, encoded sRGB to encoded sRGB with a mosaic and its
            demosaicking. Its stages, their order and its constants are believed, tone and colour
            included. What it draws for each image it leaves open: that starts at its median and is fitted
            within the range of its prior, one value for all pairs.
        exclude: names of effects that are not tried.
        downstream: how to train small denoisers without and with the accepted effects, or with what comes
            nearest, measured on the held-out pairs; needs clean+noisy pairs, two scenes or more. None: that
            is left out.
        seed: of the simulated noise.
        tick: called with (done, total, text).

    Raises:
        InputError: no such folder, no usable pair, an unknown effect, a simulator that cannot be a base
            (no mosaic or demosaicking, stages drawn at random, another domain), a camera and a recipe at
            once, a recipe for RAW+JPEG pairs, or `downstream`.
    """
    clock = time.perf_counter()
    if camera is not None and recipe is not None:
        raise InputError("give a camera or a recipe, not both: each is a whole simulator")
    case, laid = _case(dataset, camera, recipe, downstream, exclude, seed, tick)
    problem = case.problem
    gap = gap_at(case)
    pictures = _pictures(case, "before")
    base = problem.model, problem.z.copy()
    found = searched(case, gap, tick)
    report = _report(case, gap, found, base, tick)
    report["pairs"] |= _laid(laid, case.strays)
    if downstream is not None:
        report["downstream"] = _trained(case, base, found, downstream, tick)
    if found.causes:
        pictures |= _pictures(case, "after")
    report["seconds"] = round(time.perf_counter() - clock, 2)
    return Diagnosis(report, pictures)


def _laid(laid: Laid, strays: Sequence[str]) -> dict[str, Any]:
    """What was done to the pairs, and which are not among those that were fitted or held out."""
    rows = {row["name"]: row for row in laid.rows}
    return {
        "aligned": [row for name, row in rows.items() if name not in strays],
        "left_out": [
            {"name": name, "reason": _STRAY if rows[name]["certain"] else _TWO_SCENES} for name in strays
        ],
        "failed": [{"file": name, "reason": reason} for name, reason in laid.failed],
        "encoder_not_modelled": [
            {"name": pair.name, "reason": why}
            for pair in laid.kept
            if pair.jpeg and (why := no_encoder(pair.jpeg))
        ],
    }


def _report(case: Case, gap: Gap, found: Found, base: tuple[Model, np.ndarray], tick: Tick) -> dict[str, Any]:
    """report.json, but for the seconds and what could not be used."""
    problem, names, held = case.problem, case.problem.pairs.names, case.split.held_out
    there = bool(found.causes) or gap.exceeds(NULL_EXCESS[case.kind])
    after = found.causes[-1][0].after if found.causes else gap.before
    apart = dict.fromkeys(problem.model.effects, STATED) | {"double_compression": NO_HEADER}
    apart |= dict.fromkeys(case.absorbed, TAKEN_UP) | dict.fromkeys(case.unsaid, NO_COLOURS)
    tried = len(case.offered) + (case.stored is not None)  # and film grain
    causes = [cause_row(t, alike, tried, problem.model) for t, alike in found.causes]
    ended = problem.model.params(problem.z) if causes else None
    reached, where = {}, held_against_nulls(found.before.where, case.kind, gap.before, gap)
    if there:
        tick(MOST_CAUSES - 1, MOST_CAUSES, "what flexible models reach")
        refits = [t.after for t in (*found.trials.values(), *found.nearest)]
        reached = {"reducible": reducible(case, gap, after, refits, NULL_DROP[case.kind])}
    return {
        "schema": 1,
        "kind": case.kind,
        "base": base_row(*base, case.absorbed, case.given, (*case.open_nodes, *case.unsaid), ended),
        "pairs": {
            "fit": [names[i] for i in case.split.fit],
            "held_out": [names[i] for i in held],
            "pixels": int(problem.pairs.mask[problem.inner].sum()),
        },
        "gap": {
            "metric": METRIC[case.kind], "before": gap.before, "after": after, "floor": gap.floor,
            "ci": _interval(problem, held, after), "axes": {row["axis"]: row["size"] for row in where},
        } | reached | _statistics(found.before.rows),
        "verdict": "effect" if causes else "unknown" if there else "none",
        "causes": causes,
        "ranking": ranking_rows(found, apart, gap.scale),
        "where": where if there else [],
        "unexplained": _unexplained(found, after, case.kind, gap, there),
        "seconds": 0.0,
    }  # fmt: skip


def _case(
    dataset: str | Path,
    camera: Recipe | None,
    recipe: Recipe | None,
    downstream: Downstream | None,
    exclude: Sequence[str],
    seed: int,
    tick: Tick,
) -> tuple[Case, Laid]:
    """The pairs read, laid on each other and the base put before them; with all that could not be used."""
    found = open_dataset(dataset)
    if found.kind == RAW_JPEG and recipe is not None:
        raise InputError(
            f"{dataset}: a recipe simulates clean+noisy pairs, these are RAW+JPEG; give a camera (--camera)"
        )
    if found.kind == RAW_JPEG and downstream is not None:
        raise InputError(
            f"{dataset}: denoisers (--downstream) are measured against clean pictures, which RAW+JPEG pairs "
            "do not have; give clean+noisy pairs"
        )
    read, failed = _load(found.pairs)
    read, odd = of_one_sampling(read)
    failed = [(path.name, f"{path}: {reason}") for path, reason in found.problems] + failed + odd
    laid = in_one_frame(read) if found.kind == RAW_JPEG else on_each_other(read)
    laid = laid._replace(failed=failed + laid.failed)
    loaded = 2 * laid.kept if len(laid.kept) == 1 else laid.kept  # one's tiles are told apart by masks
    if found.kind == RAW_JPEG:
        return raw_case(loaded, camera, exclude, tick), laid
    from jaxisp.gap.base.clean_noisy import clean_case

    is_camera = camera is not None
    doubted = [row["name"] for row in laid.rows if not row["certain"]]
    case = clean_case(loaded, camera or recipe, exclude, seed, tick, is_camera=is_camera, doubted=doubted)
    return case, laid


_TWO_SCENES = "its two pictures are hardly alike, and far from what fits the others: they show two scenes"
_STRAY = "colours and tones of the fitted pairs do not carry over to it: more pairs, of scenes that differ"


def _trained(
    case: Case, base: tuple[Model, np.ndarray], found: Found, how: Downstream, tick: Tick
) -> dict[str, Any]:
    """Denoisers without and with the causes, or with what comes nearest where there is none."""
    from jaxisp.gap.downstream.denoisers import measure_downstream

    near, problem = found.refused, case.problem
    if not found.causes and near is None:
        return {"skipped": "no effect comes near: there is nothing to train with and without"}
    place = (problem.model, problem.z) if near is None else (near.model, near.z)
    named = found.causes if near is None else near.causes
    measured = measure_downstream(case, {"without": base, "with": place}, how, tick)
    return measured | {"effects": [trial.effect for trial, _ in named]}


def diagnose_folder(folder: str | Path, **options: Any) -> dict[str, Any]:
    """`diagnose`, as the dictionary that report.json holds."""
    return diagnose(folder, **options).report


def _load(pairs: Sequence[Any]) -> tuple[list[Loaded], list[tuple[str, str]]]:
    loaded, failed = [], []
    for pair in pairs:
        try:
            loaded.append(_large_enough(pair.load()))
        except InputError as error:
            failed.append((pair.name, str(error)))
    if not loaded:
        raise InputError("; ".join(reason for _, reason in failed))
    return loaded, failed


def _large_enough(pair: Loaded) -> Loaded:
    first = pair.clean if pair.raw is None else pair.raw.mosaic
    sizes = [a.shape[:2] for a in (first, pair.picture) if a is not None]
    for height, width in sizes:
        if min(height, width) < raw_jpeg.SMALLEST:
            wanted = f"{raw_jpeg.SMALLEST} or more a side"
            raise InputError(
                f"{pair.name}: {width}x{height} px are too few to be diagnosed, expected {wanted}"
            )
    return pair


def raw_case(
    loaded: Sequence[Loaded],
    camera: Recipe | None,
    exclude: Sequence[str],
    tick: Tick,
    split: Split | None = None,
) -> Case:
    """RAW+JPEG pairs with the base before them: a camera, or a plain one that is fitted. Every other scene
    is fitted, unless a split says otherwise."""
    pairs = raw_jpeg.raw_pairs(loaded)
    split = split_of(pairs.names) if split is None else split
    effects = raw_jpeg.candidates(RAW_JPEG, exclude)
    tick(0, MOST_CAUSES, "fitting the base")
    if camera is None:
        base = raw_jpeg.raw_model(loaded, pairs, effects, split.fit)
    else:
        base = raw_jpeg.Base(raw_jpeg.camera_model(camera, loaded, effects))
    model, absorbed = base.model, base.absorbed
    references: dict[int, float] = {}
    seen: tuple[str, ...] = ()
    place = (0, 0)
    if loaded[0].jpeg is not None:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])  # where the gap lies, tried or not
        if "double_compression" in model.effects:
            model = raw_jpeg.with_earlier_grid(model, place)
            if place == (0, 0):  # the file's own grid
                indices = model.indices(["double_compression"])
                references = dict.fromkeys(indices, float(loaded[0].jpeg.quality))
            else:
                seen = ("double_compression",)
    problem = Problem(model, pairs, base.choices, base.rival)
    problem.weigh(problem.robust_weights())
    problem.references, problem.earlier = references, place
    stated = raw_jpeg.stated_by(loaded[0].jpeg)
    if loaded[0].jpeg is None:  # was compressed once, if at all
        stated.add("double_compression")
    apart = stated | {*absorbed, *base.unsaid}
    offered = [name for name in model.effects if name not in apart]
    stored = floor_difference(problem, [p.jpeg for p in loaded])
    floors, given = floor_errors(problem, stored), f"camera {camera.name}" if camera else None
    grain = None if "film_grain" in exclude else stored
    return Case(
        RAW_JPEG, problem, split, floors, absorbed, offered, grain, given, seen=seen, unsaid=base.unsaid
    )


def _statistics(rows: Rows) -> dict[str, Any]:
    """Of clean+noisy pairs each statistic's difference before any cause, in units of what is harmless or
    chance, and how much it counts: the gap is the mean of their squares, so weighed."""
    found = {
        f"{row['axis']} {name}": [value, weight]
        for row in rows
        for name, value, weight in zip(row["bins"], row["profile"], row.get("weights", ()))
    }
    return {"statistics": found} if found else {}


def _interval(problem: Any, held: Sequence[int], after: float) -> list[float]:
    """Of what is left; film grain moves no parameter, so its part is taken off every picture alike."""
    left = problem.units(problem.z)[list(held)]
    share = after / max(float(np.nanmean(left)), 1e-12)
    return list(interval(problem.clustered(share * left, held), 1.0))


def _unexplained(found: Found, after: float, kind: str, gap: Gap, there: bool) -> dict[str, Any]:
    def axes(rows: Rows, at: float) -> list[str]:
        sure = [row for row in rows if row["p_value"] < _BY_CHANCE]
        return _clear(held_against_nulls(sure, kind, at, gap))

    share, left = float(np.clip((after - gap.floor) / gap.scale, 0, 1)), axes(found.after.where, after)
    text = f"{100 * share:.0f} % of the gap is left" + (f", on {', '.join(left)}" if left else "")
    text += "" if there else ", no more than cameras that lack nothing have"
    wanted = left if found.causes else axes(found.before.where, gap.before)
    next_one = advice.about(wanted) if there and share >= advice.CONSIDERABLE else None
    row = {"share": share, "axes": left, "description": text, "next_measurement": next_one}
    if found.refused is None:
        return row
    causes = found.refused.causes
    reached = causes[-1][0].after
    nearest = {
        "effects": [t.effect for t, _ in causes],
        "closed": float((gap.before - reached) / gap.scale),
        "axes": axes(found.refused.after.where, reached),
    }
    return row | {"nearest": nearest}


_BY_CHANCE = 0.01
"""Axes of what is left must be less likely by chance alone; p-values of the bank are not as fine."""


def _clear(rows: Rows) -> list[str]:
    """The axes that clearly have some of a gap, three at most."""
    return [str(row["axis"]) for row in rows if row["p_value"] <= CLEAR and row["share"] > 0.02][:3]


def _pictures(case: Case, when: str) -> dict[str, Any]:
    """One held-out pair as the simulator makes it where the problem stands, what it lacks, and how that is
    spread in all of them."""
    problem, i = case.problem, case.split.held_out[0]
    whole = problem.rendered(problem.z)
    picture = to_steps(whole[problem.inner])
    spreads = held_out_spreads(case, picture)
    return {
        "name": problem.pairs.names[i],
        "target": problem.pairs.pictures[i],
        when: whole[i],
        f"residual_{when}": problem.target[i] - picture[i],
        f"spread_{when}": spreads.pop("simulator"),
        **{f"spread_{whose}": own for whose, own in spreads.items()},
    }
