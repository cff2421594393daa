"""report.json and report.html of a diagnosis: one page without scripts or requests that reads in a minute."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from jaxisp.errors import printable_lines
from jaxisp.gap.axes.null_bank import bank
from jaxisp.gap.report.axes import ACROSS, PIXELS, STATISTICS, statistic_rows
from jaxisp.gap.report.bars import bar, gap_bars, ranking_bars
from jaxisp.gap.report.downstream import downstream_part
from jaxisp.gap.report.facts import facts_of_cause, facts_of_set
from jaxisp.gap.report.figures import heat_figures, side_by_side
from jaxisp.gap.report.plots import curve
from jaxisp.gap.report.sentences import (
    clear_axes,
    few_pairs,
    next_measurements,
    reached,
    sentence,
    summary,
    what_is_left,
)
from jaxisp.gap.report.spectra import spectra_part
from jaxisp.gap.report.words import begun, chance, finite, number, percent, span, words
from jaxisp.io.files import atomic_write, output_folder

_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jaxisp", "gap/report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
)
_PLOTS, _BARS = 6, 8
_LEAST_SHARE = 0.005  # least share of an axis that is listed
_KINDS = {
    "raw+jpeg": "RAW+JPEG pairs", "clean+noisy": "clean+noisy pairs", "jpeg+jpeg": "pairs of two JPEGs",
}  # fmt: skip


def write_report(report: Mapping[str, Any], pictures: Mapping[str, Any], folder: str | Path) -> Path:
    """Write `report.json` and `report.html` into a folder.

    Args:
        report: the content of report.json.
        pictures: of one held-out pair: `name`; `target`, `before` and `after` (H, W, 3) in [0, 1];
            `residual_before` and `residual_after` (h, w, 3) in Y'CbCr, 8-bit steps. Of all held-out pairs:
            `spread_before`, `spread_after` and `spread_real` or `spread_floor`, see
            `jaxisp.gap.features.spectra`; `candidate`, the likeliest effect: its name `effect`, and what it
            `changes`, (h, w, 3) like the residuals. All keys but `name` may be absent or None.
        folder: created if it does not exist.

    Returns:
        the path of `report.html`.

    Raises:
        InputError: the folder cannot be written.
    """
    folder = output_folder(folder)
    text = json.dumps(plain(report), indent=1, allow_nan=False)
    with atomic_write(folder / "report.json") as file:
        file.write((text + "\n").encode())
    page = folder / "report.html"
    with atomic_write(page) as file:
        file.write(html(report, pictures).encode())
    return page


def plain(value: Any) -> Any:
    """Convert NumPy values to types that JSON supports; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def html(report: Mapping[str, Any], pictures: Mapping[str, Any]) -> str:
    """Render the page as HTML; arguments as for `write_report`."""
    report = plain(report)
    bars = ranking_bars(report)
    where = report["where"]
    shown = clear_axes(report)[:_PLOTS]
    others = [w for w in where if w not in shown and w["share"] >= _LEAST_SHARE]
    statistics = report["kind"] == "clean+noisy"
    page = _ENVIRONMENT.get_template("report.html").render(
        kind=_KINDS[report["kind"]],
        verdict=sentence(report),
        summary=summary(report),
        warning=begun(few_pairs(report)),
        metric=begun(report["gap"]["metric"]),
        gap=gap_bars(report["gap"], bool(report["causes"])),
        reducible=reached(report["gap"], bool(report["causes"])),
        pictures=[p for p in [side_by_side(pictures)] if p],
        statistics=statistics,
        heat=heat_figures(pictures),
        where=[_axis(w, statistics) for w in shown],
        nulls=len(bank()[report["kind"]]["largest"]) if any(w.get("usual") for w in shown) else 0,
        rest=", ".join(f"{words(w['axis'])} {percent(w['share'])}" for w in others),
        spectra=spectra_part(report["kind"], pictures),
        ranking=bars[:_BARS],
        more=bars[_BARS:],
        causes=[facts_of_cause(c) for c in report["causes"]],
        left=what_is_left(report),
        next=next_measurements(report),
        downstream=downstream_part(report.get("downstream")),
        data=facts_of_set(report),
    )
    return printable_lines(page)


def _axis(w: Mapping[str, Any], statistics: bool) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "name": words(w["axis"]),
        "share": percent(w["share"]),
        "size": f"{number(w['size'] / w['usual'])} times the usual, " if w.get("usual") else "",
        "p": chance(w["p_value"]),
    }
    if w.get("ci") and all(map(finite, w["ci"])):
        shown["share"] += f" {span(w['ci'])}"
        shown["bar"] = bar("", w["share"], 1.0, "", w["ci"])
    if statistics:
        rows, note = statistic_rows(w)
        return shown | {"meaning": STATISTICS.get(w["axis"], ""), "rows": rows, "note": note}
    up = ", ".join(filter(None, (w.get("channel"), str(w.get("unit", "")).removesuffix(", steps"))))
    across, title = ACROSS.get(w["axis"], shown["name"]), f"residual by {shown['name']}"
    plot = Markup(curve(w["bins"], w["profile"], title, across, f"{up} [8-bit steps]".strip()))
    return shown | {"meaning": PIXELS.get(w["axis"], ""), "plot": plot, "note": ""}
