"""Diagnose cases whose effects are known, and keep the signs of every refitted effect.

    python -m experiments.score.cases run -o CASES --limit 100        # cameras of the withheld study
    python -m experiments.score.cases collect CASES... -o docs/results/score-cases.json

CASES holds a file a case; a run that was broken off goes on where it stopped. `collect` also reads what
`experiments.third_party run` writes: these cases are left out of a fit by converter. Of the truth of a
record, "a|b" stands for either effect.
"""

import argparse
import json
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.withheld.bodies import BODIES
from experiments.withheld.effects import ABSORBABLE, KINDS, NULLS, OUTSIDE, PAIRS, VOCABULARY, shows_in
from experiments.withheld.scenes import SETS
from experiments.withheld.shoot import write
from jaxisp.io.files import write_text
from jaxisp.process.cache import keep_compiled

Record = dict[str, Any]
GROUPS = {"single": 3.0, "beside": 4.0, "null": 1.3, "outside": 3.0, "pair": 1.0, "deleted": 1.5}
"""How many cases of each group there are, relative to each other: one effect; one beside an out-of-library
effect; a harmless mismatch; an out-of-library effect; two effects; one that is left out of those tried."""
_SIZE = {"raw+jpeg": 96, "clean+noisy": 128}
_COUNT = 4  # scenes: many small cases tell more than few large ones


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
    """Diagnose a case that `out` does not hold yet."""
    from jaxisp.gap import diagnose

    path = out / (row["name"].replace(" ", "_") + ".json")
    if path.exists():
        return
    with tempfile.TemporaryDirectory() as folder:
        where, kind = Path(folder), row["kind"]
        write(where, row["camera"], dict(row["effects"]), kind, row["scenes"], _SIZE[kind], count=_COUNT)
        try:
            record = kept(row, diagnose(where, exclude=row["exclude"]).report)
        except Exception as error:
            record = row | {"failed": repr(error)}
    write_text(path, json.dumps(record) + "\n")
    print(row["name"], record.get("failed") or (record["verdict"], record["causes"]), flush=True)


def collected(folders: Sequence[Path]) -> list[Record]:
    """The records of all cases; those that failed are left out and printed."""
    read = [json.loads(path.read_text()) for folder in folders for path in sorted(folder.glob("*.json"))]
    records = [record if "name" in record else of_third_party(record) for record in read]
    for record in records:
        if "failed" in record:
            print(f"failed: {record['name']}: {record['failed']}")
    return [record for record in records if "failed" not in record]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("run", "collect"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--limit", type=int, help="cases of each kind")
    parser.add_argument("-o", "--out", type=Path, required=True)
    asked = parser.parse_args()
    if asked.what == "collect":
        lines = ",\n".join(json.dumps(record) for record in collected(asked.paths))
        write_text(asked.out, f'{{"schema": 1, "cases": [\n{lines}\n]}}\n')
        return
    keep_compiled()
    asked.out.mkdir(parents=True, exist_ok=True)
    for kind in asked.kind:
        for row in planned(kind)[: asked.limit]:
            examined(row, asked.out)


if __name__ == "__main__":
    main()
