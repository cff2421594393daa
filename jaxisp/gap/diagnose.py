"""Where the gap lies, which effect causes it, and how far it shrinks: the whole diagnosis of a data set."""

import dataclasses
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.gap import prepare
from jaxisp.gap.effects import EFFECTS, RAW_JPEG
from jaxisp.gap.model import Model
from jaxisp.gap.residual import Problem, floor_errors
from jaxisp.gap.where import where
from jaxisp.gap.which import Split, Tick, Trial, search
from jaxisp.io.datasets import Loaded, open_dataset
from jaxisp.recipe import Recipe

MOST_CAUSES = 3
METRIC = {
    RAW_JPEG: "mean square difference of camera's and simulator's picture in Y'CbCr, squared 8-bit steps, "
    "summed over the three channels, large errors of single edges weighed down",
    "clean+noisy": "mean square difference of the statistics of the residual, mean error included, in "
    "units of what is harmless or chance (squared)",
}


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What was found. `report` is report.json; `pictures` shows one held-out pair."""

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
        from jaxisp.gap.report import write_report

        return write_report(self.report, self.pictures, folder)


def diagnose(
    dataset: str | Path,
    camera: Recipe | None = None,
    *,
    recipe: Recipe | None = None,
    exclude: Sequence[str] = (),
    seed: int = 0,
    tick: Tick = lambda done, total, text: None,
) -> Diagnosis:
    """Diagnose the gap between a simulated camera and a real one's pictures.

    Args:
        dataset: a folder of RAW+JPEG or clean+noisy pairs.
        camera: the simulator, mosaic to encoded sRGB, as `jaxisp.fit` makes it; its parameters are
            believed. A plain camera is fitted to the pairs where none is given.
        recipe: meant as the simulator of clean+noisy pairs; not used yet, which a warning says.
        exclude: names of effects that are not tried.
        seed: of the simulated noise.
        tick: called with (done, total, text).

    Raises:
        InputError: no such folder, no usable pair, an unknown effect.
    """
    clock = time.perf_counter()
    found = open_dataset(dataset)
    if recipe is not None:
        warnings.warn("diagnose: a recipe is not taken as the base yet; a plain one is fitted", stacklevel=2)
    problem: Any
    loaded, failed = _load(found.pairs)
    if len(loaded) == 1:
        loaded = 2 * loaded  # its tiles are told apart by masks
    if found.kind == RAW_JPEG:
        problem, split, absorbed, offered = _raw_problem(loaded, camera, exclude, tick)
        floors = floor_errors(problem, [p.jpeg for p in loaded])
    else:
        from jaxisp.gap.clean_noisy import clean_problem

        problem, split, absorbed, offered, floors = clean_problem(loaded, exclude, seed, tick)
    held = list(split.held_out)
    before = float(np.nanmean(problem.units(problem.z)[held]))
    floor = float(min(floors[held].mean(), before))
    scale = max(before - floor, 0.02 * floor, 1e-6)
    start = problem.z.copy()
    located = _where(problem, held)
    causes, trials, promises = search(
        problem, offered, split, scale, NULL_DROP[found.kind] * floor / scale, MOST_CAUSES, tick
    )
    if before < floor * (1 + NULL_DROP[found.kind]):  # smoothing alone can come nearer than the floor
        causes = []
        problem.move_to(start)
    gap_is_there = bool(causes) or before > floor * (1 + NULL_EXCESS[found.kind])
    end = problem.z
    after = causes[-1][0].after if causes else before
    report = {
        "schema": 1,
        "kind": found.kind,
        "base": _base(problem.model, absorbed),
        "pairs": {
            "fit": [problem.pairs.names[i] for i in split.fit],
            "held_out": [problem.pairs.names[i] for i in split.held_out],
            "failed": [{"file": name, "reason": reason} for name, reason in failed],
        },
        "gap": {
            "metric": METRIC[found.kind], "before": before, "after": after, "floor": floor,
            "ci": _interval(problem, end, held),
        },
        "verdict": "effect" if causes else "unknown" if gap_is_there else "none",
        "causes": [_cause(t, alike, scale, len(offered), problem.model) for t, alike in causes],
        "ranking": _ranking(causes, trials, promises, absorbed, scale),
        "where": located if gap_is_there else [],
        "unexplained": _unexplained(problem, held, after, before, floor, scale),
        "seconds": 0.0,
    }  # fmt: skip
    pictures = _pictures(problem, start, end, held, bool(causes))
    report["seconds"] = round(time.perf_counter() - clock, 2)
    return Diagnosis(report, pictures)


NULL_EXCESS = {RAW_JPEG: 0.35, "clean+noisy": 15.0}
"""How far above the floor, as a share of it, the gap of a camera that lacks nothing may be: its demosaicker
and its order of steps are not quite the base's. Set on a few development cameras, see docs/diagnosis.md."""
NULL_DROP = {RAW_JPEG: 0.03, "clean+noisy": 0.3}
"""By how much, as a share of the floor, an effect may lower that camera's gap all the same."""


def diagnose_folder(folder: str | Path, **options: Any) -> dict[str, Any]:
    """`diagnose`, as the dictionary that report.json holds."""
    return diagnose(folder, **options).report


def _load(pairs: Sequence[Any]) -> tuple[list[Loaded], list[tuple[str, str]]]:
    loaded, failed = [], []
    for pair in pairs:
        try:
            loaded.append(pair.load())
        except InputError as error:
            failed.append((pair.name, str(error)))
    if not loaded:
        raise InputError("; ".join(reason for _, reason in failed))
    return loaded, failed


def halves(count: int) -> Split:
    """Every other pair is fitted."""
    return Split(tuple(range(0, count, 2)), tuple(range(1, count, 2)))


def _raw_problem(
    loaded: Sequence[Loaded], camera: Recipe | None, exclude: Sequence[str], tick: Tick
) -> tuple[Problem, Split, dict[str, float], list[str]]:
    pairs = prepare.raw_pairs(loaded)
    split = halves(len(loaded))
    effects = prepare.candidates(RAW_JPEG, exclude)
    tick(0, MOST_CAUSES, "fitting the base")
    absorbed: dict[str, float]
    if camera is None:
        model, absorbed = prepare.raw_model(loaded, pairs, effects, split.fit)
    else:
        model = prepare.camera_model(camera, loaded, effects)
        absorbed = {}
    problem = Problem(model, pairs)
    problem.weigh(problem.robust_weights())
    stated = set() if loaded[0].jpeg is None else {"jpeg_quantization"}
    if loaded[0].jpeg is not None and loaded[0].jpeg.subsampling != "4:4:4":
        stated.add("chroma_subsampling")
    offered = [e.name for e in effects if e.name not in stated and e.name not in absorbed]
    return problem, split, absorbed, offered


def _where(problem: Any, held: Sequence[int]) -> list[dict[str, Any]]:
    rng = np.random.default_rng(0)
    scale = np.maximum(problem.weight[..., :1], 1e-6)
    residual = problem.residual / scale
    return where(residual[held], problem.current[held], problem.weight[held][..., 0] ** 2, rng=rng)


def _interval(problem: Any, z: np.ndarray, held: Sequence[int]) -> list[float]:
    from jaxisp.gap.which import interval

    return list(interval(problem.units(z)[list(held)], 1.0))


def _base(model: Model, absorbed: dict[str, float]) -> dict[str, Any]:
    names = {c.node for c in model.base} | {"demosaicking"}
    fitted = {
        name: {f.name: np.asarray(getattr(model.shared[name], f.name)).tolist()
               for f in dataclasses.fields(model.shared[name])}
        for name in sorted(names) if name in model.shared
    }  # fmt: skip
    stages = [n.name for n in model.chain.nodes if not n.name.startswith("use_")]
    return {"stages": stages, "fitted": fitted, "absorbed": absorbed}


def _cause(trial: Trial, alike: list[str], scale: float, tried: int, model: Model) -> dict[str, Any]:
    effect = EFFECTS[trial.effect]
    indices = model.indices([trial.effect])
    params: dict[str, Any] = {}
    for i, move in zip(indices, effect.moves):
        key = move.field + "".join(f"[{n}]" for n in move.index)
        params[key] = round(float(move.off + trial.z[i]), 5)
    spread = max((trial.high - trial.low) / 3.29, 1e-6)
    return {
        "effect": trial.effect,
        "site": effect.site,
        "gap_before": trial.before,
        "gap_after": trial.after,
        "closed": trial.closed,
        "ci": [trial.low, trial.high],
        "alternatives": alike,
        "next_measurement": NEXT.get(trial.effect, "more pairs, of scenes that differ") if alike else None,
        "p_value": _p_value(trial.closed / spread, tried),
        "params": params,
    }


NEXT = {
    "vignetting": "a flat field: a white wall, out of focus",
    "color_shading": "a flat field under one light",
    "chroma_denoising": "saturated fine texture, and the file's own sampling factors",
    "luma_denoising": "low-contrast texture (dead leaves) at a low and a high ISO",
    "optical_blur": "a slanted edge, with the noise spectrum of a flat patch beside it",
    "sharpening": "a slanted edge at several contrasts",
    "local_tone_mapping": "a grey patch on a dark and on a bright surround",
    "veiling_glare": "a black patch with and without a lamp at the border of the frame",
    "noise_level": "repeated frames of one still scene",
    "prnu": "repeated frames of a flat field",
    "hot_pixels": "repeated dark frames",
    "heavy_tailed_noise": "repeated dark frames",
}


def _p_value(z: float, tried: int) -> float:
    """One-sided, times the number of effects tried (Bonferroni)."""
    from math import erfc, sqrt

    return float(min(1.0, 0.5 * erfc(z / sqrt(2)) * tried))


def _ranking(
    causes: Sequence[tuple[Trial, list[str]]],
    trials: dict[str, Trial],
    promises: dict[str, float],
    absorbed: dict[str, float],
    scale: float,
) -> list[dict[str, Any]]:
    accepted = {t.effect: t.closed for t, _ in causes}
    alike = {name for _, names in causes for name in names}
    rows = []
    for name, promise in promises.items():
        closed = accepted.get(name, trials[name].closed if name in trials else promise / scale)
        status = "accepted" if name in accepted else "not_identifiable" if name in alike else "rejected"
        rows.append({"effect": name, "closed": float(closed), "status": status})
    rows.sort(key=lambda row: (row["status"] != "accepted", -float(str(row["closed"]))))
    return rows + [{"effect": n, "closed": 0.0, "status": "absorbed"} for n in absorbed if n not in promises]


def _unexplained(
    problem: Any, held: Sequence[int], after: float, before: float, floor: float, scale: float
) -> dict[str, Any]:
    share = float(np.clip((after - floor) / scale, 0, 1))
    left = [w for w in _where(problem, held) if w["p_value"] < 0.01 and w["share"] > 0.02][:3]
    axes = [w["axis"] for w in left]
    text = f"{100 * share:.0f} % of the gap is left"
    return {"share": share, "axes": axes, "description": text + (f", on {', '.join(axes)}" if axes else "")}


def _pictures(
    problem: Any, start: np.ndarray, end: np.ndarray, held: Sequence[int], changed: bool
) -> dict[str, Any]:
    i = held[0]
    pictures = {
        "name": problem.pairs.names[i],
        "target": problem.pairs.pictures[i],
        "before": problem.rendered(start)[i],
        "after": problem.rendered(end)[i] if changed else None,
    }
    target = problem.target[i]
    pictures["residual_before"] = target - problem.picture(start)[i]
    pictures["residual_after"] = target - problem.picture(end)[i] if changed else None
    return pictures
