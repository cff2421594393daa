"""What must be reached, beside what was: results of `study`, whatever files they are in, as one table.

    python -m experiments.withheld_targets docs/results/withheld-1[4-9]-*.json -o docs/results/targets.md

A case in more than one file counts as the last has it. `--axes` names results of `study --untried`: where
the gaps of their cases lie is taken from there.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from experiments.withheld.effects import ABSORBABLE, KINDS
from experiments.withheld.tables import (
    axis_right,
    both_found,
    collected,
    first_right,
    group_right,
    named,
    plain_to_see,
    share,
    table,
    taken_up,
    three_right,
    truth,
    with_each,
)
from jaxisp.gap import EFFECTS

Record = dict[str, Any]
SPLITS = ("sealed", "develop")
LATEST = ("elm", "fig")
"""The bodies that came last."""
TITLES = {kind: kind.replace("raw+jpeg", "RAW+JPEG") for kind in KINDS}
HEAD = """# What must be reached

Cameras that share no code with the package, whose effect the diagnosis is not told. Of single effects and of
strangers those count whose gap is at least twice the floor; effects that a fitted base takes up are counted
apart. In brackets Wilson's 95 % interval, and after each figure how many cases it is of.

```sh
python -m experiments.withheld_targets {files}{axes} -o {page}
```
{located}
"""
LOCATED = """
Axes are those of the gap that the base leaves, whatever is tried then: of RAW+JPEG pairs they were
taken again by the version that stands, nothing being tried.

```sh
{0}
```
"""
BODY = """{0}
## The bodies that came last alone

{1}: by the version that stands, or by ones that differ from it in the axes of RAW+JPEG pairs and in how
causes are measured that were found in another order.

{2}
## By effect

Cases whose gap is at least twice the floor; those among them where the effect is named first; and those where
one of the axes that the package says it shows on is among the three that have most of the gap.

{3}
## What was run

{4}"""


def middle(values: Sequence[float]) -> str:
    return f"{median(values):.2f} ({len(values)})" if values else "– (0)"


def singles(records: Sequence[Record]) -> dict[str, str]:
    """Of single effects in the vocabulary."""
    sure = [r for r in records if truth(r)[0] not in ABSORBABLE and plain_to_see(r)]
    right = [r for r in sure if first_right(r) and (r.get("true_closure") or 0) > 0.1]
    closed = {id(r): r["closed"][truth(r)[0]] for r in right}
    refit = [abs(closed[id(r)] - r["true_closure"]) for r in right]
    told = [(r["predicted"].get(truth(r)[0]), r["true_closure"]) for r in right]
    screen = [abs(p - true) for p, true in told if p is not None]

    def inside(r: Record) -> bool:
        low, high = r["ci"][truth(r)[0]]
        return bool(low <= r["true_closure"] <= high)

    return {
        "right effect first": share(sure, first_right),
        "with what it cannot be told from": share(sure, group_right),
        "among the first three": share(sure, three_right),
        "closed, of what the effect made, median": middle([closed[id(r)] / r["true_closure"] for r in right]),
        "how far off the refit is, median": middle(refit),
        "how far off screening is, median": middle(screen),
        "what the effect made is in the 90 % interval": share(right, inside),
        "what a base takes up: absorbed or \"none\"": share(
            [r for r in records if truth(r)[0] in ABSORBABLE], taken_up
        ),
    }  # fmt: skip


def others(by: Mapping[str, Sequence[Record]]) -> dict[str, str]:
    """Of strangers, nulls and pairs."""
    strange = [r for r in by["outside"] if plain_to_see(r)]
    pairs = [r for r in by["pairs"] if plain_to_see(r) and all(r["each"])]
    return {
        "outside the vocabulary: \"unknown\"": share(strange, lambda r: r["verdict"] == "unknown"),
        "outside the vocabulary: right axis in the first three": share(strange, axis_right),
        "named where nothing is missing": share(by["nulls"], lambda r: bool(named(r))),
        "named or \"unknown\" where nothing is missing": share(by["nulls"], lambda r: r["verdict"] != "none"),
        "two effects, either alone twice the floor: both found": share(pairs, both_found),
    }  # fmt: skip


MUST = {
    "right effect first": "80 %",
    "with what it cannot be told from": "90 %",
    "among the first three": "95 %",
    "closed, of what the effect made, median": "0.7",
    "how far off the refit is, median": "0.07",
    "how far off screening is, median": "0.15",
    "what the effect made is in the 90 % interval": "80 %",
    "what a base takes up: absorbed or \"none\"": "",
    "outside the vocabulary: \"unknown\"": "85 %",
    "outside the vocabulary: right axis in the first three": "75 %",
    "named where nothing is missing": "at most 5 % of 100",
    "named or \"unknown\" where nothing is missing": "",
    "two effects, either alone twice the floor: both found": "65 %",
}  # fmt: skip


def by_effect(records: Sequence[Record]) -> str:
    """The table of effects, each by the cases whose gap is at least twice the floor."""
    rows: dict[tuple[str, str], dict[str, list[Record]]] = {}
    for r in records:
        if r["split"] in SPLITS and plain_to_see(r) and len(r["effects"]) == 1:
            rows.setdefault((r["split"], truth(r)[0]), {kind: [] for kind in KINDS})[r["kind"]].append(r)

    def cells(own: Sequence[Record]) -> tuple[object, ...]:
        seen = sum(bool({*r["where"]} & {*EFFECTS[truth(r)[0]].axes}) for r in own)
        return len(own), sum(map(first_right, own)), seen

    lines = []
    for (split, name), by in sorted(rows.items(), key=lambda row: (SPLITS.index(row[0][0]), row[0][1])):
        lines.append([name, split, *(cell for kind in KINDS for cell in cells(by[kind]))])
    sums = [sum(line[i] for line in lines) for i in range(2, 2 + 3 * len(KINDS))]
    columns = [f"{TITLES[kind]}: {what}"
               for kind in KINDS for what in ("cases", "first", "axis")]  # fmt: skip
    return table(["effect", "split", *columns], [*lines, ["**all**", "", *sums]])


def targets(records: Sequence[Record]) -> str:
    """The table: a row a quantity, with a column for the effects of each kind that were sealed and that were
    developed on; what has no such difference stands in the first of the two."""
    columns: list[dict[str, str]] = []
    for kind in KINDS:
        mine = with_each([r for r in records if r["kind"] == kind and "failed" not in r])
        by = {
            split: [r for r in mine if r["split"] == split]
            for split in (*SPLITS, "outside", "nulls", "pairs")
        }
        columns += [singles(by["sealed"]) | others(by), singles(by["develop"])]
    head = [
        "",
        *(f"{TITLES[kind]}, {split}" for kind in KINDS for split in SPLITS),
        "must",
    ]
    return table(head, [[name, *(c.get(name, "") for c in columns), must] for name, must in MUST.items()])


def by_body(records: Sequence[Record]) -> str:
    """Which bodies were run, and how many cases of each."""
    counts = Counter((r["kind"], r["split"], r["body"]) for r in records)
    rows = {}
    for (kind, split, body), count in sorted(counts.items()):
        rows.setdefault((kind, split), []).append(f"{body} {count}")
    return table(["kind", "split", "cases"], [[*key, ", ".join(found)] for key, found in rows.items()])


def located(records: Sequence[Record], again: Sequence[Record]) -> list[Record]:
    """The records with the axes that their cases have in others, where they are among those."""
    where = {r["case"]: r["where"] for r in again if "failed" not in r}
    return [r | {"where": where[r["case"]]} if r["case"] in where else r for r in records]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--axes", type=Path, nargs="+", default=[], help="results of `study --untried`")
    arguments = parser.parse_args()
    records, _ = collected(arguments.results)
    again, commands = collected(arguments.axes)
    records = located(records, again)
    head = HEAD.format(
        files=" ".join(map(str, arguments.results)),
        axes=" --axes " * bool(again) + " ".join(map(str, arguments.axes)),
        page=arguments.out,
        located=LOCATED.format("\n".join(f"python -m experiments.withheld.study {c}" for c in commands))
        if again
        else "",
    )
    latest = [r for r in records if r["body"] in LATEST]
    run = [r for r in records if "failed" not in r]
    tables = targets(records), " and ".join(LATEST), targets(latest), by_effect(run), by_body(records)
    arguments.out.write_text(head + BODY.format(*tables))


if __name__ == "__main__":
    main()
