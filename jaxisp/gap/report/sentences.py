"""What a report says in sentences: its verdict, what is left, what to measure next."""

import re
from collections.abc import Mapping
from typing import Any

from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.report import advice
from jaxisp.gap.report.words import any_of, begun, counted, finite, listed, number, percent, span, words

_SURE, _LIKELY = 0.9, 0.5  # probabilities from which the verdict says "lacks" and "probably lacks"
_FEWEST = 4  # pairs; see docs/how-to/diagnose.md
_WHOLE = 0.9  # of a frame, from which on it counts as diagnosed whole
_FEW_PIXELS = 250_000  # in clean+noisy pairs; fewer often give "unknown" (docs/diagnosis.md)


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


def summary(report: Mapping[str, Any]) -> str:
    """How large the gap is, and where it shows most, in sentences."""
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
        clear = clear_axes(report)
        parts.append(
            f"It shows most by {words(clear[0]['axis'])}."
            if clear
            else "On no axis is it more than what cameras that lack nothing have."
        )
    return " ".join(parts)


def clear_axes(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The axes whose size exceeds chance and the null bank."""
    most = CRITERIA[report["kind"]].clear
    return [w for w in report["where"] if finite(w["p_value"]) and w["p_value"] <= most]


def _group(cause: Mapping[str, Any]) -> str:
    return any_of([cause["effect"], *cause["alternatives"]])


def reached(gap: Mapping[str, Any], named: bool) -> str:
    """Compare the lowest gap of a flexible model with the gap after the named effects; "" without a model."""
    found = gap.get("reducible") or {}
    if not finite(found.get("best")):
        return ""
    if not lower_reached(gap):
        return "No flexible model of ours gets lower."
    if not named or not finite(found.get("explained")):
        return f"The lowest that any model of ours reaches is {number(found['best'])} ({found['how']})."
    share, how = percent(found["explained"]), found["how"]
    return f"Of the most that any model of ours reduces (lowest: {how}), the named effects are {share}."


def lower_reached(gap: Mapping[str, Any]) -> bool:
    """Whether a flexible model reaches a lower gap than the named effects."""
    best = (gap.get("reducible") or {}).get("best")
    return finite(best) and finite(gap["after"]) and best < gap["after"]


def what_is_left(report: Mapping[str, Any]) -> str:
    """What the named effects leave, in sentences."""
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
