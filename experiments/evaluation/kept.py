"""What is kept of the cases of a study, in one file."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.withheld.study import written
from experiments.withheld.tables import collected, truth

Record = dict[str, Any]
GROUPS = ("nulls", "main", "frames", "grey", "stripped", "libraw")
"""Nulls and frames make the null bank; main is all else but three variants of the pictures."""
BESIDE = ("fresh", "drops")
"""What other experiments found, one file each."""


def slim(record: Record, axes: bool = False) -> Record:
    """The parts of a record that the tables need; sizes of all axes where the null bank needs them."""
    kept = {key: record[key] for key in ("case", "kind", "split", "body", "effects", "scenes", "standing")}
    if "failed" in record:
        return kept | {"failed": record["failed"]}
    effects = truth(record)
    kept |= {key: record[key] for key in ("verdict", "causes", "seconds", "where") if key in record}
    if "ranking" in record:
        kept |= {"alternatives": record["alternatives"], "ranking": record["ranking"][:3]}
        kept |= {key: _rounded(record[key]) for key in ("closed", "ci")}
        kept["predicted"] = _rounded({n: v for n, v in record["predicted"].items() if n in effects})
        kept["absorbed"] = _rounded({n: v for n, v in record["absorbed"].items() if n in effects})
        said = record["status"]
        kept["status"] = {n: s for n, s in said.items() if n in effects or s == "not_identifiable"}
    gap = record["gap"]
    kept["gap"] = {"before": _rounded(gap["before"]), "floor": _rounded(gap["floor"])}
    if axes and "axes" in gap:
        kept["gap"]["axes"] = gap["axes"]
    if record.get("true_closure") is not None:
        kept["true_closure"] = _rounded(record["true_closure"])
    if near := record.get("unexplained", {}).get("nearest"):
        kept["unexplained"] = {"nearest": {k: _rounded(near[k]) for k in ("effects", "closed", "axes")}}
    return kept


def _rounded(value: Any) -> Any:
    """Six digits."""
    if isinstance(value, Mapping):
        return {name: _rounded(own) for name, own in value.items()}
    if isinstance(value, list):
        return [_rounded(own) for own in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def located(records: Sequence[Record], again: Sequence[Record]) -> list[Record]:
    """The records with the axes that their cases have in others, where they are among those."""
    where = {r["case"]: r["where"] for r in again if "failed" not in r}
    return [r | {"where": where[r["case"]]} if r["case"] in where else r for r in records]


def collect(files: Mapping[str, Sequence[Path]], axes: Sequence[Path], out: Path) -> None:
    """Write the file that the tables are made from."""
    again, located_by = collected(axes)
    parts = []
    for group in GROUPS:
        records, commands = collected(files.get(group, ()))
        if group == "main":
            records = located(records, again)
        cases = {r["case"]: slim(r, axes=group in ("nulls", "frames")) for r in records}
        commands = [*dict.fromkeys(commands), *(located_by if group == "main" else ())]
        parts.append(f'"{group}": {written(commands, cases).rstrip()}')
    for name in BESIDE:
        found = {
            case: own for path in files.get(name, ()) for case, own in json.loads(path.read_text()).items()
        }
        parts.append(f'"{name}": {json.dumps(found)}')
    out.write_text("{" + ",\n".join(parts) + "}\n")


def cases_of(found: Mapping[str, Any], *groups: str) -> list[Record]:
    merged: dict[str, Record] = {}
    for group in groups:
        merged |= found[group]["cases"]
    return list(merged.values())
