"""The rows of report.json: the base, a cause, the ranking."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from math import erfc, sqrt
from typing import Any

import numpy as np

from jaxisp.gap.effects import EFFECTS
from jaxisp.gap.model import Model
from jaxisp.gap.refit import Trial
from jaxisp.pipeline import Gate


def base_row(
    model: Model,
    absorbed: Mapping[str, float | None],
    given: str | None = None,
    open_nodes: Iterable[str] = (),
) -> dict[str, Any]:
    """The base: its stages, its fitted numbers, what it absorbed, and what it is where it was given."""
    names = {c.node for c in model.base} | {*open_nodes}
    if given is None:
        names.add("demosaicking")
    fitted = {
        name: {f.name: np.asarray(getattr(model.shared[name], f.name)).tolist()
               for f in dataclasses.fields(model.shared[name])}
        for name in sorted(names) if name in model.shared
    }  # fmt: skip
    gates = {n.name: n.node.name for n in model.chain.nodes if isinstance(n, Gate)}
    on = [n.name for n in model.chain.nodes if n.name not in gates or float(model.shared[n.name].on) > 0.5]
    stages = [gates.get(name, name) for name in on]
    row = {"stages": stages, "fitted": fitted, "absorbed": dict(absorbed)}
    return row if given is None else row | {"given": given}


def cause_row(trial: Trial, alike: list[str], tried: int, model: Model) -> dict[str, Any]:
    effect = EFFECTS[trial.effect]
    params: dict[str, Any] = dict(trial.params)
    for i in () if params else model.indices([trial.effect]):
        moved = model.coordinates[i]
        key = moved.move.field + "".join(f"[{n}]" for n in moved.move.index)
        params[key] = round(float(model.origin(moved) + trial.z[i]), 5)
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
    return float(min(1.0, 0.5 * erfc(z / sqrt(2)) * tried))


def ranking_rows(
    causes: Sequence[tuple[Trial, list[str]]],
    trials: dict[str, Trial],
    promises: dict[str, float],
    candidates: Iterable[str],
    scale: float,
) -> list[dict[str, Any]]:
    """All candidates, best first: the share that each closes, and what screening had predicted: by a straight
    line, which knows no end, the whole at most. What was refitted has its interval, and whether it is
    possible: it takes pixels no farther away. A candidate that promised nothing, since the base takes it up
    or the file's header states it, comes last."""
    accepted = {t.effect: t for t, _ in causes}
    alike = {name for _, names in causes for name in names}
    rows = []
    for name, promise in promises.items():
        trial, promised = accepted.get(name, trials.get(name)), float(promise / scale)
        promised = min(promised, 1.0) if trial is None else promised
        status = "accepted" if name in accepted else "not_identifiable" if name in alike else "rejected"
        row = {"effect": name, "closed": promised, "status": status, "predicted": promised}
        if trial is not None:
            row |= {"closed": float(trial.closed), "ci": [trial.low, trial.high], "possible": trial.possible}
        rows.append(row)
    rows.sort(key=lambda row: (row["status"] != "accepted", -float(str(row["closed"]))))
    return rows + [
        {"effect": n, "closed": 0.0, "status": "absorbed"} for n in candidates if n not in promises
    ]
