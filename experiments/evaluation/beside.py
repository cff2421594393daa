"""Tables of cameras of others, of real photographs, and of what other experiments found."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from experiments import real_gap_tables
from experiments.evaluation.bodies import TITLES
from experiments.evaluation.kept import Record
from experiments.null_bank import left_out
from experiments.third_party import tables as switches
from experiments.withheld.effects import KINDS
from experiments.withheld.libraw import SWITCHES
from experiments.withheld.tables import gap_of, table, truth, wilson

_SHORT = ("pictures", "pairs", "gap before", "after", "floor", "causes, share closed", "on these axes, share",
          "denoisers (spread over seeds)")  # fmt: skip


def libraw(records: Sequence[Record]) -> str:
    """LibRaw as the camera, a switch a row."""
    rows = []
    for r in sorted(records, key=lambda r: list(SWITCHES).index(truth(r)[0])):
        right = SWITCHES[truth(r)[0]].right
        if "failed" in r:
            rows.append([truth(r)[0], " or ".join(right), "LibRaw did not return", "", ""])
            continue
        first = r["causes"][0] if r["causes"] else r["verdict"]
        rows.append([truth(r)[0], " or ".join(right), first, "yes" if first in right else "no", gap_of(r)])
    return table(["switch", "right would be", "named first", "right", "gap (floor)"], rows)


def third_party(found: Sequence[Mapping[str, Any]]) -> str:
    rows = [[r["camera"], r["cases"], r["right"], r["first"], r["wrong"]] for r in found]
    return table(["camera", "cases", "named right", "truth ranked first", "another effect named"], rows)


def beside(found: Mapping[str, Any]) -> dict[str, str]:
    """Switches beside their camera's plain pictures: cases that the method was changed by, before and after,
    and others."""
    seen = [r for r in found["records"] if r["truth"]["case"] in found["seen"]]
    new = [r for r in found["records"] if r not in seen]
    return {
        "beside": switches.rates(new),
        "beside-by-case": switches.by_case(new),
        "beside-seen": switches.by_case(seen),
        "beside-before": switches.by_case(found["before"]),
    }


def left(names: Sequence[str]) -> str:
    """What of a sample did not run."""
    if not names:
        return "All cases of the sample ran.\n"
    return "Of the sample, these did not run:\n\n" + "".join(f"- {name}\n" for name in names)


def fresh(found: Mapping[str, Record]) -> str:
    """Whether intervals hold what a refit closes on scenes that were neither fitted nor held out."""
    rows = []
    for kind in KINDS:
        own = [r for r in found.values() if r["kind"] == kind]
        seen = [r for r in own if "fresh" in r]
        inside = sum(r["inside"] for r in seen)
        low, high = wilson(inside, len(seen))
        off = float(np.median([r["fresh"] - r["closed"] for r in seen]))
        rows.append([TITLES[kind], len(own), len(seen),
                     f"{inside}/{len(seen)} [{low:.0%}, {high:.0%}]", f"{off:+.2f}"])  # fmt: skip
    head = ["pairs", "cases", "named first", "share on fresh scenes inside the interval", "median difference"]
    return table(head, rows)


def drops(found: Mapping[str, Record]) -> str:
    """By how much an effect lowers the gap of a camera that lacks nothing, in floors."""
    rows = []
    for kind in KINDS:
        lows = [max((low for _, low in r["lowered"].values()), default=0.0)
                for r in found.values() if r["kind"] == kind]  # fmt: skip
        if lows:
            figures = (np.median(lows), np.percentile(lows, 95), np.max(lows))
            rows.append([TITLES[kind], len(lows), *(f"{value:.2f}" for value in figures)])
    head = ["pairs", "nulls", "lower end of the drop, median", "95 % of nulls below", "largest"]
    return table(head, rows)


def null_bank(records: Iterable[Record]) -> str:
    rows = []
    for kind in KINDS:
        by: dict[str, list[Mapping[str, float]]] = defaultdict(list)
        for r in records:
            if r["kind"] == kind:
                by[r["body"]].append(r["gap"]["axes"])
        beyond, count = left_out(by)
        rows.append([TITLES[kind], count, len(by), f"{beyond} ({beyond / count:.0%})"])
    return table(["pairs", "nulls", "bodies", "an axis beyond the bank of the other bodies"], rows)


def photographs(found: Mapping[str, Record]) -> str:
    """What is said of real photographs, in short; docs/results/real-gap.md has more."""
    rows = []
    for name, r in found.items():
        cells = dict(zip(real_gap_tables.HEAD, real_gap_tables.row(name, r)))
        rows.append([cells[column] for column in _SHORT])
    return table(_SHORT, rows)
