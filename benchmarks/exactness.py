"""Compare every stage with its reference and write the table of exactness.

    make bench
    python -m benchmarks.exactness jpeg metrics      # some families, printed only

Exit status 1 if a row misses its bound. The tests hold the same bounds on fewer cases.
"""

import argparse
import importlib
import json
import math
import sys
import traceback
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.exact.row import Row
from benchmarks.machine import machine
from benchmarks.report import write_exactness

FAMILIES = ("jpeg", "demosaic", "denoise", "colour", "noise", "metrics")
RESULTS = Path("benchmarks/results/exactness.json")
PAGE = Path("docs/results/exactness.md")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("families", nargs="*", choices=[[], *FAMILIES], help="default: all, which is written")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    arguments = parser.parse_args()
    rows = [row for family in arguments.families or FAMILIES for row in run(family)]
    if not arguments.families:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        results = {"machine": machine(), "rows": [as_json(row) for row in rows]}
        arguments.out.write_text(json.dumps(results, indent=1) + "\n")
        write_exactness(arguments.report, arguments.out)
    failed = [row for row in rows if not row.passed]
    print(f"{len(rows) - len(failed)} of {len(rows)} rows pass")
    sys.exit(bool(failed))


def run(family: str) -> list[Row]:
    console, rows = Console(width=150, highlight=False, markup=False), []
    for row in attempted(family):
        word = "pass" if row.passed else "FAIL"
        bound = f"{'at least' if row.at_least else 'at most'} {row.must:.3g}"
        console.print(f"{word} {row.stage}: {row.worst:.3g} {row.unit} ({bound}) [{row.ran}]")
        rows.append(row)
    return rows


def attempted(family: str) -> Iterator[Row]:
    """Its rows; one that fails where they break off."""
    try:
        yield from importlib.import_module(f"benchmarks.exact.{family}").rows()
    except Exception as error:
        traceback.print_exc()
        yield Row(family, "", f"broke off: {type(error).__name__}: {error}", math.nan, 0)


def as_json(row: Row) -> dict[str, Any]:
    return asdict(row) | {"passed": row.passed}


if __name__ == "__main__":
    main()
