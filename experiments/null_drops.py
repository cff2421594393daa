"""By how much effects lower the gap of cameras that lack nothing, where they are looked for all the same.

    python -m experiments.null_drops --bodies elm fig --limit 16 --out null-drops.json

A diagnosis does not look where the gap is near its floor; here it does, for one cause. What an effect must
lower a gap by, `jaxisp.gap.criteria.Criteria.null_drop`, should be above what 95 % of these cameras have. A
run that was broken off goes on; the page is written beside the file.
"""

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.withheld.bodies import BODIES
from experiments.withheld.effects import KINDS
from experiments.withheld.shoot import write
from experiments.withheld.study import Case, cases, shuffled
from experiments.withheld.tables import table
from jaxisp.gap import diagnose
from jaxisp.gap.criteria import CRITERIA
from jaxisp.io.files import write_text

Record = dict[str, Any]
PAGE = """# What effects lower where nothing is missing

```sh
python -m experiments.null_drops {command}
```

Cameras that lack nothing ([the study](../diagnosis-evaluation.md)), in which a diagnosis looks for a cause
though their gap is near its floor. Of each camera the effect that lowers the gap of the held-out pairs most
surely, of those that take pixels no farther away: by how much, in floors (RAW+JPEG: of {unit} squared 8-bit
steps at least), and the lower end of that drop's 90 % interval, which is what an effect is accepted by.

{summary}
{cases}"""


def drops(report: Mapping[str, Any]) -> Record:
    """The gap, and what each refitted effect lowers it by, in units, and the low end of that's interval."""
    gap = report["gap"]
    floor = gap["floor"]
    unit = max(floor, CRITERIA[report["kind"]].least_unit)
    scale = max(gap["before"] - floor, 0.02 * floor, 1e-6)
    refitted = [row for row in report["ranking"] if "ci" in row and row.get("possible")]
    lowered = {row["effect"]: [row["closed"] * scale / unit, row["ci"][0] * scale / unit] for row in refitted}
    return {"above": (gap["before"] - floor) / unit, "lowered": lowered}


def looked_at(case: Case) -> Record:
    """One null, diagnosed as if its gap were worth it."""
    criteria = CRITERIA[case.kind]
    criteria = dataclasses.replace(criteria, null_drop=-np.inf, null_excess=0.0, most_causes=1)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), case.body, dict(case.effects), case.kind, case.scenes)
        return {"case": case.name, "kind": case.kind} | drops(diagnose(folder, criteria=criteria).report)


def most(record: Record) -> tuple[str, float, float]:
    """The effect whose interval is highest at its low end."""
    name = max(record["lowered"], key=lambda n: record["lowered"][n][1], default="")
    return (name, *record["lowered"][name]) if name else ("none was refitted", 0.0, 0.0)


def page(records: Sequence[Record], command: str) -> str:
    rows, lines = [], []
    for kind in KINDS:
        own = [r for r in records if r["kind"] == kind]
        if own:
            surest = np.array([most(r)[1:] for r in own])
            figures = [f"{f(surest[:, i]):.2f}" for i in (0, 1) for f in (np.median, _usual)]
            rows.append([kind, len(own), *figures, CRITERIA[kind].null_drop])
        for r in own:
            name, drop, least = most(r)
            lines.append([r["case"], f"{r['above']:.2f}", name, f"{drop:.2f}", f"{least:.2f}"])
    head = ["pairs", "cameras", "drop, median", "95 %", "its low end, median", "95 %", "must be above"]
    return PAGE.format(
        command=command,
        unit=f"{max(c.least_unit for c in CRITERIA.values()):g}",
        summary=table(head, rows),
        cases=table(["camera", "gap above its floor", "effect", "drop", "its low end"], lines),
    )


def _usual(values: np.ndarray) -> float:
    return float(np.percentile(values, 95))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--bodies", nargs="+", choices=sorted(BODIES), required=True)
    parser.add_argument("--limit", type=int, help="cameras of each kind")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    out: Path = arguments.out
    found: dict[str, Record] = json.loads(out.read_text()) if out.exists() else {}
    for kind in arguments.kind:
        for case in shuffled(list(cases(kind, "nulls", arguments.bodies, (1,))))[: arguments.limit]:
            if case.name not in found:
                found[case.name] = looked_at(case)
                write_text(out, json.dumps(found, indent=1) + "\n")
                name, drop, low = most(found[case.name])
                print(f"{case.name}: {name} {drop:.2f}, {low:.2f}", flush=True)
    write_text(out.with_suffix(".md"), page(list(found.values()), " ".join(sys.argv[1:])))


if __name__ == "__main__":
    main()
