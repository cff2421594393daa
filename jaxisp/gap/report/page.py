"""report.json and report.html of a diagnosis: one page without scripts or requests that reads in a minute."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from jaxisp.errors import printable_lines
from jaxisp.gap.axes.null_bank import bank
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.report import advice
from jaxisp.gap.report.axes import ACROSS, PIXELS, STATISTICS, statistic_rows
from jaxisp.gap.report.downstream import downstream_part
from jaxisp.gap.report.parameters import parameters_of
from jaxisp.gap.report.plots import (
    CELL,
    curve,
    data_uri,
    difference_picture,
    gain_for,
    heat,
    heat_picture,
    heat_scale,
)
from jaxisp.gap.report.spectra import spectra_part
from jaxisp.gap.report.words import (
    any_of,
    begun,
    chance,
    counted,
    finite,
    listed,
    number,
    percent,
    span,
    words,
)
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.io.files import atomic_write, output_folder

_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jaxisp", "gap/report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
)
_PLOTS, _BARS = 6, 8
_LEAST_SHARE = 0.005  # least share of an axis that is listed
_MOVED = 0.005  # least relative change of a stage's parameters that is listed
_MORE = 0.02  # share of the gap by which one effect must close more than another to be mentioned
_KINDS = {
    "raw+jpeg": "RAW+JPEG pairs", "clean+noisy": "clean+noisy pairs", "jpeg+jpeg": "pairs of two JPEGs",
}  # fmt: skip
_SURE, _LIKELY = 0.9, 0.5  # probabilities from which the verdict says "lacks" and "probably lacks"
_WHEN = ("before", "after")
_FEWEST = 4  # pairs; see docs/how-to/diagnose.md
_WHOLE = 0.9  # of a frame, from which on it counts as diagnosed whole
_FEW_PIXELS = 250_000  # in clean+noisy pairs; fewer often give "unknown" (docs/diagnosis.md)
_SITES = {
    "scene": "the scene's light",
    "mosaic": "the mosaic as recorded",
    "demosaic": "demosaicking, which it replaces",
    "camera": "demosaicked camera RGB",
    "linear": "linear sRGB, after the colour matrix",
    "encoded": "the encoded picture",
    "output": "what the file holds",
}


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
    bars = _ranking(report)
    where = report["where"]
    shown = _clear(report)[:_PLOTS]
    others = [w for w in where if w not in shown and w["share"] >= _LEAST_SHARE]
    statistics = report["kind"] == "clean+noisy"
    page = _ENVIRONMENT.get_template("report.html").render(
        kind=_KINDS[report["kind"]],
        verdict=sentence(report),
        summary=_summary(report),
        warning=begun(few_pairs(report)),
        metric=begun(report["gap"]["metric"]),
        gap=_gap(report["gap"], bool(report["causes"])),
        reducible=reached(report["gap"], bool(report["causes"])),
        pictures=[p for p in [_pictures(pictures)] if p],
        statistics=statistics,
        heat=_heat(pictures),
        where=[_axis(w, statistics) for w in shown],
        nulls=len(bank()[report["kind"]]["largest"]) if any(w.get("usual") for w in shown) else 0,
        rest=", ".join(f"{words(w['axis'])} {percent(w['share'])}" for w in others),
        spectra=spectra_part(report["kind"], pictures),
        ranking=bars[:_BARS],
        more=bars[_BARS:],
        causes=[_cause(c) for c in report["causes"]],
        left=_left(report),
        next=next_measurements(report),
        downstream=downstream_part(report.get("downstream")),
        data=_data(report),
    )
    return printable_lines(page)


def sentence(report: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    causes = report["causes"]
    if report["verdict"] == "none":
        return "No gap beyond the floor: the simulator lacks nothing that these pairs can show."
    if report["verdict"] == "unknown" or not causes:
        return f"There is a gap, and no effect of the library is found in it.{_nearest(report)}"
    left = unexplained(report)
    rest = f". {left}." if left else "."
    if len(causes) == 1:
        c = causes[0]
        share = f"{percent(c['closed'])} {span(c['ci'])}"
        # above 1 if the remaining gap is below the floor
        closed = f"all of the gap ({share})" if c["closed"] > 1 else f"{share} of the gap"
        sure = f"probability {percent(c['probability'])}"
        return f"The simulator {_lacks(c)} {_group(c)} ({sure}): it closes {closed} on held-out pairs{rest}"
    each = "; ".join(f"{_group(c)} ({_told(c)})" for c in causes)
    return (
        f"The simulator {_lacks(*causes)} {len(causes)} effects, which close "
        f"{percent(sum(c['closed'] for c in causes))} of the gap on held-out pairs: {each}{rest}"
    )


def _lacks(*causes: Mapping[str, Any]) -> str:
    """The verb of the verdict, by the lowest probability of the causes."""
    least = min(cause["probability"] for cause in causes)
    return "lacks" if least >= _SURE else "probably lacks" if least >= _LIKELY else "may lack"


def _told(cause: Mapping[str, Any]) -> str:
    """The share that a cause closes, with its interval and its probability."""
    return f"{percent(cause['closed'])} {span(cause['ci'])}, probability {percent(cause['probability'])}"


def _nearest(report: Mapping[str, Any]) -> str:
    """The likeliest effects, as a sentence; "" if no effect was refitted."""
    likely = likeliest(report)
    if not likely:
        return ""
    each = [
        f"{words(row['effect'])} (probability {percent(row['probability'])}, closes {percent(row['closed'])})"
        for row in likely
    ]
    return f" Likeliest: {'; '.join(each)}."


def likeliest(report: Mapping[str, Any], count: int = 2) -> list[Mapping[str, Any]]:
    """The refitted candidates with the highest probabilities."""
    rows = [r for r in report["ranking"] if finite(r.get("probability")) and r["closed"] > 0]
    return sorted(rows, key=lambda row: -row["probability"])[:count]


def unexplained(report: Mapping[str, Any]) -> str:
    """The share of the gap that the named effects leave, and its axes; "" if it is small."""
    left = report["unexplained"]
    share = left["share"]
    considerable = report["causes"] and finite(share) and share >= CRITERIA[report["kind"]].considerable
    if not considerable:
        return ""
    axes = f", on {listed([words(axis) for axis in left['axes']])}" if left["axes"] else ""
    return f"{percent(share)} of the gap stays unexplained{axes}"


def few_pairs(report: Mapping[str, Any]) -> str:
    """A warning if there are too few pairs or pixels for a diagnosis, else ""."""
    names = [*report["pairs"]["fit"], *report["pairs"]["held_out"]]
    count = len({re.sub(r" \((even|odd) tiles\)$", "", name) for name in names})
    if count < _FEWEST:
        return (
            f"only {counted(count, 'pair')}: intervals and the choice are not reliable; give at least four."
        )
    statistics = report["kind"] == "clean+noisy" and report["verdict"] == "unknown"
    if statistics and report["pairs"]["pixels"] < _FEW_PIXELS:
        return (
            f"only {report['pairs']['pixels'] / 1e6:.2f} million pixels in all: noise tells little there; "
            "give eight pairs of 256x256 or more."
        )
    return ""


def _summary(report: Mapping[str, Any]) -> str:
    gap = report["gap"]
    change = (
        f"from {number(gap['before'])} to {number(gap['after'])}"
        if report["causes"]
        else number(gap["before"])
    )
    parts = [f"The gap is {change} where the floor is {number(gap['floor'])}."]
    if report["causes"]:
        parts = [f"Adding it takes the gap {change}; the floor is {number(gap['floor'])}."]
        if len(report["causes"]) > 1:
            parts[0] = parts[0].replace("Adding it", "Adding them")
    if report["where"]:
        clear = _clear(report)
        parts.append(
            f"It shows most by {words(clear[0]['axis'])}."
            if clear
            else "On no axis is it more than what cameras that lack nothing have."
        )
    return " ".join(parts)


def _clear(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The axes whose size exceeds chance and the null bank."""
    most = CRITERIA[report["kind"]].clear
    return [w for w in report["where"] if finite(w["p_value"]) and w["p_value"] <= most]


def _group(cause: Mapping[str, Any]) -> str:
    return any_of([cause["effect"], *cause["alternatives"]])


def _gap(gap: Mapping[str, Any], changed: bool) -> list[dict[str, Any]]:
    values = [gap["before"], gap["after"], gap["floor"], *gap["ci"]]
    top = max((v for v in values if finite(v)), default=0) * 1.02 or 1
    rows = [("before", gap["before"], None), ("after", gap["after"], gap["ci"])]
    if not changed:
        rows = [("gap", gap["before"], gap["ci"])]
    if _lower(gap):
        rows.append(("lowest of ours", gap["reducible"]["best"], None))
    if finite(gap.get("reference")):
        rows.append(("reference", gap["reference"], None))
    rows.append(("floor", gap["floor"], None))
    return [
        _bar(name, value, top, number(value) + (f" [{number(ci[0])}, {number(ci[1])}]" if ci else ""), ci)
        | {"kind": name}
        for name, value, ci in rows
    ]


def reached(gap: Mapping[str, Any], named: bool) -> str:
    """Compare the lowest gap of a flexible model with the gap after the named effects; "" without a model."""
    found = gap.get("reducible") or {}
    if not finite(found.get("best")):
        return ""
    if not _lower(gap):
        return "No flexible model of ours gets lower."
    if not named or not finite(found.get("explained")):
        return f"The lowest that any model of ours reaches is {number(found['best'])} ({found['how']})."
    share, how = percent(found["explained"]), found["how"]
    return f"Of the most that any model of ours reduces (lowest: {how}), the named effects are {share}."


def _lower(gap: Mapping[str, Any]) -> bool:
    """Whether a flexible model reaches a lower gap than the named effects."""
    best = (gap.get("reducible") or {}).get("best")
    return finite(best) and finite(gap["after"]) and best < gap["after"]


def _ranking(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = report["ranking"]
    refitted = [r for r in rows if r.get("ci")]
    ends = [v for r in refitted for v in (r["ci"][1], r.get("predicted")) if finite(v)]
    top = max([1.0, *ends])
    bars = []
    for row in rows:
        ci = row.get("ci")
        bar = _bar(words(row["effect"]), row["closed"], top, _closes(row), ci)
        bar |= {"kind": row["status"], "status": _status(row)}
        if ci and finite(row.get("predicted")):
            told = percent(row["predicted"]) if row["predicted"] > 0 else "nothing"
            bar |= {"mark": _place(row["predicted"], top), "predicted": told}
        bars.append(bar)
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


def _bar(name: str, value: float, top: float, text: str, ci: Sequence[float] | None) -> dict[str, Any]:
    span = None
    if ci and all(map(finite, ci)):
        first, last = (_place(v, top) for v in ci)
        span = (first, max(round(last - first, 2), 0.3))
    return {"name": name, "value": text, "width": _place(value, top), "range": span}


def _place(x: float, top: float) -> float:
    """Position of `x` in per cent of a track from 0 to `top`."""
    return round(100 * min(max(x / top, 0), 1), 2) if finite(x) else 0


def _axis(w: Mapping[str, Any], statistics: bool) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "name": words(w["axis"]),
        "share": percent(w["share"]),
        "size": f"{number(w['size'] / w['usual'])} times the usual, " if w.get("usual") else "",
        "p": chance(w["p_value"]),
    }
    if w.get("ci") and all(map(finite, w["ci"])):
        shown["share"] += f" {span(w['ci'])}"
        shown["bar"] = _bar("", w["share"], 1.0, "", w["ci"])
    if statistics:
        rows, note = statistic_rows(w)
        return shown | {"meaning": STATISTICS.get(w["axis"], ""), "rows": rows, "note": note}
    up = ", ".join(filter(None, (w.get("channel"), str(w.get("unit", "")).removesuffix(", steps"))))
    across, title = ACROSS.get(w["axis"], shown["name"]), f"residual by {shown['name']}"
    plot = Markup(curve(w["bins"], w["profile"], title, across, f"{up} [8-bit steps]".strip()))
    return shown | {"meaning": PIXELS.get(w["axis"], ""), "plot": plot, "note": ""}


def _heat(pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    """Where in the held-out picture the difference is, before and after, on one scale."""
    maps = {w: heat(pictures[f"residual_{w}"]) for w in _WHEN if pictures.get(f"residual_{w}") is not None}
    if not maps:
        return None
    top = max(float(np.percentile(values, 99)) for values in maps.values())
    shown = [("the camera's picture", pictures.get("target"))]
    for when, values in maps.items():
        whole = number(float(np.sqrt((values**2).mean())))
        shown.append((f"difference {when}, {whole} over all", heat_picture(values, top)))
    figures = [{"caption": text, "uri": data_uri(a)} for text, a in shown if a is not None]
    told = {"name": str(pictures.get("name", "")), "top": number(top), "cell": CELL}
    return told | {"figures": figures, "scale": Markup(heat_scale())}


def _cause(c: Mapping[str, Any]) -> dict[str, Any]:
    facts = [
        ("closes", [f"{percent(c['closed'])} {span(c['ci'])} of the gap, p {chance(c['p_value'])}"]),
        ("gap", [f"{number(c['gap_before'])} to {number(c['gap_after'])}"]),
        ("acts on", [_SITES.get(c["site"], c["site"])]),
        ("parameters", parameters_of(c)),
        ("looks the same", [", ".join(map(words, c["alternatives"]))]),
    ]
    return {"name": begun(words(c["effect"])), "facts": [(t, v) for t, v in facts if any(v)]}


def _left(report: Mapping[str, Any]) -> str:
    left = report["unexplained"]
    if report["verdict"] == "none":
        return f"Nothing beyond what cameras that lack nothing leave.{_power(report)}"
    shows = f" It shows by {listed([words(a) for a in left['axes']])}." if left["axes"] else ""
    short = f" {begun(left['short_of'])}." if left.get("short_of") else ""
    return f"{percent(left['share'])} of the gap is left.{shows}{short}"


def _power(report: Mapping[str, Any]) -> str:
    """The smallest effects that the gap would have shown, as a sentence; "" if that is not known."""
    seen = [
        f"{words(name)} ({row['parameter']} by {number(row['change'])})"
        for name, row in report.get("power", {}).items()
    ]
    return f" The smallest that would have shown: {', '.join(seen)}." if seen else ""


def next_measurements(report: Mapping[str, Any]) -> list[str]:
    """Suggested measurements, one sentence each."""
    if report["verdict"] == "none":
        return []
    found = [
        f"To tell {words(c['effect'])} from {any_of(c['alternatives']) or 'its look-alikes'}: "
        f"{c['next_measurement']}."
        for c in report["causes"]
        if c["next_measurement"]
    ]
    first = likeliest(report)
    if len(first) == 2 and not found:
        one, other = (row["effect"] for row in first)
        found.append(f"To tell {words(one)} from {words(other)}: {advice.told_apart(one, other)}.")
    left = report["unexplained"].get("next_measurement")
    if not left:
        return found
    settings = [words(row["effect"]) for row in first if row["effect"] in advice.SETTINGS]
    if settings:
        found.append(
            f"To take off what the camera does besides: a set with {' or '.join(settings)} switched off, "
            "given as --reference."
        )
    if "given" not in report["base"]:
        found.append(
            "To leave less to the plain base: fit a camera first (jaxisp fit), and give it with --camera."
        )
    return [*found, f"To see alone what is left: {left}."]


def sample_of(report: Mapping[str, Any]) -> str:
    """What part of the set was diagnosed; nothing of one that was diagnosed whole."""
    sample = report["pairs"].get("sample")
    if not sample:
        return ""
    few = sample["pairs"] < sample["of_pairs"]
    pairs = f"{sample['pairs']} of {sample['of_pairs']} pairs"
    (height, width), (whole_height, whole_width) = sample["size_px"], sample["of_size_px"]
    if height * width > _WHOLE * whole_height * whole_width:
        return pairs if few else ""
    middle = f"the middle {width}x{height} px of {whole_width}x{whole_height}"
    return f"{pairs}, {middle}" if few else f"{middle} of each pair"


def _data(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    base, pairs = report["base"], report["pairs"]
    shares = ((words(n), "" if s is None else f" {percent(s)}") for n, s in base["absorbed"].items())
    absorbed = ", ".join(name + share for name, share in shares)
    aside = [f["reason"] for f in pairs.get("failed", ())]
    aside += [f"{p['name']}: {p['reason']}" for p in pairs.get("left_out", ())]
    unmodelled = (f"{p['name']}: {p['reason']}" for p in pairs.get("encoder_not_modelled", ()))
    noted = (f"{p['name']}: {'; '.join(p['notes'])}" for p in pairs.get("raw_notes", ()))
    moved = [p for p in pairs.get("aligned", ()) if p["done"] != "nothing"]
    placed = (f"{p['name']} {p['done']} ({', '.join(f'{v:.1f}' for v in p['shift_px'])} px)" for p in moved)
    rows = [
        ("simulator", base.get("given", "")),
        ("base", ", ".join(map(words, base["stages"]))),
        ("fitted in it", ", ".join(map(words, base["fitted"]))),
        ("taken up by it", absorbed or "nothing of note"),
        ("moved to these pairs", _refitted(base.get("moved"))),
        ("moved by what was found", _moved(base)),
        ("fitted on", f"{counted(len(pairs['fit']), 'pair')}: {', '.join(pairs['fit'])}"),
        ("held out", f"{counted(len(pairs['held_out']), 'pair')}: {', '.join(pairs['held_out'])}"),
        ("diagnosed", sample_of(report)),
        ("laid on each other", ", ".join(placed)),
        (
            "not surely of one scene",
            ", ".join(p["name"] for p in pairs.get("aligned", ()) if not p["certain"]),
        ),
        ("left aside", "; ".join(aside)),
        ("JPEG encoder not modelled", "; ".join(unmodelled)),
        ("about the RAW files", "; ".join(noted)),
        ("time", f"{report['seconds']:.0f} s"),
    ]
    return [(term, text) for term, text in rows if text]


def _refitted(moved: Mapping[str, Any] | None) -> str:
    """What the light refit of a given camera moved, as text."""
    if moved is None:
        return ""
    before, after = moved["demosaicking"]
    other = "" if before == after else f", demosaicking from {before} to {after}"
    first, last = map(number, moved["error"])
    tone, matrix = number(moved["tone_steps"]), number(moved["matrix"])
    return (
        f"tone by up to {tone} steps, colour matrix by up to {matrix}{other}; "
        f"the error of the fitted pairs from {first} to {last}"
    )


def _moved(base: Mapping[str, Any]) -> str:
    """Relative change of each base stage's parameters once the causes are added, as text; largest first."""

    def flat(fields: Mapping[str, Any]) -> np.ndarray:
        return np.array([v for values in fields.values() for v in np.ravel(values)], float)

    moved = []
    for stage, fields in base.get("fitted_after", {}).items():
        was, is_now = flat(base["fitted"].get(stage, {})), flat(fields)
        share = (
            np.linalg.norm(is_now - was) / (np.linalg.norm(was) + 1e-9) if was.size == is_now.size else 0.0
        )
        if share >= _MOVED:
            moved.append((share, f"{words(stage)} {percent(share)}"))
    return ", ".join(text for _, text in sorted(moved, reverse=True))


def _pictures(pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    shown = [(1, "the camera's", pictures.get("target")), (2, "simulator, before", pictures.get("before"))]
    shown.append((3, "simulator, after", pictures.get("after")))
    differences = {w: pictures[f"residual_{w}"] for w in _WHEN if pictures.get(f"residual_{w}") is not None}
    candidate = pictures.get("candidate")
    gain = gain_for([*differences.values(), *([] if candidate is None else [candidate["changes"]])])
    if candidate is not None:
        caption = f"what {words(candidate['effect'])} changes, \N{MULTIPLICATION SIGN}{gain} about grey"
        shown.append((1, caption, difference_picture(candidate["changes"], gain)))
    for when, residual in differences.items():
        caption = f"difference {when}, \N{MULTIPLICATION SIGN}{gain} about grey"
        shown.append(
            (2 + _WHEN.index(when), caption, difference_picture(residual, gain))
        )  # below its picture
    figures = [{"column": c, "caption": text, "uri": data_uri(a)} for c, text, a in shown if a is not None]
    return {"name": str(pictures.get("name", "")), "figures": figures} if figures else None
