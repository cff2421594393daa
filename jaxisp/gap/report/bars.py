"""Bars of a page: the gap beside its floor, and what each effect closes of it."""

from collections.abc import Mapping, Sequence
from typing import Any

from jaxisp.gap.report.sentences import lower_reached
from jaxisp.gap.report.words import finite, number, percent, span, words
from jaxisp.gap.simulator.effects import EFFECTS


def gap_bars(gap: Mapping[str, Any], changed: bool) -> list[dict[str, Any]]:
    """The gap before and after the causes, or alone where nothing changed, and what it is compared with."""
    values = [gap["before"], gap["after"], gap["floor"], *gap["ci"]]
    top = max((v for v in values if finite(v)), default=0) * 1.02 or 1
    rows = [("before", gap["before"], None), ("after", gap["after"], gap["ci"])]
    if not changed:
        rows = [("gap", gap["before"], gap["ci"])]
    if lower_reached(gap):
        rows.append(("lowest of ours", gap["reducible"]["best"], None))
    if finite(gap.get("reference")):
        rows.append(("reference", gap["reference"], None))
    rows.append(("floor", gap["floor"], None))
    return [
        bar(name, value, top, number(value) + (f" [{number(ci[0])}, {number(ci[1])}]" if ci else ""), ci)
        | {"kind": name}
        for name, value, ci in rows
    ]


def ranking_bars(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A bar for each effect, in the order of the ranking."""
    rows = report["ranking"]
    refitted = [r for r in rows if r.get("ci")]
    ends = [v for r in refitted for v in (r["ci"][1], r.get("predicted")) if finite(v)]
    top = max([1.0, *ends])
    bars = []
    for row in rows:
        ci = row.get("ci")
        shown = bar(words(row["effect"]), row["closed"], top, _closes(row), ci)
        shown |= {"kind": row["status"], "status": _status(row)}
        if ci and finite(row.get("predicted")):
            told = percent(row["predicted"]) if row["predicted"] > 0 else "nothing"
            shown |= {"mark": _place(row["predicted"], top), "predicted": told}
        bars.append(shown)
    return bars


def _closes(row: Mapping[str, Any]) -> str:
    """The share of the gap that a candidate closes, as text; in words if it is negative."""
    ci = row.get("ci")
    if finite(row["closed"]) and row["closed"] < 0:
        return "the gap grows" if ci else "nothing"
    return percent(row["closed"]) + (f" {span(ci)}" if ci else "")


def _status(row: Mapping[str, Any]) -> str:
    """The status of a candidate, with its probability, and its reason if it was refused."""
    said = "found" if row["status"] == "accepted" else row.get("reason", "")
    said = " ".join(words(word) if "_" in word or word in EFFECTS else word for word in said.split())
    likely = f"probability {percent(row['probability'])}" if finite(row.get("probability")) else ""
    return ", ".join(filter(None, (said, likely)))


def bar(name: str, value: float, top: float, text: str, ci: Sequence[float] | None) -> dict[str, Any]:
    """A bar of `value` on a track from 0 to `top`, with its interval."""
    ends = None
    if ci and all(map(finite, ci)):
        first, last = (_place(v, top) for v in ci)
        ends = (first, max(round(last - first, 2), 0.3))
    return {"name": name, "value": text, "width": _place(value, top), "range": ends}


def _place(x: float, top: float) -> float:
    """Position of `x` in per cent of a track from 0 to `top`."""
    return round(100 * min(max(x / top, 0), 1), 2) if finite(x) else 0
