"""Rows of report.json for the base, a cause and the ranking."""

import dataclasses
from collections.abc import Iterable, Mapping
from math import erfc, sqrt
from typing import Any

import numpy as np

from jaxisp.gap.criteria import Criteria
from jaxisp.gap.report import advice
from jaxisp.gap.search.screening import closer_in_pixels
from jaxisp.gap.search.trial import Trial
from jaxisp.gap.search.verdict import Found
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Gate, Params


def base_row(
    model: Model,
    z: np.ndarray,
    absorbed: Mapping[str, float | None],
    given: str | None = None,
    open_nodes: Iterable[str] = (),
    after: Params | None = None,
) -> dict[str, Any]:
    """Describe the base at a point: its stages, fitted parameters and absorbed effects.

    Args:
        model: the simulator.
        z: the point, in the coordinates of the model.
        absorbed: share of the error that the base absorbed, by effect; None if it was not measured.
        given: description of a given base; None if a plain base was fitted.
        open_nodes: names of further nodes with fitted parameters.
        after: parameters once the causes are added; the base may have imitated some of them.
    """
    names = {c.node for c in model.base} | {*open_nodes}
    if given is None:
        names.add("demosaicking")

    def numbers(params: Params) -> dict[str, dict[str, Any]]:
        return {
            name: {f.name: np.asarray(getattr(params[name], f.name)).tolist()
                   for f in dataclasses.fields(params[name])}
            for name in sorted(names) if name in params
        }  # fmt: skip

    gates = {n.name: n.node.name for n in model.chain.nodes if isinstance(n, Gate)}
    on = [n.name for n in model.chain.nodes if n.name not in gates or float(model.shared[n.name].on) > 0.5]
    stages = [gates.get(name, name) for name in on]
    row = {"stages": stages, "fitted": numbers(model.params(z)), "absorbed": dict(absorbed)}
    row |= {} if after is None else {"fitted_after": numbers(after)}
    return row if given is None else row | {"given": given}


def cause_row(trial: Trial, alike: list[str], tried: int, model: Model, probability: float) -> dict[str, Any]:
    """Describe an accepted cause.

    Args:
        trial: the accepted trial.
        alike: effects that these pairs cannot distinguish from it.
        tried: number of effects tried, for the correction of the p-value.
        model: the simulator.
        probability: that it is there.
    """
    effect = EFFECTS[trial.effect]
    params: dict[str, Any] = dict(trial.params)
    for i in () if params else model.indices([trial.effect]):
        moved = model.coordinates[i]
        key = moved.move.field + "".join(f"[{n}]" for n in moved.move.index)
        params[key] = round(float(model.origin(moved) + trial.z[i]), 5)
    spread = max(
        (trial.closed - trial.low) / 1.645, 1e-6
    )  # of the lower side: the interval may be asymmetric
    return {
        "effect": trial.effect,
        "site": effect.site,
        "gap_before": trial.before,
        "gap_after": trial.after,
        "closed": trial.closed,
        "ci": [trial.low, trial.high],
        "alternatives": alike,
        "next_measurement": advice.between(trial.effect, alike),
        "p_value": _p_value(trial.closed / spread, tried),
        "probability": probability,
        "params": params,
    }


def _p_value(z: float, tried: int) -> float:
    """One-sided normal p-value, times the number of effects tried (Bonferroni)."""
    return float(min(1.0, 0.5 * erfc(z / sqrt(2)) * tried))


FARTHER = "takes pixels farther away"
NO_MORE = "closes no more than effects do where nothing is missing"
NOT_SURE = "the pairs are too few to be sure of it"
IMPROBABLE = "effects that are not there look like this, too"
NO_GAP = "there is no gap to close"
HIDDEN = "these pairs hardly show it, however strong"
ABSORBED = "taken up by the base fit"
STATED = "the file's header states it"
NO_COLOURS = "these pairs have no colours: a usual matrix stands for the camera's"
NO_HEADER = "without the file's header nothing tells it from the file's own compression"
"""Reasons in `ranking` for refusing a candidate."""
_COLOURS = {"hue", "saturation"}
"""Axes of the effects that act on colour alone."""


def _refusal(trial: Trial, found: Found, criteria: Criteria) -> str | None:
    """The reason for refusing a refitted effect; None if its interval alone is the reason."""
    causes = [t for t, _ in found.causes]
    if causes and closer_in_pixels(causes[0], trial, criteria):
        return f"takes pixels less near than {causes[0].effect}"
    if not trial.possible(criteria):
        return FARTHER
    if trial.low <= criteria.smallest:
        return None
    if not trial.accepted(criteria):
        return NOT_SURE if trial.low > trial.bars.least else NO_MORE
    if causes:
        return "closes too little beside " + " and ".join(t.effect for t in causes)
    return IMPROBABLE


def ranking_rows(
    found: Found, apart: Mapping[str, str], scale: float, criteria: Criteria, there: bool = True
) -> list[dict[str, Any]]:
    """Rank all candidates: accepted causes first, then by probability and the share of the gap that each
    closes.

    Each row has the predicted share. It is linear, so it is limited to 1 if there was no refit. Rows of
    refitted effects have the interval `ci`, `possible`: whether pixels stay as near to the real ones, their
    `probability`, the `signs` that it is computed from, and `searched`: whether the search accepted them.
    Effects that were not tried close 0; without a gap none closes anything. A `reason` is given for effects
    that were not tried, and for refused effects whose interval lies above `Criteria.smallest`.

    Args:
        found: result of the search.
        apart: reason for each effect that was not tried.
        scale: the gap above the floor.
        criteria: thresholds of the verdict.
        there: whether there is a gap.
    """
    accepted = {t.effect: t for t, _ in found.causes}
    alike = {name: t.effect for t, names in found.causes for name in names}
    colourless = NO_COLOURS in apart.values()
    rows = []
    for name, drop in found.predicted.items():
        trial, share = accepted.get(name, found.trials.get(name)), float(drop / scale)
        share = min(share, 1.0) if trial is None else share
        row = {"effect": name, "closed": share, "status": "rejected", "predicted": share}
        if trial is not None:
            row |= {
                "closed": float(trial.closed),
                "ci": [trial.low, trial.high],
                "possible": trial.possible(criteria),
            }
        if name in accepted:
            row["status"] = "accepted"
        elif name in alike:
            row |= {"status": "not_identifiable", "reason": f"looks the same as {alike[name]}"}
        elif name in found.hidden:
            row |= {"status": "not_identifiable", "reason": HIDDEN}
        elif colourless and {*EFFECTS[name].axes} <= _COLOURS:
            row |= {"status": "not_identifiable", "reason": NO_COLOURS}
        elif trial is not None and (why := _refusal(trial, found, criteria)):
            row |= {"reason": why}
        if not there:
            row = {"effect": name, "closed": 0.0, "status": row["status"], "reason": NO_GAP}
        elif name in found.probabilities:
            row |= {
                "probability": found.probabilities[name],
                "signs": dict(found.signs[name]),
                "searched": name in found.accepted,
            }
        rows.append(row)
    for name, why in apart.items():
        if name not in found.predicted:
            status = "not_identifiable" if why in (NO_HEADER, NO_COLOURS) else "absorbed"
            rows.append({"effect": name, "closed": 0.0, "status": status, "reason": why})
    return sorted(rows, key=_place)


def _place(row: Mapping[str, Any]) -> tuple[bool, float, float]:
    """The key of a row's place in the ranking; causes stay in the order of their closure."""
    named = row["status"] == "accepted"
    return not named, 0.0 if named else -row.get("probability", 0.0), -row["closed"]
