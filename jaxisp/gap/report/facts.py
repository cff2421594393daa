"""Tables of a page: the facts of each cause, and of the pairs and the base."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxisp.gap.report.parameters import parameters_of
from jaxisp.gap.report.sentences import sample_of
from jaxisp.gap.report.words import begun, chance, counted, number, percent, span, words

_MOVED = 0.005  # least relative change of a stage's parameters that is listed
_SITES = {
    "scene": "the scene's light",
    "mosaic": "the mosaic as recorded",
    "demosaic": "demosaicking, which it replaces",
    "camera": "demosaicked camera RGB",
    "linear": "linear sRGB, after the colour matrix",
    "encoded": "the encoded picture",
    "output": "what the file holds",
}


def facts_of_cause(c: Mapping[str, Any]) -> dict[str, Any]:
    """What is known of a cause, as (term, texts)."""
    facts = [
        ("closes", [f"{percent(c['closed'])} {span(c['ci'])} of the gap, p {chance(c['p_value'])}"]),
        ("gap", [f"{number(c['gap_before'])} to {number(c['gap_after'])}"]),
        ("acts on", [_SITES.get(c["site"], c["site"])]),
        ("parameters", parameters_of(c)),
        ("looks the same", [", ".join(map(words, c["alternatives"]))]),
    ]
    return {"name": begun(words(c["effect"])), "facts": [(t, v) for t, v in facts if any(v)]}


def facts_of_set(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What was diagnosed with what, as (term, text)."""
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
