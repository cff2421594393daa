"""The tables of docs/results/abuse.md, from what the fuzzer and the killer wrote.

python -m experiments.abuse.report fuzz-*.json kill-*.json
"""

import collections
import json
import sys
from pathlib import Path
from typing import Any

COLUMNS = ("inputs", "accepted", "refused", "broken", "crash", "hang")


def main() -> None:
    tables = [json.loads(Path(name).read_text()) for name in sys.argv[1:]]
    print(fuzz_table([t for t in tables if "job" not in t]))
    print(kill_table([t for t in tables if "job" in t]))


def fuzz_table(runs: list[dict[str, Any]]) -> str:
    """All runs added up, a row for each kind of reader."""
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    peak: collections.Counter[str] = collections.Counter()
    for run in runs:
        for kind, found in run.items():
            counts[kind].update({name: found[name] for name in (*COLUMNS, "seconds")})
            counts[kind]["crash"] += found["exit"]
            peak[kind] = max(peak[kind], found["peak_growth_mb"])
    lines = [
        "| reader | inputs | accepted | refused | broken | crashes | hangs | seconds | most memory [MB] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind, found in counts.items():
        cells = [f"{found[name]:,}" for name in COLUMNS]
        lines.append(f"| {kind} | {' | '.join(cells)} | {found['seconds']:.0f} | {peak[kind]:.0f} |")
    whole = sum(counts.values(), collections.Counter())
    cells = [f"{whole[name]:,}" for name in COLUMNS]
    lines.append(
        f"| all | {' | '.join(cells)} | {whole['seconds']:.0f} | {max(peak.values(), default=0):.0f} |"
    )
    return "\n".join(lines) + "\n"


def kill_table(runs: list[dict[str, Any]]) -> str:
    """A row for each job."""
    lines = [
        "| command | trials | kills | wrong afterwards | undisturbed [s] |",
        "| --- | --- | --- | --- | --- |",
    ]
    for run in runs:
        cells = (
            run["job"],
            run["trials"],
            run["kills"],
            len(run["wrong"]),
            f"{run['seconds_undisturbed']:.1f}",
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
