"""What the diagnosis says of real photographs, whose truth nobody knows.

    python -m experiments.real_gap DATA --downstream --out docs/results/real-gap.json

DATA holds iphone7/, iphone8/, polyu/ (two cameras in one folder) and sidd/. Figures are kept, no pictures. A
run that was broken off goes on; a set that is missing or fails stops no other, and is tried again.
"""

import argparse
import json
import multiprocessing
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.real_gap_tables import markdown
from experiments.withheld.study import kept
from jaxisp.errors import InputError, one_line
from jaxisp.gap import Downstream, diagnose
from jaxisp.gap.report.page import plain
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG
from jaxisp.io.files import atomic_write
from jaxisp.process.environment import one_blas_thread

Record = dict[str, Any]
_AXES = 3  # that are kept, those with most of the gap


@dataclass(frozen=True)
class Source:
    """Where a set's files lie in DATA: a folder, or those of one whose names have this first word."""

    folder: str
    word: str = ""
    kind: str = CLEAN_NOISY


SETS = {
    "iphone7": Source("iphone7", kind=RAW_JPEG),
    "iphone8": Source("iphone8"),
    "canon": Source("polyu", "Canon5D2"),
    "sony": Source("polyu", "SonyA7II"),
    "sidd": Source("sidd"),
}


def lay(data: Path, source: Source, folder: Path) -> Path:
    """A data set of links, so that a camera of several in one folder is diagnosed alone."""
    pattern = f"{source.word}_*" if source.word else "[!.]*"
    files = [path for path in sorted((data / source.folder).glob(pattern)) if path.is_file()]
    if not files:
        raise InputError(f"{source.folder}/{source.word}*: no such files in DATA")
    folder.mkdir()
    for path in files:
        (folder / path.name).symlink_to(path.resolve())
    if source.word:
        (folder / "dataset.toml").write_text('clean_encoding = "srgb"\n')
    return folder


def figures(report: Record) -> Record:
    """What is kept of a report, in numbers that JSON knows."""
    pairs = report["pairs"]
    found = kept(report) | {
        "kind": report["kind"],
        "pairs": {half: pairs[half] for half in ("fit", "held_out")},
        "axes": [{k: row[k] for k in ("axis", "share", "ci") if k in row} for row in report["where"][:_AXES]],
    }
    if "downstream" in report:
        found["downstream"] = report["downstream"]
    return dict(plain(found))


def examine(name: str, data: Path, downstream: bool) -> Record:
    """Diagnose one set; what goes wrong is a record too, since the other sets are to go on."""
    source, clock = SETS[name], time.perf_counter()
    how = Downstream() if downstream and source.kind == CLEAN_NOISY else None
    with tempfile.TemporaryDirectory() as temporary:
        try:
            report = diagnose(lay(data, source, Path(temporary) / name), downstream=how).report
            return figures(report) | {"seconds": round(time.perf_counter() - clock, 1)}
        except Exception as error:
            if not isinstance(error, InputError):
                traceback.print_exc()
            return {"failed": without_folders(f"{type(error).__name__}: {error}")}


def without_folders(text: str) -> str:
    """As one line, absolute paths cut to their last names: where things lie on a machine is nobody's."""
    return one_line(Exception(re.sub(r"(?<![\w.])/(?:[^\s/:'\"]+/)+", "", text)))


def in_own_process(call: Callable[..., Record], *arguments: Any) -> Record:
    """The call's result. Its memory, up to 10 GB, goes back with the process."""
    one_blas_thread()
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(call, *arguments).result()


def complete(record: Record | None, name: str, downstream: bool) -> bool:
    """Whether nothing of this set is left to do."""
    if record is None or "failed" in record:
        return False
    return not downstream or SETS[name].kind != CLEAN_NOISY or "downstream" in record


def run(
    data: Path,
    out: Path,
    names: Iterable[str] = tuple(SETS),
    downstream: bool = False,
    apart: Callable[..., Record] = in_own_process,
) -> list[str]:
    """Diagnose the sets that `out` does not hold yet, one at a time; the file is whole after each.

    Args:
        data: the folder of all sets.
        out: the results; the page is written beside it.
        names: the sets that are wanted.
        downstream: whether denoisers are trained on clean+noisy sets.
        apart: calls a function in a process of its own.

    Returns:
        the sets that failed.
    """
    found: dict[str, Record] = json.loads(out.read_text()) if out.exists() else {}
    out.parent.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in names:
        if complete(found.get(name), name, downstream):
            continue
        try:
            record = apart(examine, name, data, downstream)
        except BrokenProcessPool:
            record = {"failed": "its process was killed: too little memory?"}
        if "failed" in record:
            failed.append(name)
            print(f"{name}: failed: {record['failed']}", flush=True)
            record = found[name] if complete(found.get(name), name, False) else record
        else:
            print(f"{name}: {record['verdict']} {record['causes']} {record['seconds']} s", flush=True)
        found[name] = record
        with atomic_write(out) as file:
            ordered = {n: found[n] for n in SETS if n in found}
            file.write((json.dumps(ordered, indent=1, allow_nan=False) + "\n").encode())
    with atomic_write(out.with_suffix(".md")) as file:
        file.write(markdown({n: found[n] for n in SETS if n in found}).encode())
    return failed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=SETS, default=list(SETS), help="these sets")
    parser.add_argument("--downstream", action="store_true", help="train denoisers too")
    asked = parser.parse_args()
    sys.exit(bool(run(asked.data, asked.out, asked.only, asked.downstream)))


if __name__ == "__main__":
    main()
