"""Two reports of one kind side by side: of fits, of diagnoses or of evaluations."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxisp.errors import InputError
from jaxisp.io.files import read_json
from jaxisp.report.page import Page

REPORT = "report.json"
"""What a folder that is given has the report in."""

_LARGEST = sys.float_info.max
Report = Mapping[str, Any]
Value = tuple[str, str, str, Any]
"""The group, the name, the unit and the value of a figure."""


def read_report(path: str | Path) -> tuple[str, Report]:
    """A report and its kind, "fit", "diagnose" or "evaluate".

    Args:
        path: a folder that `fit --report` or `diagnose` wrote, or a file that holds what `--json` printed.

    Raises:
        InputError: it cannot be read, or is none of these.
    """
    file = Path(path, REPORT) if os.path.isdir(path) else Path(path)
    give = "give the folder of a report, or what --json printed"
    try:
        report = read_json(file)
    except InputError as error:
        raise InputError(f"{error}; {give}") from None
    for kind, keys in _KEYS.items():
        if keys <= set(report):
            return kind, report
    raise InputError(f"{file}: is no report of jaxisp fit, diagnose or evaluate; {give}")


def compare(a: str | Path, b: str | Path) -> dict[str, Any]:
    """The figures of two reports, matched by name.

    Args:
        a, b: as `read_report` takes them.

    Returns:
        {"kind", "a", "b": the paths, "values": [{"group", "name", "unit", "a", "b", "change"}, ...]}. A
        figure that a report lacks is None there; `change` is b less a, None where not both are numbers.

    Raises:
        InputError: as `read_report`; the reports are of two kinds; or they lack what reports of theirs have.
    """
    (kind, first), (other, second) = read_report(a), read_report(b)
    if kind != other:
        raise InputError(f"{a} is a report of jaxisp {kind}, {b} of jaxisp {other}: give two of one kind")
    found = [_values(kind, path, report) for path, report in ((a, first), (b, second))]
    names = list(dict.fromkeys(key for values in found for key in values))
    order = list(dict.fromkeys(group for group, _, _ in names))
    rows = []
    for group, name, unit in sorted(names, key=lambda key: order.index(key[0])):
        old, new = (values.get((group, name, unit)) for values in found)
        change = _change(old, new)
        rows.append({"group": group, "name": name, "unit": unit, "a": old, "b": new, "change": change})
    return {"kind": kind, "a": str(a), "b": str(b), "values": rows}


def comparison_page(result: Mapping[str, Any]) -> Page:
    """One page of what `compare` gives: a table a group, and a plot of what changed for each pair."""
    page = Page(
        f"Two reports of jaxisp {result['kind']}",
        f"A is {result['a']}, B is {result['b']}. A change is B less A.",
    )
    for group in dict.fromkeys(row["group"] for row in result["values"]):
        rows = [row for row in result["values"] if row["group"] == group]
        page.heading(group)
        changed = [(row["name"], row["change"]) for row in rows if row["change"] is not None]
        if group in _PLOTTED and len(changed) > 1:
            page.figures([(f"B less A: {group}", _plot(changed, rows[0]["unit"]))])
        page.table(("", "A", "B", "change"), map(cells, rows))
    return page


def cells(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """A row of values as text."""
    unit = f" [{row['unit']}]" if row["unit"] else ""
    return f"{row['name']}{unit}", shown(row["a"]), shown(row["b"]), shown(row["change"], signed=True)


def shown(value: Any, *, signed: bool = False) -> str:
    """A figure as text, with four digits."""
    if value is None:
        return ""
    if not _is_number(value):
        return str(value)
    if value == 0:
        return "0"
    return f"{value:{'+' if signed else ''}.4g}".replace("-", "\N{MINUS SIGN}")


def _change(old: Any, new: Any) -> Any:
    return new - old if _is_number(old) and _is_number(new) else None


def _is_number(value: Any) -> bool:
    """Whether it is one that a float can hold: JSON has integers of any length."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _values(kind: str, path: str | Path, report: Report) -> dict[tuple[str, str, str], Any]:
    try:
        return {(group, name, unit): value for group, name, unit, value in _READERS[kind](report)}
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise InputError(f"{path}: is damaged, or a report of another version ({error!r})") from None


def _of_fit(report: Report) -> Iterator[Value]:
    held = report["held_out"]
    yield "held out", "PSNR", "dB", held["psnr"]
    yield "held out", "SSIM", "", held["ssim"]
    yield "held out", "how", "", held["how"]
    yield "held out", "stages", "", report.get("design")
    yield "held out", "time", "s", report["seconds"]
    for pair in report["pairs"]:
        yield "PSNR of each pair, held out", pair["name"], "dB", pair["held_out_psnr"]
    for pair in report["pairs"]:
        yield "SSIM of each pair, held out", pair["name"], "", pair["held_out_ssim"]
    for own in report.get("parameters", ()):
        yield "parameters", own["name"], "", own["value"]


def _of_diagnosis(report: Report) -> Iterator[Value]:
    gap = report["gap"]
    yield "verdict", "verdict", "", report["verdict"]
    yield "verdict", "causes", "", ", ".join(cause["effect"] for cause in report["causes"]) or "none"
    yield "verdict", "unexplained share", "", report["unexplained"].get("share")
    yield "verdict", "pairs", "", report["kind"]
    yield "verdict", "time", "s", report["seconds"]
    for name in ("metric", "before", "after", "floor"):
        yield "gap", name, "", gap[name]
    for row in report["ranking"]:
        yield "share of the gap that each effect closes", row["effect"], "", row["closed"]
    for name, probability in report.get("probabilities", {}).items():
        yield "probability", name, "", probability
    for row in report["where"]:
        yield "share of the gap on each axis", row["axis"], "", row["share"]


def _of_evaluation(report: Report) -> Iterator[Value]:
    yield "compared in", "light", "", report.get("light")
    yield "compared in", "denoiser", "", report.get("model")
    yield "compared in", "clean pictures", "", report["normalised"]
    for key, (name, unit) in _MEASURES.items():
        yield "mean", name, unit, report["mean"].get(key)
    for method in report.get("methods", ()):
        yield "mean", f"PSNR of {method['name']}", "dB", method["mean"]["psnr"]
    key = "psnr" if all("psnr" in pair for pair in report["pairs"]) else "psnr_in"
    for pair in report["pairs"]:
        yield f"{_MEASURES[key][0]} of each pair", pair["name"], "dB", pair[key]


_MEASURES = {
    "psnr_in": ("PSNR of the input", "dB"), "psnr": ("PSNR", "dB"), "ssim_in": ("SSIM of the input", ""),
    "ssim": ("SSIM", ""), "psnr_fixed_in": ("PSNR of the input, fixed tone", "dB"),
    "psnr_fixed": ("PSNR, fixed tone", "dB"),
}  # fmt: skip
_KEYS = {
    "diagnose": {"verdict", "gap", "ranking"},
    "evaluate": {"pairs", "mean", "normalised"},
    "fit": {"pairs", "held_out", "seconds"},
}
_READERS: dict[str, Callable[[Report], Iterator[Value]]] = {
    "fit": _of_fit, "diagnose": _of_diagnosis, "evaluate": _of_evaluation,
}  # fmt: skip
_PLOTTED = (
    "PSNR of each pair, held out", "PSNR of each pair", "PSNR of the input of each pair",
    "share of the gap that each effect closes",
)  # fmt: skip
_MOST_BARS = 24


def _plot(changed: list[tuple[str, float]], unit: str) -> Any:
    """Bars of what changed, the largest first."""
    from matplotlib.figure import Figure

    rows = sorted(changed, key=lambda row: -abs(row[1]))[:_MOST_BARS]
    figure = Figure(figsize=(6.4, 0.6 + 0.24 * len(rows)))
    axes = figure.subplots()
    axes.barh(
        range(len(rows)), [v for _, v in rows], color=["tab:green" if v > 0 else "tab:red" for _, v in rows]
    )
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=8)
    axes.invert_yaxis()
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_xlabel(f"B less A [{unit or '1'}]")
    axes.spines[["top", "right"]].set_visible(False)
    return figure
