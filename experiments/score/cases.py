"""Diagnose cases whose effects are known, and keep the signs of every refitted effect.

    python -m experiments.score.cases run -o CASES --limit 100        # cameras of the withheld study
    python -m experiments.score.cases again docs/results/score-cases.json MADE DATA/third_party -o CASES
    python -m experiments.score.cases collect FILE.json CASES... -o docs/results/score-cases.json

CASES holds a file a case; a run that was broken off goes on where it stopped. `again` diagnoses the cases of
a file by this version, those of converters from folders that hold them (`experiments.third_party make`), and
their plain pictures beside them. Its order mixes the groups, so that a part of it is a sample of all.
`collect` reads files of cases, what `run` and `again` write and what `experiments.third_party run` writes; of
cases of one name the last counts. A converter is left out of a fit as one camera. Of the truth of a record,
"a|b" stands for either effect. `version` is the commit that diagnosed a case; cc54f21, 67a5efa and 51b88aa
are those that collected cases of their days.
"""

import argparse
import json
import subprocess
import tempfile
import time
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from experiments.third_party.cases import sample
from experiments.third_party.chance import DEVELOP, order
from experiments.withheld.bodies import BODIES
from experiments.withheld.effects import (
    ABSORBABLE,
    KINDS,
    NULLS,
    OUTSIDE,
    PAIRED,
    PAIRS,
    VOCABULARY,
    shows_in,
)
from experiments.withheld.scenes import SETS
from experiments.withheld.shoot import write
from jaxisp.io.files import write_text
from jaxisp.process.cache import keep_compiled
from jaxisp.process.environment import one_blas_thread

Record = dict[str, Any]
GROUPS = {"single": 3.0, "beside": 4.0, "null": 1.3, "outside": 3.0, "pair": 1.0, "deleted": 1.5}
"""How many cases of each group there are, relative to each other: one effect; one beside an out-of-library
effect; a harmless mismatch; an out-of-library effect; two effects; one that is left out of those tried."""
_SIZE = {"raw+jpeg": 96, "clean+noisy": 128}
_COUNT = 4  # scenes: many small cases tell more than few large ones
_CASES = 6  # of one process
_ASKED = ("name", "group", "camera", "kind", "truth", "also", "beyond", "effects")
_RULES = ("rules", "rules_verdict")


def planned(kind: str, rounds: int = 4, seed: int = 54) -> list[Record]:
    """Cases of one kind of pairs in a fixed order that mixes the groups; cameras and scenes are drawn."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    shown = [n for n in sorted(VOCABULARY) if shows_in(n, kind) and n not in ABSORBABLE]
    outside = [n for n in sorted(OUTSIDE) if shows_in(n, kind)]
    nulls = [n for n in sorted(NULLS) if shows_in(n, kind)]
    pairs = [pair for pair in PAIRS if all(shows_in(n, kind) for n in pair)]
    found: dict[str, list[Record]] = {group: [] for group in GROUPS}

    def add(group: str, effects: Sequence[tuple[str, int]], exclude: Sequence[str] = ()) -> None:
        body, scenes = (names[rng.integers(len(names))] for names in (sorted(BODIES), SETS))
        what = "+".join(f"{n}={level}" for n, level in effects) + (f" less {exclude[0]}" if exclude else "")
        name = f"{kind} {group} {scenes} {body} {what}"
        row = {"name": name, "kind": kind, "group": group, "camera": body, "scenes": scenes}
        truth = [n for n, _ in effects if n in VOCABULARY and n not in exclude]
        beyond = bool(exclude) or any(n in OUTSIDE for n, _ in effects)
        row |= {"effects": [[n, int(level)] for n, level in effects], "exclude": list(exclude)}
        found[group].append(row | {"truth": truth, "beyond": beyond})

    for _ in range(rounds):
        for name in shown:
            other = outside[rng.integers(len(outside))]
            add("single", [(name, rng.integers(2, 6))])
            add("beside", [(name, rng.integers(3, 6)), (other, rng.integers(2, 5))])
            add("deleted", [(name, rng.integers(3, 6))], [name])
        for name in outside:
            add("outside", [(name, rng.integers(3, 6))])
        for name in nulls:
            add("null", [(name, 1)])
        for pair in pairs:
            add("pair", [(name, rng.integers(3, 5)) for name in pair])
    placed = []
    for group, own in found.items():
        own.sort(key=lambda row: zlib.crc32(row["name"].encode()))
        placed += [((i + 0.5) / GROUPS[group], row) for i, row in enumerate(own)]
    return [row for _, row in sorted(placed, key=lambda pair: pair[0])]


def of_third_party(record: Record) -> Record:
    """A record of `experiments.third_party.run` as one of these; all have what no effect describes."""
    said = record["truth"]
    also = [name for name in said["also"] if name != "none"]
    effect = said["truth"] not in ("none", "outside the library")
    row = {"name": said["case"], "group": "third party", "camera": said["converter"], "beyond": True}
    row |= {"truth": ["|".join([said["truth"], *also])] if effect else [], "also": [] if effect else also}
    if "failed" in record:
        return row | {"failed": record["failed"]}
    return kept(row, record["report"] | {"seconds": record["seconds"]})


def kept(row: Mapping[str, Any], report: Mapping[str, Any]) -> Record:
    """What the score is fitted to: the signs of the refitted effects, and the gap."""
    ranking = [r for r in report["ranking"] if "signs" in r]
    return dict(row) | {
        "kind": report["kind"],
        "gap": {name: report["gap"][name] for name in ("before", "after", "floor")},
        "signs": {r["effect"]: r["signs"] for r in ranking},
        "closed": {r["effect"]: r["closed"] for r in ranking},
        "found": [r["effect"] for r in ranking if r["searched"]],
        "causes": [c["effect"] for c in report["causes"]],
        "verdict": report["verdict"],
        "seconds": report["seconds"],
    }


def examined(row: Record, out: Path) -> None:
    """Diagnose a case that `out` does not hold yet; one of a converter lies in `row["folder"]`."""
    from jaxisp.gap import diagnose

    path = _place(row, out)
    if path.exists():
        return
    folder, row = row.get("folder"), {k: v for k, v in row.items() if k != "folder"}
    row |= {"version": version()}
    began = time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        where, kind = Path(folder or scratch), row["kind"]
        try:
            if folder is None:
                effects = dict(row["effects"])
                write(where, row["camera"], effects, kind, row["scenes"], _SIZE[kind], count=_COUNT)
            record = kept(row, diagnose(where, exclude=row.get("exclude", [])).report)
        except Exception as error:
            record = row | {"failed": repr(error)}
    write_text(path, json.dumps(record) + "\n")
    said = record.get("failed") or (record["verdict"], record["causes"])
    print(row["name"], said, f"{time.process_time() - began:.0f} s of CPU", flush=True)


def _place(row: Record, out: Path) -> Path:
    return out / (row["name"].replace(" ", "_") + ".json")


def version() -> str:
    """The commit of this checkout."""
    here = Path(__file__).parent
    found = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True)
    return found.stdout.strip()


def again(records: Sequence[Record], folders: Sequence[Path]) -> list[Record]:
    """The cases of a file and plain pictures beside them, to be diagnosed once more.

    Args:
        records: cases as they were kept.
        folders: each holds folders of cases of converters.

    Returns:
        rows for `examined`, in an order that mixes the groups evenly. Plain pictures are those of the sample
        of the half for development, so far as the folders hold them.

    Raises:
        FileNotFoundError: no folder holds a converter's case.
    """
    known = {path.name: path for folder in folders for path in sorted(folder.iterdir()) if path.is_dir()}
    rows, missing = [], []
    for record in records:
        row = {name: record[name] for name in _ASKED if name in record}
        if row["group"] == "third party":
            row["folder"] = known.get(record["name"])
            missing += [] if row["folder"] else [record["name"]]
        else:
            words, less = record["name"].split(), record["name"].partition(" less ")[2]
            row |= {"scenes": next(word for word in words if word in SETS), "exclude": less.split()[:1]}
        rows.append(row)
    if missing:
        raise FileNotFoundError(f"no folder holds {', '.join(missing)}")
    there = {row["name"] for row in rows}
    for case in sample(DEVELOP):
        if not case.level and case.name not in there and case.name in known:
            row = {"name": case.name, "group": "third party", "camera": case.converter, "kind": PAIRED}
            rows.append(row | {"truth": [], "also": [], "beyond": True, "folder": known[case.name]})
    groups: dict[tuple[object, ...], list[Record]] = {}
    for row in sorted(rows, key=lambda row: order(row["name"])):
        made = "-" in row["name"] if row["group"] == "third party" else row["kind"]
        groups.setdefault((row["group"], bool(row["truth"]), made), []).append(row)
    placed = [((i + 0.5) / len(own), row) for own in groups.values() for i, row in enumerate(own)]
    return [row for _, row in sorted(placed, key=lambda pair: pair[0])]


def ran(rows: Sequence[Record], out: Path, workers: int) -> None:
    """Diagnose cases side by side; compiled programs come to gigabytes, so that processes are short-lived."""
    one_blas_thread()
    keep_compiled()
    todo = [row for row in rows if not _place(row, out).exists()]
    at_once = _CASES * workers
    for first in range(0, len(todo), at_once):  # a pool that replaces its own can wait forever (gh-115634)
        with ProcessPoolExecutor(workers, get_context("spawn"), keep_compiled) as pool:
            for done in [pool.submit(examined, row, out) for row in todo[first : first + at_once]]:
                done.result()


def collected(paths: Sequence[Path]) -> list[Record]:
    """The last record of every case, of files of cases and of folders; those that failed are left out and
    printed. What the rules before the score said of a case is kept."""
    found: dict[str, Record] = {}
    for path in paths:
        read = [json.loads(own.read_text()) for own in sorted(path.glob("*.json"))]
        for record in read or json.loads(path.read_text())["cases"]:
            record = record if "name" in record else of_third_party(record)
            if "failed" in record:
                print(f"failed: {record['name']}: {record['failed']}")
                continue
            before = found.get(record["name"], {})
            found[record["name"]] = {k: before[k] for k in _RULES if k in before} | record
    return [found[name] for name in sorted(found)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("run", "again", "collect"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--limit", type=int, help="cases of each kind")
    parser.add_argument("--workers", type=int, default=1, help="cases that are diagnosed side by side")
    parser.add_argument("-o", "--out", type=Path, required=True)
    asked = parser.parse_args()
    if asked.what == "collect":
        lines = ",\n".join(json.dumps(record) for record in collected(asked.paths))
        write_text(asked.out, f'{{"schema": 1, "cases": [\n{lines}\n]}}\n')
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.what == "again":
        rows = again(json.loads(asked.paths[0].read_text())["cases"], asked.paths[1:])
    else:
        rows = [row for kind in asked.kind for row in planned(kind)[: asked.limit]]
    ran(rows, asked.out, asked.workers)


if __name__ == "__main__":
    main()
