"""Diagnose every case of a folder, one process at a time; an interrupted run goes on where it stopped."""

import json
import re
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from jaxisp.io.files import atomic_write
from jaxisp.process.environment import one_blas_thread

from .cases import sample
from .chance import HALVES

_CASES = 6
"""Of one process: its compiled programs come to gigabytes."""
HOW = PAIRS, REFERENCE, PICTURES = ("pairs", "reference", "pictures")
"""RAW+JPEG pairs alone; with the camera's plain profile as reference; the plain picture and the case's."""
Record = dict[str, Any]


def run(
    folder: Path,
    out: Path,
    match: str = "",
    how: str = PAIRS,
    limit: int | None = None,
    sampled: bool = False,
) -> list[Record]:
    """Diagnose the cases whose name matches; returns all records of `out`.

    Args:
        folder: of cases, as `make` writes them.
        out: gets a JSON file a case: its truth and its report.
        match: a regular expression.
        how: one of `HOW`.
        limit: the most cases that are diagnosed now.
        sampled: only those of `cases.sample`, in its order.
    """
    out.mkdir(parents=True, exist_ok=True)
    found = [path.parent for path in sorted(folder.glob("*/truth.json"), key=_order)]
    if sampled:
        halves = {json.loads((case / "truth.json").read_text())["half"] for case in found}
        chosen = [case.name for half in HALVES if half in halves for case in sample(half)]
        found = sorted((c for c in found if c.name in chosen), key=lambda case: chosen.index(case.name))
    todo = [case for case in found if re.search(match, case.name) and possible(case, how)]
    todo = [case for case in todo if not (out / f"{case.name}.json").exists()][:limit]
    one_blas_thread()
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=_CASES) as pool:
        for case in todo:
            record = pool.submit(diagnosed, case, how).result()
            with atomic_write(out / f"{case.name}.json") as file:
                file.write((json.dumps(record) + "\n").encode())
            print(case.name, "->", told(record), flush=True)
    return records(out)


def _order(truth: Path) -> tuple[int, str]:
    """Plain profiles first, then as they were made: the middle strengths."""
    about = json.loads(truth.read_text())
    return (0 if not about["level"] else 1 + (3, 5, 1, 4, 2).index(about["level"]), about["case"])


def possible(case: Path, how: str) -> bool:
    """Whether a case can be diagnosed like that: a plain profile is no case beside itself, and two pictures
    have to be JPEG files."""
    level = json.loads((case / "truth.json").read_text())["level"]
    return how == PAIRS or (level > 0 and (how != PICTURES or any(case.glob("*.jpg"))))


def two_pictures(case: Path, plain: Path, folder: Path) -> None:
    """Lay a case out as JPEG+JPEG pairs: the switch off, and on."""
    for picture in sorted(case.glob("*.jpg")):
        for letter, own in (("a", plain), ("b", case)):
            (folder / f"{picture.stem}.{letter}.jpg").write_bytes((own / picture.name).read_bytes())


def diagnosed(case: Path, how: str = PAIRS) -> Record:
    """The truth of a case, and its report or the error that it ended with."""
    from jaxisp.gap import diagnose
    from jaxisp.gap.report.page import plain

    truth = json.loads((case / "truth.json").read_text())
    off = case.parent / truth["plain"]
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            if how == PICTURES:
                two_pictures(case, off, Path(scratch))
                report = plain(diagnose(scratch).report)
            else:
                report = plain(diagnose(case, reference=off if how == REFERENCE else None).report)
        except Exception as error:  # an error is a result: it is counted
            places = traceback.extract_tb(error.__traceback__, limit=-4)
            trace = [f"{Path(own.filename).name}:{own.lineno} {own.name}" for own in places]
            return {"truth": truth, "how": how, "failed": repr(error), "trace": trace}
    report["gap"].pop("statistics", None)
    return {"truth": truth, "how": how, "report": report, "seconds": round(time.perf_counter() - began, 1)}


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
