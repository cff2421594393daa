"""Diagnose every case of a folder, one process at a time; an interrupted run goes on where it stopped."""

import json
import re
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from jaxisp.io.files import atomic_write

_CASES = 6
"""Of one process: its compiled programs come to gigabytes."""
Record = dict[str, Any]


def run(
    folder: Path, out: Path, match: str = "", *, reference: bool = False, limit: int | None = None
) -> list[Record]:
    """Diagnose the cases whose name matches; returns all records of `out`.

    Args:
        folder: of cases, as `make` writes them.
        out: gets a JSON file a case: its truth and its report.
        match: a regular expression.
        reference: whether each case has the same camera's plain profile as `reference`.
        limit: the most cases that are diagnosed now.
    """
    out.mkdir(parents=True, exist_ok=True)
    todo = [
        p.parent for p in sorted(folder.glob("*/truth.json"), key=_order) if re.search(match, p.parent.name)
    ]
    todo = [case for case in todo if not (out / f"{case.name}.json").exists()][:limit]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=_CASES) as pool:
        for case in todo:
            record = pool.submit(diagnosed, case, reference).result()
            with atomic_write(out / f"{case.name}.json") as file:
                file.write((json.dumps(record) + "\n").encode())
            print(case.name, "->", told(record), flush=True)
    return records(out)


def _order(truth: Path) -> tuple[int, str]:
    """Plain profiles first, then as they were made: the middle strengths."""
    about = json.loads(truth.read_text())
    return (0 if not about["level"] else 1 + (3, 5, 1, 4, 2).index(about["level"]), about["case"])


def diagnosed(case: Path, reference: bool) -> Record:
    """The truth of a case, and its report or the error that it ended with."""
    from jaxisp.gap import diagnose
    from jaxisp.gap.report.page import plain

    truth = json.loads((case / "truth.json").read_text())
    options: dict[str, Any] = {}
    if reference and truth["level"]:
        options["reference"] = case.parent / truth["plain"]
    began = time.perf_counter()
    try:
        report = plain(diagnose(case, **options).report)
    except Exception as error:  # an error is a result: it is counted
        places = traceback.extract_tb(error.__traceback__, limit=-4)
        trace = [f"{Path(own.filename).name}:{own.lineno} {own.name}" for own in places]
        return {"truth": truth, "failed": repr(error), "trace": trace}
    report["gap"].pop("statistics", None)
    return {"truth": truth, "report": report, "seconds": round(time.perf_counter() - began, 1)}


def records(out: Path) -> list[Record]:
    return [json.loads(path.read_text()) for path in sorted(out.glob("*.json"))]


def told(record: Record) -> str:
    """A line on what was said."""
    truth = record["truth"]["truth"]
    if "failed" in record:
        return f"{truth}: {record['failed']}"
    report = record["report"]
    gap, ranking = report["gap"], [r["effect"] for r in report["ranking"][:3]]
    causes = [f"{c['effect']} {c['closed']:.2f}" for c in report["causes"]]
    size = f"gap {gap['before']:.3g}, floor {gap['floor']:.3g}"
    return f"{truth}: {report['verdict']} {causes} (ranked {ranking}; {size}; {record['seconds']} s)"
