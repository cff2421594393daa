"""The evaluation of the diagnosis: results of studies in one file, and the tables that show them.

    python -m experiments.evaluation             # the tables of docs/diagnosis-evaluation.md
    python -m experiments.evaluation collect GROUP=FILE ... --axes FILE ... -o docs/results/diagnosis.json

`collect` takes files that `experiments.withheld.study` wrote and keeps of each case what the tables need. A
case in more than one file of a group counts as the last has it; so does one in both `nulls` and `main`. The
files of `experiments.fresh_scenes` and `experiments.null_drops` are kept as they are.
"""

import argparse
import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from experiments import real_gap_tables
from experiments.null_bank import left_out
from experiments.third_party import tables as switches
from experiments.withheld.effects import ABSORBABLE, KINDS
from experiments.withheld.libraw import SWITCHES
from experiments.withheld.study import written
from experiments.withheld.tables import (
    axis_right,
    both_found,
    by_gap_rows,
    collected,
    deleted_rates,
    first_right,
    gap_of,
    group_right,
    named,
    plain_to_see,
    share,
    table,
    taken_up,
    three_right,
    truth,
    why,
    wilson,
    with_each,
)
from jaxisp.gap import EFFECTS

Record = dict[str, Any]
RESULTS = Path("docs/results")
PAGE = Path("docs/diagnosis-evaluation.md")
GROUPS = ("nulls", "main", "frames", "grey", "stripped", "libraw")
"""Nulls and frames make the null bank; main is all else but three variants of the pictures."""
BESIDE = ("fresh", "drops")
"""What other experiments found, one file each."""
SPLITS = ("sealed", "develop")
LATEST = ("elm", "fig")
"""The bodies that came last."""
TITLES = {kind: kind.replace("raw+jpeg", "RAW+JPEG") for kind in KINDS}
_BLOCK = re.compile(r"(<!-- generated: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


# What is kept of a case


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


# The tables


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
        "right, or an alternative of it": share(sure, group_right),
        "right effect among the first three": share(sure, three_right),
        "closed over the true share, median": middle([closed[id(r)] / r["true_closure"] for r in right]),
        "error of the refitted share, median": middle(refit),
        "error of the screened share, median": middle(screen),
        "true share inside the 90 % interval": share(right, inside),
        "effects a base absorbs: absorbed or \"none\"": share(
            [r for r in records if truth(r)[0] in ABSORBABLE], taken_up
        ),
    }  # fmt: skip


def others(by: Mapping[str, Sequence[Record]]) -> dict[str, str]:
    """Of out-of-library effects, nulls and pairs of effects."""
    strange = [r for r in by["outside"] if plain_to_see(r)]
    pairs = [r for r in by["pairs"] if plain_to_see(r) and all(r["each"])]
    return {
        "out of the library: \"unknown\"": share(strange, lambda r: r["verdict"] == "unknown"),
        "out of the library: right axis among the first three": share(strange, axis_right),
        "nulls: an effect named": share(by["nulls"], lambda r: bool(named(r))),
        "nulls: an effect named, or \"unknown\"": share(by["nulls"], lambda r: r["verdict"] != "none"),
        "two effects, each alone twice the floor: both found": share(pairs, both_found),
    }  # fmt: skip


GOALS = {
    "right effect first": "80 %",
    "right, or an alternative of it": "90 %",
    "right effect among the first three": "95 %",
    "closed over the true share, median": "0.7",
    "error of the refitted share, median": "0.07",
    "error of the screened share, median": "0.15",
    "true share inside the 90 % interval": "80 %",
    "effects a base absorbs: absorbed or \"none\"": "",
    "out of the library: \"unknown\"": "85 %",
    "out of the library: right axis among the first three": "75 %",
    "nulls: an effect named": "at most 5 % of 100",
    "nulls: an effect named, or \"unknown\"": "",
    "two effects, each alone twice the floor: both found": "65 %",
}  # fmt: skip


def targets(records: Sequence[Record]) -> str:
    """A row a quantity, with a column for the effects of each kind that were sealed and that were developed
    on; what has no such difference stands in the first of the two."""
    columns: list[dict[str, str]] = []
    for kind in KINDS:
        mine = with_each([r for r in records if r["kind"] == kind and "failed" not in r])
        by = {
            split: [r for r in mine if r["split"] == split]
            for split in (*SPLITS, "outside", "nulls", "pairs")
        }
        columns += [singles(by["sealed"]) | others(by), singles(by["develop"])]
    head = ["", *(f"{TITLES[kind]}, {split}" for kind in KINDS for split in SPLITS), "goal"]
    return table(head, [[name, *(c.get(name, "") for c in columns), goal] for name, goal in GOALS.items()])


def by_effect(records: Sequence[Record]) -> str:
    """Each effect by the cases whose gap is at least twice the floor."""
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


def by_gap(records: Sequence[Record]) -> str:
    """What is named, by the size of the gap, of effects that no base absorbs."""
    own = [r for r in records if r["split"] in SPLITS and r["body"] in LATEST]
    own = [r for r in own if truth(r)[0] not in ABSORBABLE]
    rows = [
        [TITLES[kind], *row] for kind in KINDS for row in by_gap_rows([r for r in own if r["kind"] == kind])
    ]
    return table(["pairs", "gap, in floors", "right effect first", "another first", "unknown", "none"], rows)


def misses(records: Sequence[Record]) -> str:
    """Single effects and out-of-library effects plain to see that are not said rightly."""

    def wrong(r: Record) -> bool:
        if r["split"] == "outside":
            return bool(r["verdict"] != "unknown")
        return r["split"] in SPLITS and truth(r)[0] not in ABSORBABLE and not first_right(r)

    own = sorted((r for r in records if plain_to_see(r) and wrong(r)), key=lambda r: r["case"])
    split = {"outside": "out of the library"}
    rows = [[TITLES[r["kind"]], split.get(r["split"], r["split"]), r["body"], _effects(r),
             ", ".join(r["causes"]) or r["verdict"], gap_of(r), why(r)] for r in own]  # fmt: skip
    return table(["pairs", "split", "body", "truth", "named", "gap (floor)", "why"], rows)


def _effects(record: Record) -> str:
    return " and ".join(f"{name} {level}" for name, level in record["effects"])


def two_effects(records: Sequence[Record]) -> str:
    """Pairs of effects, each alone twice the floor, of which not both are found."""
    own = [r for r in with_each(records) if r["split"] == "pairs" and plain_to_see(r) and all(r["each"])]
    rows = [[TITLES[r["kind"]], r["body"], _effects(r), ", ".join(r["causes"]) or r["verdict"], gap_of(r)]
            for r in sorted(own, key=lambda r: r["case"]) if not both_found(r)]  # fmt: skip
    return table(["pairs", "body", "truth", "named", "gap (floor)"], rows)


def deleted(records: Sequence[Record]) -> str:
    """What is said where the true effect is left out of those tried."""
    rows = []
    for kind in KINDS:
        own = [r for r in records if r["split"] == "deleted" and r["kind"] == kind and plain_to_see(r)]
        rows += [[TITLES[kind], said, share(own, hit)] for said, hit in deleted_rates().items()]
    return table(["pairs", "said", "cases"], rows)


def frames(records: Sequence[Record]) -> str:
    rows = []
    for kind in KINDS:
        own = [r for r in records if r["kind"] == kind]
        said = Counter(r["verdict"] for r in own)
        rows.append([TITLES[kind], len(own), *(said[v] for v in ("none", "unknown", "effect"))])
    return table(["pairs", "nulls of two frames a scene", "none", "unknown", "effect"], rows)


def variant(records: Sequence[Record]) -> str:
    """Scenes without colours, or lost headers: the effect is the first of the truth."""
    tests: dict[str, Callable[[Record], bool]] = {
        "effect named": lambda r: truth(r)[0] in r["causes"],
        "effect, or an alternative, named": lambda r: any(
            truth(r)[0] in (cause, *r["alternatives"][cause]) for cause in r["causes"]
        ),
        "another effect named": lambda r: bool(set(named(r)) - set(truth(r))),
        "unknown": lambda r: r["verdict"] == "unknown",
        "none": lambda r: r["verdict"] == "none",
    }
    sure = [r for r in records if r["split"] != "nulls" and truth(r)[0] not in ABSORBABLE]
    seen = [r for r in sure if r["gap"]["before"] >= 1.2 * r["gap"]["floor"]]
    rows = [[said, share(sure, hit), share(seen, hit)] for said, hit in tests.items()]
    if nulls := [r for r in records if r["split"] == "nulls"]:
        rows.append(["nulls: an effect named", share(nulls, lambda r: bool(named(r))), ""])
        rows.append(['nulls: "unknown"', share(nulls, lambda r: r["verdict"] == "unknown"), ""])
    return table(["said", "all cases", "gap of 1.2 floors or more"], rows)


def libraw(records: Sequence[Record]) -> str:
    """LibRaw as the camera, a switch a row."""
    rows = []
    for r in sorted(records, key=lambda r: list(SWITCHES).index(truth(r)[0])):
        right = SWITCHES[truth(r)[0]].right
        if "failed" in r:
            rows.append([truth(r)[0], " or ".join(right), "LibRaw did not return", "", ""])
            continue
        first = r["causes"][0] if r["causes"] else r["verdict"]
        rows.append([truth(r)[0], " or ".join(right), first, "yes" if first in right else "no", gap_of(r)])
    return table(["switch", "right would be", "named first", "right", "gap (floor)"], rows)


def third_party(found: Sequence[Mapping[str, Any]]) -> str:
    rows = [[r["camera"], r["cases"], r["right"], r["first"], r["wrong"]] for r in found]
    return table(["camera", "cases", "named right", "truth ranked first", "another effect named"], rows)


def fresh(found: Mapping[str, Record]) -> str:
    """Whether intervals hold what a refit closes on scenes that were neither fitted nor held out."""
    rows = []
    for kind in KINDS:
        own = [r for r in found.values() if r["kind"] == kind]
        seen = [r for r in own if "fresh" in r]
        inside = sum(r["inside"] for r in seen)
        low, high = wilson(inside, len(seen))
        off = float(np.median([r["fresh"] - r["closed"] for r in seen]))
        rows.append([TITLES[kind], len(own), len(seen),
                     f"{inside}/{len(seen)} [{low:.0%}, {high:.0%}]", f"{off:+.2f}"])  # fmt: skip
    head = ["pairs", "cases", "named first", "share on fresh scenes inside the interval", "median difference"]
    return table(head, rows)


def drops(found: Mapping[str, Record]) -> str:
    """By how much an effect lowers the gap of a camera that lacks nothing, in floors."""
    rows = []
    for kind in KINDS:
        lows = [max((low for _, low in r["lowered"].values()), default=0.0)
                for r in found.values() if r["kind"] == kind]  # fmt: skip
        if lows:
            figures = (np.median(lows), np.percentile(lows, 95), np.max(lows))
            rows.append([TITLES[kind], len(lows), *(f"{value:.2f}" for value in figures)])
    head = ["pairs", "nulls", "lower end of the drop, median", "95 % of nulls below", "largest"]
    return table(head, rows)


def null_bank(records: Iterable[Record]) -> str:
    rows = []
    for kind in KINDS:
        by: dict[str, list[Mapping[str, float]]] = defaultdict(list)
        for r in records:
            if r["kind"] == kind:
                by[r["body"]].append(r["gap"]["axes"])
        beyond, count = left_out(by)
        rows.append([TITLES[kind], count, len(by), f"{beyond} ({beyond / count:.0%})"])
    return table(["pairs", "nulls", "bodies", "an axis beyond the bank of the other bodies"], rows)


def photographs(found: Mapping[str, Record]) -> str:
    """What is said of real photographs, in short; docs/results/real-gap.md has more."""
    rows = []
    for name, r in found.items():
        cells = dict(zip(real_gap_tables.HEAD, real_gap_tables.row(name, r)))
        rows.append([cells[column] for column in _SHORT])
    return table(_SHORT, rows)


_SHORT = ("pictures", "pairs", "gap before", "after", "floor", "causes, share closed", "on these axes, share",
          "denoisers (spread over seeds)")  # fmt: skip


def run(records: Sequence[Record]) -> str:
    """Which bodies were run, and how many cases of each."""
    counts = Counter((r["kind"], r["split"], r["body"]) for r in records)
    rows: dict[tuple[str, str], list[str]] = {}
    for (kind, split, body), count in sorted(counts.items()):
        rows.setdefault((kind, split), []).append(f"{body} {count}")
    return table(["pairs", "split", "cases"], [[*key, ", ".join(own)] for key, own in rows.items()])


def commands(found: Mapping[str, Any]) -> str:
    """What was run for each group of cases."""
    lines = ["```sh", 'study="python -m experiments.withheld.study --out RESULTS.json"']
    for group in GROUPS:
        lines += [f"# {group}", *(f"$study {command}" for command in found[group]["commands"])]
    return "\n".join([*lines, "```", ""])


def beside(found: Mapping[str, Any]) -> dict[str, str]:
    """Switches beside their camera's plain pictures: cases that the method was changed by, before and after,
    and others."""
    seen = [r for r in found["records"] if r["truth"]["case"] in found["seen"]]
    new = [r for r in found["records"] if r not in seen]
    return {
        "beside": switches.rates(new),
        "beside-by-case": switches.by_case(new),
        "beside-seen": switches.by_case(seen),
        "beside-before": switches.by_case(found["before"]),
    }


def left(names: Sequence[str]) -> str:
    """What of a sample did not run."""
    if not names:
        return "All cases of the sample ran.\n"
    return "Of the sample, these did not run:\n\n" + "".join(f"- {name}\n" for name in names)


def tables(results: Path = RESULTS) -> dict[str, str]:
    """Every generated part of the page, by name."""

    def read(name: str) -> Any:
        return json.loads((results / name).read_text())

    found, others = read("diagnosis.json"), read("third-party.json")
    main = cases_of(found, "nulls", "main")
    whole = [r for r in main if "failed" not in r]
    return {
        "targets": targets(main),
        "latest": targets([r for r in main if r["body"] in LATEST]),
        "by-gap": by_gap(whole),
        "by-effect": by_effect(whole),
        "misses": misses(whole),
        "two-effects": two_effects(whole),
        "deleted": deleted(whole),
        "frames": frames(cases_of(found, "frames")),
        "grey": variant(cases_of(found, "grey")),
        "stripped": variant(cases_of(found, "stripped")),
        "libraw": libraw(cases_of(found, "libraw")),
        "third-party": third_party(others["earlier"]),
        "switches": switches.rates(others["switches"]["records"]),
        "switches-by-case": switches.by_case(others["switches"]["records"]),
        "switches-left": left(others["switches"]["not run"]),
        **beside(others["beside"]),
        "fresh": fresh(found["fresh"]),
        "drops": drops(found["drops"]),
        "null-bank": null_bank([*cases_of(found, "nulls"), *cases_of(found, "frames")]),
        "real": photographs(read("real-gap.json")),
        "real-again": photographs(read("real-gap-again.json")),
        "run": run(main),
        "commands": commands(found),
    }


def rendered(page: str, parts: Mapping[str, str]) -> str:
    """The page with each block between `<!-- generated: NAME -->` and `<!-- end -->` made anew."""
    return _BLOCK.sub(lambda m: f"{m[1]}\n{parts[m[2]]}\n{m[3]}", page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command")
    collecting = commands.add_parser("collect", help="make docs/results/diagnosis.json")
    collecting.add_argument(
        "results", nargs="+", metavar="GROUP=FILE", help=f"a group of {', '.join((*GROUPS, *BESIDE))}"
    )
    collecting.add_argument("--axes", type=Path, nargs="*", default=[], help="results of `study --untried`")
    collecting.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    if arguments.command is None:
        PAGE.write_text(rendered(PAGE.read_text(), tables()))
        return
    files: dict[str, list[Path]] = defaultdict(list)
    for word in arguments.results:
        group, _, path = word.partition("=")
        if group not in (*GROUPS, *BESIDE):
            parser.error(f"{word}: must be GROUP=FILE, with a group of {', '.join((*GROUPS, *BESIDE))}")
        files[group].append(Path(path))
    collect(files, arguments.axes, arguments.out)


if __name__ == "__main__":
    main()
