"""report.json and report.html of a diagnosis: one page without scripts or requests that reads in a minute."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from jaxisp.gap.report_downstream import downstream_part
from jaxisp.gap.report_plots import curve, data_uri, spectrum_picture
from jaxisp.io.files import atomic_write, output_folder

_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jaxisp", "gap"), autoescape=True, trim_blocks=True, lstrip_blocks=True
)
_PLOTS, _BARS = 6, 8
_PER_CENT = "\N{NO-BREAK SPACE}%"
_CLEAR = 0.05  # axes whose p-value is above are only listed
_STATUS = {
    "accepted": "found",
    "rejected": "",
    "absorbed": "taken up by the base fit",
    "not_identifiable": "cannot be told apart",
}


def write_report(report: Mapping[str, Any], pictures: Mapping[str, Any], folder: str | Path) -> Path:
    """Write `report.json` and `report.html` into a folder.

    Args:
        report: what report.json holds.
        pictures: of one held-out pair: `name`; `target`, `before` and `after` (H, W, 3) in [0, 1];
            `residual_before` and `residual_after` (h, w, 3) in Y'CbCr, 8-bit steps; `spectrum_before` (h, w)
            energies. Any but the first may be absent or None.
        folder: made where it does not exist.

    Returns:
        the path of `report.html`.

    Raises:
        InputError: nothing can be written there.
    """
    folder = output_folder(folder)
    text = json.dumps(_plain(report), indent=1, allow_nan=False)
    with atomic_write(folder / "report.json") as file:
        file.write((text + "\n").encode())
    page = folder / "report.html"
    with atomic_write(page) as file:
        file.write(html(report, pictures).encode())
    return page


def _plain(value: Any) -> Any:
    """Numbers and lists that JSON knows; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def html(report: Mapping[str, Any], pictures: Mapping[str, Any]) -> str:
    """The page as text."""
    report = _plain(report)
    bars = _ranking(report)
    where = report["where"]
    shown = [w for w in where if _finite(w["p_value"]) and w["p_value"] < _CLEAR][:_PLOTS] or where[:1]
    others = [w for w in where if w not in shown]
    return _ENVIRONMENT.get_template("report.html").render(
        kind="RAW+JPEG pairs" if report["kind"] == "raw+jpeg" else "clean+noisy pairs",
        verdict=sentence(report),
        summary=_summary(report),
        metric=report["gap"]["metric"][:1].upper() + report["gap"]["metric"][1:],
        gap=_gap(report["gap"], bool(report["causes"])),
        pictures=[p for p in [_pictures(pictures)] if p],
        where=[_axis(w) for w in shown],
        rest=", ".join(f"{_words(w['axis'])} {_percent(w['share'])}" for w in others),
        ranking=bars[:_BARS],
        more=bars[_BARS:],
        causes=[_cause(c) for c in report["causes"]],
        left=_left(report["unexplained"]),
        next=_next(report["causes"]),
        downstream=downstream_part(report.get("downstream")),
        data=_data(report),
    )


def sentence(report: Mapping[str, Any]) -> str:
    """The verdict."""
    causes = report["causes"]
    if report["verdict"] == "none":
        return "No gap beyond the floor: the simulator lacks nothing that these pairs can show."
    if report["verdict"] == "unknown" or not causes:
        return "There is a gap, and no effect of the library explains it."
    if len(causes) == 1:
        c = causes[0]
        return (
            f"The simulator lacks {_group(c)}: it closes {_percent(c['closed'])} "
            f"{_range(c['ci'])} of the gap on held-out pairs."
        )
    each = "; ".join(f"{_group(c)} ({_percent(c['closed'])} {_range(c['ci'])})" for c in causes)
    return (
        f"The simulator lacks {len(causes)} effects, which close "
        f"{_percent(sum(c['closed'] for c in causes))} of the gap on held-out pairs: {each}."
    )


def _summary(report: Mapping[str, Any]) -> str:
    gap = report["gap"]
    change = (
        f"from {_number(gap['before'])} to {_number(gap['after'])}"
        if report["causes"]
        else _number(gap["before"])
    )
    parts = [f"The gap is {change} where the floor is {_number(gap['floor'])}."]
    if report["causes"]:
        parts = [f"Adding it takes the gap {change}; the floor is {_number(gap['floor'])}."]
        if len(report["causes"]) > 1:
            parts[0] = parts[0].replace("Adding it", "Adding them")
    if report["where"]:
        parts.append(f"It shows most by {_words(report['where'][0]['axis'])}.")
    return " ".join(parts)


def _group(cause: Mapping[str, Any]) -> str:
    return _any([cause["effect"], *cause["alternatives"]])


def _any(names: Sequence[str]) -> str:
    return " or ".join(map(_words, names))


def _gap(gap: Mapping[str, Any], changed: bool) -> list[dict[str, Any]]:
    values = [gap["before"], gap["after"], gap["floor"], *gap["ci"]]
    top = max((v for v in values if _finite(v)), default=0) * 1.02 or 1
    floor = ("floor", gap["floor"], None)
    rows = [("before", gap["before"], None), ("after", gap["after"], gap["ci"]), floor]
    if not changed:
        rows = [("gap", gap["before"], gap["ci"]), floor]
    return [
        _bar(name, value, top, _number(value) + (f" [{_number(ci[0])}, {_number(ci[1])}]" if ci else ""), ci)
        | {"kind": name}
        for name, value, ci in rows
    ]


def _ranking(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    found = {c["effect"]: c for c in report["causes"]}
    rows = report["ranking"]
    top = max([1.0, *(c["ci"][1] for c in found.values() if _finite(c["ci"][1]))])
    bars = []
    for row in rows:
        cause = found.get(row["effect"])
        ci = cause["ci"] if cause else None
        bar = _bar(
            _words(row["effect"]),
            row["closed"],
            top,
            _percent(row["closed"]) + (f" {_range(ci)}" if ci else ""),
            ci,
        )
        bars.append(bar | {"kind": row["status"], "status": _STATUS.get(row["status"], row["status"])})
    return bars


def _bar(name: str, value: float, top: float, text: str, ci: Sequence[float] | None) -> dict[str, Any]:
    def place(x: float) -> float:
        return round(100 * min(max(x / top, 0), 1), 2) if _finite(x) else 0

    span = None
    if ci and all(map(_finite, ci)):
        span = (place(ci[0]), max(round(place(ci[1]) - place(ci[0]), 2), 0.3))
    return {"name": name, "value": text, "width": place(value), "range": span}


def _axis(w: Mapping[str, Any]) -> dict[str, Any]:
    of = f"; {w['channel']}" if w.get("channel") else ""
    unit = f", {w['unit']}" if w.get("unit") else ""
    return {
        "name": _words(w["axis"]),
        "share": _percent(w["share"]),
        "p": _chance(w["p_value"]),
        "note": of + unit,
        "plot": Markup(curve(w["bins"], w["profile"], f"residual by {_words(w['axis'])}")),
    }


def _cause(c: Mapping[str, Any]) -> dict[str, Any]:
    facts = [
        ("closes", f"{_percent(c['closed'])} {_range(c['ci'])} of the gap, p {_chance(c['p_value'])}"),
        ("gap", f"{_number(c['gap_before'])} to {_number(c['gap_after'])}"),
        ("goes to", c["site"]),
        ("parameters", ", ".join(f"{k} {_value(v)}" for k, v in c["params"].items())),
        ("looks the same", ", ".join(map(_words, c["alternatives"]))),
    ]
    return {"name": _words(c["effect"]).capitalize(), "facts": [(t, v) for t, v in facts if v]}


def _left(left: Mapping[str, Any]) -> str:
    text = str(left["description"]).strip()
    text = text[:1].upper() + text[1:]
    if not text:
        text = f"{_percent(left['share'])} of the gap"
        text += f", by {', '.join(map(_words, left['axes']))}" if left["axes"] else ""
    return text if text.endswith((".", "!", "?")) else text + "."


def _next(causes: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        f"To tell {_words(c['effect'])} from {_any(c['alternatives']) or 'its look-alikes'}: "
        f"{c['next_measurement']}."
        for c in causes
        if c["next_measurement"]
    ]


def _data(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    base, pairs = report["base"], report["pairs"]
    absorbed = ", ".join(f"{_words(n)} {_percent(s)}" for n, s in base["absorbed"].items())
    failed = "; ".join(f"{f['file']}: {f['reason']}" for f in pairs.get("failed", ()))
    rows = [
        ("simulator", base.get("given", "")),
        ("base", ", ".join(map(_words, base["stages"]))),
        ("fitted in it", ", ".join(map(_words, base["fitted"]))),
        ("taken up by it", absorbed or "nothing of note"),
        ("fitted on", f"{len(pairs['fit'])} pairs: {', '.join(pairs['fit'])}"),
        ("held out", f"{len(pairs['held_out'])} pairs: {', '.join(pairs['held_out'])}"),
        ("left aside", failed),
        ("time", f"{report['seconds']:.0f} s"),
    ]
    return [(term, text) for term, text in rows if text]


def _pictures(pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    shown = [("the camera's", pictures.get("target")), ("simulator, before", pictures.get("before"))]
    shown.append(("simulator, after", pictures.get("after")))
    for key, caption in (("residual_before", "difference before"), ("residual_after", "difference after")):
        if pictures.get(key) is not None:
            shown.append((f"{caption}, x8 about grey", _difference(pictures[key])))
    if pictures.get("spectrum_before") is not None:
        shown.append(("spectrum of the difference", spectrum_picture(pictures["spectrum_before"])))
    figures = [{"caption": text, "uri": data_uri(a)} for text, a in shown if a is not None]
    return {"name": str(pictures.get("name", "")), "figures": figures} if figures else None


def _difference(residual: Any, gain: float = 8) -> np.ndarray:
    """(h, w, 3) Y'CbCr steps as RGB about grey."""
    y, cb, cr = np.moveaxis(np.asarray(residual, np.float64), -1, 0) * gain / 255
    return 0.5 + np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], -1)


def _words(name: str) -> str:
    fixed = {
        "cfa_phase": "colour filter phase",
        "block_phase": "8x8 block phase",
        "prnu": "PRNU",
        "lag": "noise lag",
    }
    acronyms = {"adc": "ADC", "jpeg": "JPEG", "cfa": "CFA", "lut": "LUT", "color": "colour"}
    return fixed.get(name) or " ".join(acronyms.get(part, part) for part in str(name).split("_"))


def _finite(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def _percent(share: Any) -> str:
    if not _finite(share):
        return "unknown"
    percent = 100 * float(share)
    digits = 1 if 0.05 <= abs(percent) < 0.95 else 0
    return f"{percent:.{digits}f}{_PER_CENT}".replace("-0" + _PER_CENT, "0" + _PER_CENT)


def _range(ci: Sequence[Any]) -> str:
    return "[" + ",\N{NO-BREAK SPACE}".join(_percent(v).removesuffix(_PER_CENT) for v in ci) + "]"


def _number(value: Any) -> str:
    """Three figures, without an exponent where there is no need of one."""
    if not _finite(value):
        return "unknown"
    value = float(value)
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def _value(value: Any) -> str:
    return ", ".join(map(_value, value)) if isinstance(value, (list, tuple, np.ndarray)) else (
        _number(value) if _finite(value) else str(value)
    )  # fmt: skip


def _chance(p: Any) -> str:
    return "unknown" if not _finite(p) else "< 0.001" if p < 0.001 else f"= {p:.2g}"
