"""The content of report.json: the results of a diagnosis."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxisp.encoder import no_encoder
from jaxisp.gap.axes import Rows
from jaxisp.gap.axes.interval import interval
from jaxisp.gap.axes.null_bank import held_against_nulls
from jaxisp.gap.case import Case, Gap
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.downstream.ceiling import NETWORK, TOGETHER
from jaxisp.gap.pairs.align_raw import Aligned
from jaxisp.gap.pairs.pairs import INNER
from jaxisp.gap.report import advice
from jaxisp.gap.report.record import (
    ABSORBED,
    NO_COLOURS,
    NO_HEADER,
    STATED,
    base_row,
    cause_row,
    ranking_rows,
)
from jaxisp.gap.search.refit import clustered
from jaxisp.gap.search.verdict import Found
from jaxisp.gap.simulator.effects import JPEG_JPEG, RAW_JPEG
from jaxisp.gap.simulator.model import Model

METRIC = {
    RAW_JPEG: "mean square difference of camera's and simulator's picture in Y'CbCr, squared 8-bit steps, "
    "summed over the three channels, large errors of single edges weighed down",
    JPEG_JPEG: "mean square difference of the second picture and what is made of the first in Y'CbCr, "
    "squared 8-bit steps, summed over the three channels",
    "clean+noisy": "mean square difference of the statistics of the residual, mean error included, in "
    "units of what is harmless or chance (squared), those weighed up that differ on the fitted pairs",
}


def is_gap(case: Case, gap: Gap, found: Found) -> bool:
    """Whether the gap exceeds that of cameras that lack no effect, or a cause was accepted."""
    return bool(found.causes) or gap.exceeds(case.criteria.null_excess)


def after(gap: Gap, found: Found) -> float:
    """The held-out gap once the causes are added."""
    return found.causes[-1][0].after if found.causes else gap.before


def report_of(
    case: Case, gap: Gap, found: Found, aligned: Aligned, reducible: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Build the content of report.json, without the run time and the denoisers.

    Args:
        case: the diagnosed pairs and their base.
        gap: at the base.
        found: result of the search.
        aligned: the aligned pairs, and the files that could not be used.
        reducible: result of `downstream.ceiling.reducible`; None if it was not measured.
    """
    held, model, there = case.split.held_out, found.point.model, is_gap(case, gap, found)
    apart = dict.fromkeys(model.effects, STATED) | {"double_compression": NO_HEADER}
    apart |= dict.fromkeys(case.absorbed, ABSORBED) | dict.fromkeys(case.unidentifiable, NO_COLOURS)
    tried = len(case.offered) + (case.stored is not None)  # and film grain
    likely = found.probabilities
    causes = [cause_row(t, alike, tried, model, likely.get(t.effect, 1.0)) for t, alike in found.causes]
    ended = model.params(found.point.z) if causes else None
    where = held_against_nulls(found.before.where, case.kind, gap.before, gap.unit)
    opened = (*case.open_nodes, *case.unidentifiable)
    return {
        "schema": 1,
        "kind": case.kind,
        "base": base_row(case.point.model, case.point.z, case.absorbed, case.given, opened, ended)
        | dict(case.about),
        "pairs": {
            "fit": [case.pairs.names[i] for i in case.split.fit],
            "held_out": [case.pairs.names[i] for i in held],
            "pixels": int(case.pairs.mask[INNER].sum()),
        } | _aligned(aligned, case.outliers),
        "gap": {
            "metric": METRIC[case.kind], "before": gap.before, "after": after(gap, found), "floor": gap.floor,
            "unit": gap.unit, "floor_ci": list(gap.floor_ci or (gap.floor, gap.floor)),
            "ci": _interval(case, found, after(gap, found)),
            "axes": {row["axis"]: row["size"] for row in where},
        } | ({} if case.reference_gap is None else {"reference": case.reference_gap})
        | ({} if reducible is None else {"reducible": reducible}) | _statistics(found.before.rows),
        "verdict": "effect" if causes else "unknown" if there else "none",
        "causes": causes,
        "probabilities": dict(likely),
        "ranking": ranking_rows(found, apart, gap.scale, case.criteria, there),
        "where": where if there else [],
        "unexplained": _unexplained(case, gap, found, reducible),
        "seconds": 0.0,
    } | ({} if there else {"power": _power(found.smallest, model)})  # fmt: skip


def _power(smallest: Mapping[str, tuple[int, float]], model: Model) -> dict[str, dict[str, Any]]:
    """By effect, the parameter that shows best and the smallest change of it that would have made a gap."""
    found = {}
    for name, (i, change) in smallest.items():
        move = model.coordinates[i].move
        found[name] = {
            "parameter": move.field + "".join(f"[{n}]" for n in move.index),
            "change": change,
        }
    return found


def _aligned(aligned: Aligned, outliers: Mapping[str, str]) -> dict[str, Any]:
    """Alignment of the used pairs; pairs and files that are left out; encoders that are not modelled; what
    RAW files state that is not applied."""
    rows = {row["name"]: row for row in aligned.rows}
    return {
        "sample": dict(aligned.sample),
        "aligned": [row for name, row in rows.items() if name not in outliers],
        "left_out": [{"name": name, "reason": reason} for name, reason in outliers.items()],
        "failed": [{"file": name, "reason": reason} for name, reason in aligned.failed],
        "encoder_not_modelled": [
            {"name": pair.name, "reason": why}
            for pair in aligned.kept
            if pair.jpeg and (why := no_encoder(pair.jpeg))
        ],
        "raw_notes": [
            {"name": pair.name, "notes": list(pair.raw.notes)}
            for pair in aligned.kept
            if pair.raw and pair.raw.notes
        ],
    }


def _statistics(rows: Rows) -> dict[str, Any]:
    """Difference [units of tolerance and chance] and weight of each statistic, before any cause.

    The gap of clean+noisy pairs is the weighted mean of the squared differences. RAW+JPEG pairs have none.
    """
    found = {
        f"{row['axis']} {name}": [value, weight]
        for row in rows
        for name, value, weight in zip(row["bins"], row["profile"], row.get("weights", ()))
    }
    return {"statistics": found} if found else {}


def _interval(case: Case, found: Found, left: float) -> list[float]:
    """The 90 % interval [low, high] of the remaining gap.

    Film grain moves no parameter, so its part is subtracted from every picture in proportion.
    """
    units = case.evidence.units(found.point)[list(case.split.held_out)]
    share = left / max(float(np.nanmean(units)), 1e-12)
    return list(interval(clustered(case.evidence, share * units), 1.0))


def _unexplained(case: Case, gap: Gap, found: Found, reducible: Mapping[str, Any] | None) -> dict[str, Any]:
    criteria, left = case.criteria, after(gap, found)

    def axes(rows: Rows, at: float) -> list[str]:
        sure = [row for row in rows if row["p_value"] < criteria.by_chance]
        return _clear(held_against_nulls(sure, case.kind, at, gap.unit), criteria)

    there = is_gap(case, gap, found)
    share, shown = float(np.clip((left - gap.floor) / gap.scale, 0, 1)), axes(found.after.where, left)
    text = f"{100 * share:.0f} % of the gap is left" + (f", on {', '.join(shown)}" if shown else "")
    text += "" if there else ", no more than cameras that lack nothing have"
    wanted = shown if found.causes else axes(found.before.where, gap.before)
    next_one = advice.about(wanted) if there and share >= criteria.considerable else None
    row = {"share": share, "axes": shown, "description": text, "next_measurement": next_one}
    if there and share >= criteria.considerable:
        models = {} if reducible is None else reducible["models"]
        reached = {
            name: (left - models[name]) / max(left - gap.floor, 1e-6)
            for name in (TOGETHER, NETWORK)
            if name in models
        }
        row["short_of"] = advice.short_of(wanted, reached.get(TOGETHER), reached.get(NETWORK))
    if found.refused is None:
        return row
    causes = found.refused.causes
    then = causes[-1][0].after
    nearest = {
        "effects": [t.effect for t, _ in causes],
        "closed": float((gap.before - then) / gap.scale),
        "axes": axes(found.refused.after.where, then),
    }
    return row | {"nearest": nearest}


def _clear(rows: Rows, criteria: Criteria) -> list[str]:
    """Names of up to three axes that clearly show a part of the gap."""
    named = [r for r in rows if r["p_value"] <= criteria.clear and r["share"] > criteria.named_axis]
    return [str(row["axis"]) for row in named][:3]
