"""The pages of results, made from the JSON alone: the same JSON gives the same page."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks import musts
from benchmarks.timing import WARM

INTRODUCTION = """# Performance{where}

Made by `make bench`; the page alone by `python -m benchmarks.peers --render`.

Calls take turns in one process after a warm-up. Times are medians in ms, with the interquartile range in
brackets. Each call runs for {warm} ms before every sample of it, unless it takes over 0.3 s. Without that,
the first call after another library's took up to twice as long, as that one's threads wait busily. A batch is
32 images of 80x80. Outputs are compared before they are timed.

- *peer / ours*: above 1 this package is faster. *goal* is the least ratio aimed at.
- *floor*: bytes over the bandwidth of a copy of that size, or flops over the speed of a matrix product,
  whichever is larger. Both speeds are measured in the same run.
- *first call*: compilation and one run.
- *scratch*: memory of the compiled program beside its input and output.
"""


def write_performance(path: Path, peers: Path) -> None:
    """Write the page of `benchmarks.peers`, with what is known of the goals it misses."""
    parts = [INTRODUCTION.format(where="", warm=round(1e3 * WARM))]
    if peers.exists():
        results = json.loads(peers.read_text())["families"]
        parts = [INTRODUCTION.format(where=f" on {first_machine(results)}", warm=warm_up(results))]
        start = peers.with_name("start.json")
        began = json.loads(start.read_text()) if start.exists() else None
        parts += [tally(results), versions(results), asked_for(results, began), starts(began)]
        parts += [family(n, r) for n, r in results.items()]
    missed = peers.with_name("missed.md")
    if missed.exists():
        parts.insert(4, missed.read_text())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(part.rstrip() + "\n" for part in parts if part))


def first_machine(results: dict[str, Any]) -> str:
    machine = next(iter(results.values()))["machine"]
    return f"{machine['processor']}, {machine['cores']} cores"


def warm_up(results: dict[str, Any]) -> str:
    """ms, and more than one where families were not timed alike."""
    times = {result.get("warm_ms", 20) for result in results.values()}  # 20 until it was kept
    return " or ".join(map(str, sorted(times)))


def verdict(peer: dict[str, Any]) -> str:
    """Won or lost against a peer, and against the goal."""
    result = "won" if peer["ratio"] >= 1 else "lost"
    if peer["goal"] is None:
        return result
    return f"{result}, goal {'met' if peer['ratio'] >= peer['goal'] else 'missed'}"


def tally(results: dict[str, Any]) -> str:
    rows = [row for result in results.values() for row in result["rows"]]
    timed = [peer for row in rows for peer in row.get("peers", ()) if "ratio" in peer]
    verdicts = [verdict(peer) for peer in timed]
    won = sum(v.startswith("won") for v in verdicts)
    met, missed = (sum(v.endswith(word) for v in verdicts) for word in ("met", "missed"))
    slopes = [row["gradient"] for row in rows if "ratio" in row.get("gradient", {})]
    within = sum(g["ratio"] <= g["goal"] for g in slopes)
    return (
        f"Of {len(timed)} comparisons {won} are won and {len(timed) - won} lost; {met} goals are met and "
        f"{missed} missed. Of {len(slopes)} gradients {within} are within their goal."
    )


def asked_for(results: dict[str, Any], began: dict[str, Any] | None) -> str:
    """The goals set at the outset, met or missed."""
    rows = list(musts.rows(results, began))
    if not rows:
        return ""
    met = sum(row[-1] == "met" for row in rows)
    text = (
        f"{met} of {len(rows)} are met. A ratio is the other's time over ours. The time of the paper's code "
        "is the figure that its authors state, not measured here."
    )
    return f"## Goals\n\n{text}\n\n{table(musts.HEAD, rows)}"


def starts(began: dict[str, Any] | None) -> str:
    """How long a process takes to its first batch, and to its first gradient."""
    if not began:
        return ""
    names = {"first": "an empty cache", "second": "that cache again"}
    head = ("recipe phone in a new process", "imports", "first batch", "first gradient", "whole process")
    keys = ("import_s", "degrade_s", "gradient_s", "process_s")
    rows = [[name, *(f"{began[which][key]:.1f} s" for key in keys)] for which, name in names.items()]
    before, peak = began["develop"]["before_mb"], began["develop"]["peak_mb"]
    text = (
        f"By `python -m benchmarks.start`. Developing 12 MP, the process held {before} MB once its picture "
        f"was made, and at most {peak} MB after."
    )
    return f"## First and second start\n\n{table(head, rows)}\n\n{text}"


def versions(results: dict[str, Any]) -> str:
    """Of all runs; a library that one of them lacked is named."""
    found: dict[str, set[str]] = {}
    for result in results.values():
        for name, version in result["machine"]["versions"].items():
            found.setdefault(name, set()).add(version)
    absent = sorted(name for name, of in found.items() if "not installed" in of)
    text = ", ".join(f"{name} {' and '.join(sorted(of))}" for name, of in found.items() if name not in absent)
    left = f" Not installed in at least one run, its comparisons left out: {', '.join(absent)}."
    return f"{text}.{left if absent else ''}"


def family(name: str, result: dict[str, Any]) -> str:
    lines = [f"## {name}", "", about(result["machine"], result["load"], result["limits"]), ""]
    if "error" in result:
        lines += [f"**Stopped early: {result['error']}**", ""]
    ours = [row for row in result["rows"] if "ms" in row]
    if ours:
        lines += [table(OURS, map(our_cells, ours)), ""]
    pairs = [(row, peer) for row in ours for peer in row["peers"]]
    if pairs:
        lines += [table(PEERS, (peer_cells(row, peer) for row, peer in pairs)), ""]
    counted = [row for row in ours if "images" in row]
    if counted:
        lines += ["Images a second:", "", table(RATES, map(rate_cells, counted)), ""]
    failed = [row for row in result["rows"] if "error" in row]
    lines += [f"**{row['stage']}, {row['size']} did not run: {row['error']}**\n" for row in failed]
    noted = [row for row in result["rows"] if row.get("notes")]
    lines += [f"- {row['stage']}, {row['size']}: {row['notes']}" for row in noted]
    return "\n".join(lines)


def about(machine: dict[str, Any], load: list[float], limits: dict[str, Any]) -> str:
    threads = ", ".join(f"{k} {v}" for k, v in machine["threads"].items())
    copies = ", ".join(f"{v} ({k})" for k, v in limits["copy_gb_per_s"].items())
    host = (
        f"{machine['processor']}, {machine['cores']} cores, {machine['backend']}, Python {machine['python']}"
    )
    return (
        f"{host}; threads: {threads}; load before and after {load[0]} and {load[-1]}; copy {copies} GB/s, "
        f"matrix product {limits['peak_gflop_per_s']} Gflop/s."
    )


OURS = (
    "stage", "size", "ours", "gradient", "gradient / ours", "floor", "times the floor", "first call",
    "scratch",
)  # fmt: skip
PEERS = ("stage", "size", "peer", "peer", "ours", "peer / ours", "goal", "result", "outputs")
RATES = ("operator", "jaxisp", "AlbumentationsX", "kornia", "kornia, torch.compile")


def our_cells(row: dict[str, Any]) -> list[str]:
    slope = row.get("gradient")
    scratch = "" if row["temporaries_mb"] is None else f"{row['temporaries_mb']:.1f} MB"
    slope_cells = [time(slope), slope_ratio(slope)] if slope else ["", ""]
    floor_cells = ["", ""]
    if "floor_ms" in row:
        floor_cells = [f"{row['floor_ms']:.3g} ({row['floor_by']})", f"{row['times_floor']:.1f}"]
    first = f"{row['first_call_s']:.1f} s"
    return [row["stage"], row["size"], time(row), *slope_cells, *floor_cells, first, scratch]


def slope_ratio(slope: dict[str, Any]) -> str:
    missed = slope["ratio"] > slope["goal"]
    return f"{slope['ratio']:.1f}" + (f" (goal {slope['goal']:g} missed)" if missed else "")


def peer_cells(row: dict[str, Any], peer: dict[str, Any]) -> list[str]:
    first = [row["stage"], row["size"], peer["name"]]
    goal = "" if peer["goal"] is None else f"{peer['goal']:g}"
    if "error" in peer:
        return [*first, "", time(row), "", goal, f"did not run: {peer['error']}", ""]
    outputs = peer.get("outputs", "not compared")
    return [*first, time(peer), time(row), f"{peer['ratio']:.2f}", goal, verdict(peer), outputs]


def rate_cells(row: dict[str, Any]) -> list[str]:
    """Images a second, of each that ran."""
    timed = {"jaxisp": row, **{peer["name"]: peer for peer in row["peers"] if "ms" in peer}}
    rates = {name: f"{1e3 * row['images'] / entry['ms']:,.0f}" for name, entry in timed.items()}
    return [row["stage"], *(rates.get(name, "") for name in RATES[1:])]


def time(entry: dict[str, float]) -> str:
    return f"{significant(entry['ms'])} ({significant(entry['iqr'])})"


def significant(x: float) -> str:
    """Three digits, never in powers of ten."""
    return f"{x:.0f}" if x >= 100 else f"{x:.3g}"


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; bars in cells are escaped."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0]), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


EXACTNESS = """# Exactness

Made by `make bench` (`python -m benchmarks.exactness`). Each row is the worst of all its cases. Levels are of
an image in [0, 1] unless another unit is given. The tests hold the same bounds on fewer cases.

- Borders: all stages reflect about the edge pixel, which keeps the phase of the colour filters.
  colour-demosaicing repeats the edge pixel, so pixels near its borders differ by design: 1 px for bilinear, 2
  for Malvar, 8 for Menon.
- Double precision has the same bounds as single precision. Its figures show how much of them is rounding.
"""


def write_exactness(path: Path, results: Path) -> None:
    """Write the page of `benchmarks.exactness`."""
    found = json.loads(results.read_text())
    rows = found["rows"]
    passed = sum(row["passed"] for row in rows)
    host, head = found["machine"], ("stage", "reference", "what was run", "worst", "must", "result")
    where = f"{host['processor']}, {host['backend']}, jax {host['versions']['jax']}"
    about = f"{passed} of {len(rows)} rows pass. {where}."
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([EXACTNESS, about, "", table(head, map(exact_cells, rows)), ""]))


def exact_cells(row: dict[str, Any]) -> list[str]:
    sign = ">=" if row["at_least"] else "<="
    worst, must = (f"{row[key]:.3g} {row['unit']}".rstrip() for key in ("worst", "must"))
    result = "pass" if row["passed"] else "**FAIL**"
    return [row["stage"], row["reference"], row["ran"], worst, f"{sign} {must}", result]
