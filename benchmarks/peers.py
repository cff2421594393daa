"""Time every stage beside what a user would pick instead, the outputs compared first.

    make bench                                             # everything
    python -m benchmarks.peers demosaic jpeg               # some families; the others' results are kept
    python -m benchmarks.peers chain --only "12 MP"        # some cases of one, likewise
    python -m benchmarks.peers --render                    # only remake the page from the results

A family is a module of `benchmarks.cases`. Within a case our call, its gradient and the peers take
turns; medians and interquartile ranges are reported, losses beside wins. The floor is what this
machine needs at least, by the bandwidth of a copy and the speed of a matrix product measured in the
same run. Exit status 1 where a case or a peer did not run.
"""

import argparse
import importlib
import json
import pkgutil
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

import benchmarks.cases
from benchmarks import start
from benchmarks.case import Case, Peer
from benchmarks.machine import limits, load, machine, set_threads
from benchmarks.report import verdict, write_performance
from benchmarks.timing import WARM, interleaved, seconds, summary
from benchmarks.torch_peer import fetched

RESULTS = Path("benchmarks/results/peers.json")
PAGE = Path("docs/results/performance.md")
console = Console(width=150, highlight=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("families", nargs="*", help=f"of {', '.join(families())}; default: all")
    parser.add_argument("--only", default="", help="of each family, the cases with this in their title")
    parser.add_argument("--rounds", type=int, default=51, help="at most so many samples of each call")
    parser.add_argument("--seconds", type=float, default=6.0, help="for the rounds of one case")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    parser.add_argument("--render", action="store_true", help="time nothing, write the report")
    arguments = parser.parse_args()
    unknown = set(arguments.families) - set(families())
    if unknown:
        parser.error(f"no family {', '.join(sorted(unknown))}; there are {', '.join(families())}")
    good = True
    if not arguments.render:
        for name in arguments.families or families():
            how = arguments.rounds, arguments.seconds, arguments.only

            def keep(result: dict[str, Any], name: str = name) -> None:
                store(arguments.out, name, result)

            result = measure_family(name, *how, keep if arguments.only else None)
            keep(dict(result))
            good = good and not list(errors(result))
        if not arguments.families and not arguments.only:
            start.measure(arguments.out.with_name("start.json"))
    write_performance(arguments.report, peers=arguments.out)
    sys.exit(not good)


def families() -> list[str]:
    return sorted(module.name for module in pkgutil.iter_modules(benchmarks.cases.__path__))


def store(path: Path, family: str, result: dict[str, Any]) -> None:
    """Put one family's results, or some of its cases, in place of what the file has of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = json.loads(path.read_text())["families"] if path.exists() else {}
    fresh = {title(row): row for row in result["rows"]}
    partly = result.pop("partly", False)
    if partly and family in kept:
        rows = {title(row): row for row in kept[family]["rows"]} | fresh
        whole = {key: value for key, value in kept[family].items() if key != "error"}
        result = whole | result | {"rows": list(rows.values())}
    merged = {"families": dict(sorted((kept | {family: result}).items()))}
    path.write_text(json.dumps(merged, indent=1) + "\n")


def errors(result: dict[str, Any]) -> Iterator[str]:
    """Everything of a family that did not run."""
    for part in (result, *result["rows"], *(p for row in result["rows"] for p in row.get("peers", ()))):
        if "error" in part:
            yield part["error"]


def title(row: dict[str, Any]) -> str:
    return f"{row['stage']}, {row['size']}"


def measure_family(
    name: str,
    rounds: int,
    budget: float,
    only: str = "",
    keep: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """The family's results; some of its cases are kept one by one, as making the others takes a while."""
    console.rule(name)
    result: dict[str, Any] = {
        "load": [load()], "limits": limits(), "warm_ms": round(1e3 * WARM), "rows": [], "partly": bool(only)
    }  # fmt: skip
    try:
        for case in importlib.import_module(f"benchmarks.cases.{name}").cases():
            if only not in f"{case.stage}, {case.size}":
                continue
            row = measure(case, rounds, budget, result["limits"])
            result["rows"].append(row)
            tell(row)
            if keep:
                keep({"machine": machine(), **result, "load": [*result["load"], load()]})
    except Exception as error:
        result["error"] = describe(error)
    result["load"].append(load())
    return {"machine": machine(), **result}  # its threads are known once the peers are imported


def measure(case: Case, rounds: int, budget: float, limits: dict[str, Any]) -> dict[str, Any]:
    """One case as a row of the results."""
    row: dict[str, Any] = {"stage": case.stage, "size": case.size, "notes": case.notes}
    if case.images:
        row["images"] = case.images
    set_threads(None)
    try:
        jax.clear_caches()  # making the case may have compiled it already
        known = executables()
        row["first_call_s"] = round(seconds(case.ours), 2)
        row["temporaries_mb"] = temporaries(known)
        calls = {"ours": case.ours}
        if case.gradient is not None:
            row["gradient"] = {"first_call_s": round(seconds(case.gradient), 2)}
            calls["gradient"] = case.gradient
    except Exception as error:
        return row | {"error": describe(error)}
    row["peers"] = [compare(case, peer) for peer in case.peers]
    ready = [peer for peer, entry in zip(case.peers, row["peers"]) if "error" not in entry]
    calls |= {f"peer {peer.name}": peer.call for peer in ready}
    threads = {f"peer {peer.name}": peer.threads for peer in ready}
    samples = interleaved(calls, rounds, budget, threads)
    medians = {name: summary(times) for name, times in samples.items()}
    row |= medians["ours"] | {"rounds": len(samples["ours"])} | floor(case, medians["ours"]["ms"], limits)
    if case.gradient is not None:
        ratio = medians["gradient"]["ms"] / row["ms"]
        row["gradient"] |= medians["gradient"] | {"ratio": round(ratio, 2), "goal": case.gradient_goal}
    for entry in row["peers"]:
        if "error" not in entry:
            entry |= medians[f"peer {entry['name']}"]
            entry["ratio"] = round(entry["ms"] / row["ms"], 3)
    return row


def compare(case: Case, peer: Peer) -> dict[str, Any]:
    """How the outputs agree, before any time is taken."""
    entry: dict[str, Any] = {"name": peer.name, "goal": peer.goal}
    try:
        theirs = fetched(peer.call())
        if peer.agrees is not None:
            entry["outputs"] = peer.agrees(case.ours(), theirs)
    except Exception as error:
        entry["error"] = describe(error)
    return entry


def floor(case: Case, ms: float, limits: dict[str, Any]) -> dict[str, Any]:
    """The least time by bytes and by flops, whichever is longer; nothing where the case gives neither."""
    bandwidth = limits["copy_gb_per_s"].get(case.size, min(limits["copy_gb_per_s"].values()))
    by_bytes = 1e3 * case.bytes_moved / (1e9 * bandwidth)
    by_flops = 1e3 * case.flops / (1e9 * limits["peak_gflop_per_s"])
    least = max(by_bytes, by_flops)
    if not least:
        return {}
    bound = "bytes" if by_bytes >= by_flops else "flops"
    return {"floor_ms": round(least, 4), "floor_by": bound, "times_floor": round(ms / least, 1)}


def executables() -> list[Any]:
    return jax.devices()[0].client.live_executables()


def temporaries(known: list[Any]) -> float | None:
    """MB of scratch memory of the largest program compiled since; None where none was."""
    before = {id(program) for program in known}
    fresh = [program for program in executables() if id(program) not in before]
    sizes = [program.get_compiled_memory_stats().temp_size_in_bytes for program in fresh]
    return round(max(sizes) / 1e6, 1) if sizes else None


def describe(error: Exception) -> str:
    traceback.print_exc()
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"


def tell(row: dict[str, Any]) -> None:
    if "ms" not in row:
        console.print(f"{title(row)}: {row['error']}")
        return
    gradient = f", gradient {row['gradient']['ratio']:.1f}x" if "gradient" in row else ""
    least = f", {row['times_floor']}x the floor" if "times_floor" in row else ""
    spread = f"{row['ms']:.2f} ms ({row['iqr']:.2f})"
    console.print(f"{title(row)}: {spread}{gradient}{least}; first call {row['first_call_s']} s")
    for entry in row["peers"]:
        if "error" in entry:
            console.print(f"    {entry['name']}: {entry['error']}")
            continue
        figures = f"{entry['ms']:.2f} ms, {entry['ratio']:.2f}x ours, {verdict(entry)}"
        console.print(
            f"    {entry['name']}: {figures} ({entry.get('outputs', 'not compared')})", markup=False
        )


if __name__ == "__main__":
    main()
