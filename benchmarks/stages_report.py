"""The page of `benchmarks.stages`, made from the JSON alone."""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import significant, table, time

INTRODUCTION = """# Every stage

Made by `python -m benchmarks.stages`; the page alone by `python -m benchmarks.stages --render`.

Each stage runs at its default parameters on a batch of 32 images of 80x80. The gradient is to its parameters
and to the images. Times are medians in ms, with the interquartile range in brackets. *First call* is
compilation and one run.

Goals: a gradient takes at most 6 times the forward's time, a first call at most 6 s, and a stage that is
switched off at most 5 % of its time. No chain takes over twice the sum of its stages.
"""
GRADIENT, FIRST, OFF, CHAIN = 6.0, 6.0, 0.05, 2.0


def write_stages(path: Path, results: Path) -> None:
    found = json.loads(results.read_text())
    host = found["machine"]
    where = f"{host['processor']}, {host['cores']} cores, {host['backend']}, Python {host['python']}"
    before, after = found["load"]
    about = (
        f"{where}, jax {host['versions']['jax']}; load before and after the last run {before} and {after}."
    )
    parts = [INTRODUCTION, about, stages(found["stages"]) if found.get("stages") else ""]
    parts += [switches(found["switches"])] if "switches" in found else []
    parts += [chains(found["chains"])] if "chains" in found else []
    missed = results.with_name("missed-stages.md")
    parts += [missed.read_text()] if missed.exists() else []
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(part.rstrip() for part in parts if part) + "\n")


def stages(results: dict[str, Any]) -> str:
    head = ("stage", "forward", "gradient", "gradient / forward", "first call", "first gradient call")
    rows: list[list[str]] = []
    ratios: list[float] = []
    firsts: list[float] = []
    for name, of in results.items():
        forward, gradient = of["forward"], of["gradient"]
        ratios.append(gradient["ms"] / forward["ms"])
        firsts.append(max(forward["first_call_s"], gradient["first_call_s"]))
        ratio = f"{ratios[-1]:.1f}" + (" (goal missed)" if ratios[-1] > GRADIENT else "")
        calls = [f"{t['first_call_s']:.1f} s" for t in (forward, gradient)]
        rows.append([name, time(forward), time(gradient), ratio, *calls])
    slow, late = sum(r > GRADIENT for r in ratios), sum(f > FIRST for f in firsts)
    text = (
        f"{slow} of {len(rows)} gradients take more than {GRADIENT:g} times the forward's time, "
        f"{late} first calls more than {FIRST:g} s (the longest {max(firsts):.1f} s)."
    )
    return f"## Alone\n\n{text}\n\n{table(head, rows)}"


def switches(results: dict[str, Any]) -> str:
    rows: list[list[str]] = []
    missed = 0
    for name, of in results["stages"].items():
        share = of["off"]["ms"] / of["on"]["ms"]
        missed += share > OFF
        rows.append([
            name, time(of["on"]), time(of["off"]), f"{share:.1%}" + (" (goal missed)" if share > OFF else ""),
        ])  # fmt: skip
    text = (
        f"A stage in a `Gate`, one switch for the batch. Off, the images pass: a copy of them takes "
        f"{significant(results['copy']['ms'])} ms, call included. {missed} of {len(rows)} take more than "
        f"{OFF:.0%} of their time when off."
    )
    return f"## Switched off\n\n{text}\n\n{table(('stage', 'on', 'off', 'off / on'), rows)}"


def chains(results: list[dict[str, Any]]) -> str:
    rows: list[list[str]] = []
    worst = 0.0
    for row in results:
        ratio = row["ms"] / row["sum_ms"]
        worst = max(worst, ratio)
        cells = [significant(row["alone_ms"]), time(row), significant(row["sum_ms"]), f"{ratio:.2f}"]
        rows.append([row["size"], row["stage"], *cells, f"{row['first_call_s']:.1f} s"])
    text = (
        "The chain of nine stages that the peers' page compares, cut after each stage: in one program, and "
        f"the sum of its stages, each alone on what it gets there. At most {worst:.2f} times the sum "
        f"(goal {CHAIN:g} {'met' if worst <= CHAIN else 'missed'})."
    )
    head = ("size", "up to and with", "alone", "chain so far", "sum so far", "chain / sum", "first call")
    return f"## A chain and the sum of its stages\n\n{text}\n\n{table(head, rows)}"
