"""Turn what `study` found into Markdown.

    python -m experiments.withheld.tables RESULTS.json -o RESULTS.md

Several files may be given; a case in more than one of them counts as the last has it.
"""

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from math import inf
from pathlib import Path
from statistics import mean, median
from typing import Any

from scipy.stats import norm

from .effects import ABSORBABLE, GROUPS, LOST_HEADER
from .libraw import SWITCHES
from .outside import AXES as OUTSIDE_AXES

Record = dict[str, Any]


VERDICTS = ("unknown", "none", "effect")
GAPS = (1.0, 1.1, 1.25, 1.5, 2.0, 4.0, inf)
HEAD = """# Withheld effects{strengths}

Cameras that share no code with the package (`experiments/withheld`), whose effect the diagnosis is not
told.{note} One results file for all:

```sh
study="python -m experiments.withheld.study --out {results}"
{commands}
python -m experiments.withheld.tables {results} -o {page}
```

Skipped nulls set the thresholds. An interrupted command continues where it was.
"""


def wilson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a share."""
    if total == 0:
        return 0.0, 1.0
    z = float(norm.ppf(0.5 + level / 2))
    share, size = hits / total, 1 + z * z / total
    middle = (share + z * z / (2 * total)) / size
    half = z * (share * (1 - share) / total + z * z / (4 * total**2)) ** 0.5 / size
    return max(0.0, middle - half), min(1.0, middle + half)


def truth(record: Record) -> list[str]:
    return [name for name, _ in record["effects"]]


def named(record: Record) -> list[str]:
    """The causes in their order, without what this body lacks from the start (unless that is the effect)."""
    kept = set(truth(record))
    return [cause for cause in record["causes"] if cause in kept or cause not in record["standing"]]


def first_right(record: Record) -> bool:
    return named(record)[:1] == truth(record)


def group_right(record: Record) -> bool:
    """The true effect is first, or it and the first cause are alternatives, whichever of them says so."""
    true, first = truth(record)[0], (named(record) or [""])[0]
    others = record["alternatives"]
    return first != "" and (true in (first, *others[first]) or first in others.get(true, ()))


def three_right(record: Record) -> bool:
    return truth(record)[0] in record["ranking"][:3]


def both_found(record: Record) -> bool:
    return set(truth(record)) <= set(record["causes"])


def taken_up(record: Record) -> bool:
    """The baseline took the effect up, and the report says so or finds nothing missing."""
    name = truth(record)[0]
    said = record["status"].get(name) == "absorbed" or (record["absorbed"].get(name) or 0) > 0.5
    return not named(record) and (said or record["verdict"] == "none")


def plain_to_see(record: Record) -> bool:
    """The gap is at least twice the floor after the baseline took up its part."""
    return record["gap"]["before"] >= 2 * record["gap"]["floor"]


def share(records: Iterable[Record], hit: Callable[[Record], bool]) -> str:
    found = [hit(record) for record in records]
    if not found:
        return "– (0)"
    low, high = wilson(sum(found), len(found))
    return f"{mean(found):.0%} [{low:.0%}, {high:.0%}] ({sum(found)}/{len(found)})"


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


RATES: dict[str, Callable[[Record], bool]] = {
    "right effect first": first_right,
    "its group first": group_right,
    "in the first three": three_right,
    "verdict none": lambda r: r["verdict"] == "none",
    "verdict unknown": lambda r: r["verdict"] == "unknown",
}


def effects_section(records: list[Record]) -> str:
    """Rates over single effects: all, those plain to see, and those that a baseline may take up."""
    sure = [r for r in records if truth(r)[0] not in ABSORBABLE]
    seen = [r for r in sure if plain_to_see(r)]
    rows = [[name, share(sure, hit), share(seen, hit)] for name, hit in RATES.items()]
    parts = [table(["quantity", "all strengths", "gap at least twice the floor"], rows)]
    soft = [r for r in records if truth(r)[0] in ABSORBABLE]
    if soft:
        either = share(soft, lambda r: first_right(r) or taken_up(r))
        parts.append(f"Effects that a fitted baseline may take up: named, absorbed or none: {either}.\n")
    parts += [power(records), by_gap(sure), confusion(records), closures(records), missed(records)]
    return "\n".join(parts)


def power(records: list[Record]) -> str:
    """Right effect first, by effect and strength."""
    by: dict[str, dict[int, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for record in records:
        name, level = record["effects"][0]
        by[name][level].append(first_right(record))
        by["**all**"][level].append(first_right(record))
    levels = sorted({level for found in by.values() for level in found})
    rows = [
        [n, *(f"{sum(f[v])}/{len(f[v])}" if v in f else "" for v in levels)] for n, f in sorted(by.items())
    ]
    return "### Right effect first, by strength\n\n" + table(["effect", *map(str, levels)], rows)


def by_gap_rows(records: Sequence[Record]) -> list[list[object]]:
    """What is said of gaps of each size, of effects that no baseline takes up."""
    rows: list[list[object]] = []
    for low, high in pairwise(GAPS):
        those = [r for r in records if low <= r["gap"]["before"] / r["gap"]["floor"] < high]
        said = Counter("right" if first_right(r) else "wrong" if named(r) else r["verdict"] for r in those)
        size = f"{low} to {high}" if high < inf else f"{low} and more"
        others = [said[verdict] for verdict in ("unknown", "none")]
        rows.append([size, share(those, first_right), said["wrong"], *others])
    return rows


def by_gap(records: list[Record]) -> str:
    head = ["gap, in floors", "right effect first", "another first", "unknown", "none"]
    return "### Right effect first, by the size of the gap\n\n" + table(head, by_gap_rows(records))


def confusion(records: list[Record]) -> str:
    """What was named first for each true effect."""
    by: dict[str, Counter[str]] = defaultdict(Counter)
    for record in records:
        by[truth(record)[0]][(named(record) or [f"({record['verdict']})"])[0]] += 1
    rows = [
        [true, ", ".join(f"{n} {c}" for n, c in found.most_common())] for true, found in sorted(by.items())
    ]
    return "### Confusion matrix, by row\n\n" + table(["true effect", "named first, times"], rows)


def closures(records: list[Record]) -> str:
    """Named share closed over the share that the effect made, how far off the refit and screening were of
    that, and how often the interval holds it."""
    right = [r for r in records if first_right(r) and r.get("true_closure") is not None]
    if not right:
        return ""
    name = {id(r): truth(r)[0] for r in right}
    strong = [r for r in right if r["true_closure"] > 0.1]
    ratios = [r["closed"][name[id(r)]] / r["true_closure"] for r in strong]
    inside = [r["ci"][name[id(r)]][0] <= r["true_closure"] <= r["ci"][name[id(r)]][1] for r in right]
    middle = f"{median(ratios):.2f}" if ratios else "–"
    covered = f"reducible inside the interval: {mean(inside):.0%}"
    off = {"the refit": [r["closed"][name[id(r)]] - r["true_closure"] for r in right]}
    off["screening"] = [
        r["predicted"][name[id(r)]] - r["true_closure"]
        for r in right
        if name[id(r)] in r.get("predicted", ())
    ]
    errors = ", ".join(
        f"{median(map(abs, found)):.2f} by {what} ({len(found)})" for what, found in off.items() if found
    )
    told = f"off by, median: {errors}"
    return f"Closed over reducible, median: {middle} ({len(ratios)}); {told}; {covered}.\n"


def gap_of(record: Record) -> str:
    return f"{record['gap']['before']:.3g} ({record['gap']['floor']:.3g})"


def missed(records: list[Record]) -> str:
    """Every case that is not right, strongest first."""
    wrong = [r for r in records if not group_right(r) and plain_to_see(r)]
    wrong = sorted(wrong, key=lambda r: (-r["effects"][0][1], r["case"]))
    rows = [
        [r["case"], r["verdict"], ", ".join(r["causes"]), ", ".join(r["ranking"][:3]), gap_of(r), why(r)]
        for r in wrong
    ]
    head = ["case", "verdict", "causes", "ranking", "gap (floor)", "why"]
    return "### Missed, of those plain to see\n\n" + table(head, rows)


def why(record: Record) -> str:
    """What the diagnosis itself says of a verdict that is not right."""
    gap, near = record["gap"], record.get("unexplained", {}).get("nearest")
    if record["causes"]:
        first = record["causes"][0]
        return f"{first} closes {record['closed'][first]:.2f}"
    if record["verdict"] == "none":
        return "what is left counts as nothing"
    if near is None:
        return "no effect closes enough to lead"
    on = f" on {', '.join(near['axes'])}" if near["axes"] else ""
    left = f"{left_by(near, gap):.2g}{on}"
    return f"{' and '.join(near['effects'])} would close {near['closed']:.2f} and leave {left}"


def left_by(near: Mapping[str, Any], gap: Mapping[str, Any]) -> float:
    """The gap that what comes nearest would leave."""
    return float(gap["before"] - near["closed"] * (gap["before"] - gap["floor"]))


def nulls_section(records: list[Record]) -> str:
    """False alarms, in all and by mismatch."""
    rows = [
        ["**all**", share(records, lambda r: bool(named(r))), share(records, lambda r: bool(r["causes"]))]
    ]
    for name in sorted({truth(r)[0] for r in records}):
        mine = [r for r in records if truth(r)[0] == name]
        what = Counter(cause for r in mine for cause in named(r))
        rows.append(
            [name, share(mine, lambda r: bool(named(r))), ", ".join(f"{n} {c}" for n, c in what.items())]
        )
    verdicts = ", ".join(f"{v} {n}" for v, n in Counter(r["verdict"] for r in records).most_common())
    head = ["mismatch", "false alarms", "named (first row: counting the body's own demosaicker too)"]
    return table(head, rows) + f"\nVerdicts: {verdicts}.\n"


def axis_right(record: Record) -> bool:
    """Whether one of the axes that the effect is defined by is among the three that have most of the gap."""
    return bool(set(record["where"]) & OUTSIDE_AXES[truth(record)[0]])


def outside_section(records: list[Record]) -> str:
    seen = [r for r in records if plain_to_see(r)]
    rows = [[v, *(share(x, lambda r, v=v: r["verdict"] == v) for x in (records, seen))] for v in VERDICTS]
    rows.append(["right axis among the first three", *(share(x, axis_right) for x in (records, seen))])
    parts = [table(["verdict", "all strengths", "gap at least twice the floor"], rows)]
    axes: dict[str, Counter[str]] = defaultdict(Counter)
    for r in seen:
        axes[truth(r)[0]].update(r["where"])
    lines = [[n, ", ".join(f"{a} {c}" for a, c in found.most_common(4))] for n, found in sorted(axes.items())]
    return "\n".join([*parts, table(["effect", "first three axes"], lines), confusion(records)])


def pairs_section(records: list[Record]) -> str:
    """Of all pairs, and of those either effect of which makes a gap of twice the floor by itself."""
    rates: dict[str, Callable[[Record], bool]] = {
        "both found": both_found,
        "one or both": lambda r: bool(set(truth(r)) & set(r["causes"])),
        "anything else named": lambda r: bool(set(named(r)) - set(truth(r))),
    }
    seen = [r for r in records if plain_to_see(r) and all(r["each"])]
    rows = [[name, share(records, hit), share(seen, hit)] for name, hit in rates.items()]

    def plain(record: Record) -> str:
        return "not looked at" if None in record["each"] else "yes" if record in seen else "no"

    missed = [
        [r["case"], ", ".join(r["causes"]) or r["verdict"], gap_of(r), plain(r)]
        for r in records if not both_found(r)
    ]  # fmt: skip
    return "\n".join([
        table(["quantity", "all", "each alone at least twice the floor"], rows),
        table(["case", "said", "gap (floor)", "each alone plain to see"], missed),
    ])  # fmt: skip


def with_each(records: Sequence[Record]) -> list[Record]:
    """The records, those of pairs with `each`: whether either effect alone makes a gap of twice the floor;
    None where that was not looked at."""

    def place(record: Record, name: str) -> tuple[str, ...]:
        return record["kind"], record["body"], record["scenes"], name

    alone = {place(r, truth(r)[0]): plain_to_see(r) for r in records if r["split"] == "alone"}
    return [
        r | {"each": [alone.get(place(r, name)) for name in truth(r)]} if r["split"] == "pairs" else r
        for r in records
    ]


def deleted_rates() -> dict[str, Callable[[Record], bool]]:
    """What may be said where the true effect is not among those tried."""

    def stood_in(record: Record) -> bool:
        name, first = truth(record)[0], (named(record) or [""])[0]
        return any({name, first} <= group for group in GROUPS)

    return {
        "unknown": lambda r: r["verdict"] == "unknown",
        "another of its group": stood_in,
        "none": lambda r: not named(r) and r["verdict"] != "unknown",
        "an effect of another group": lambda r: bool(named(r)) and not stood_in(r),
    }


def deleted_section(records: list[Record]) -> str:
    rates = deleted_rates()
    seen = [r for r in records if plain_to_see(r)]
    rows = [[name, share(records, hit), share(seen, hit)] for name, hit in rates.items()]
    head = ["said", "all strengths", "gap at least twice the floor"]
    return "\n".join([table(head, rows), confusion(records)])


def stripped_section(records: list[Record]) -> str:
    """Pictures whose header is lost: the effect (the first of the truth), and the compression."""
    rates: dict[str, Callable[[Record], bool]] = {
        "effect named": lambda r: truth(r)[0] in r["causes"],
        "effect, or what it cannot be told from": lambda r: any(
            truth(r)[0] in (cause, *r["alternatives"][cause]) for cause in r["causes"]
        ),
        "compression named": lambda r: LOST_HEADER[0] in r["causes"],
        "anything else named": lambda r: bool(set(named(r)) - set(truth(r))),
        "verdict none": lambda r: r["verdict"] == "none",
        "verdict unknown": lambda r: r["verdict"] == "unknown",
    }
    sure = [r for r in records if truth(r)[0] not in ABSORBABLE]
    rows = [[name, share(sure, hit), share(records, hit)] for name, hit in rates.items()]
    lines = []
    for r in sorted(records, key=lambda r: truth(r)[0]):
        alike = {other for others in r["alternatives"].values() for other in others}
        status = [n for n, said in r["status"].items() if said == "not_identifiable" and n not in alike]
        lines.append([truth(r)[0], r["body"], gap_of(r), ", ".join(r["causes"]) or r["verdict"],
                      ", ".join(sorted(alike)), ", ".join(sorted(status))])  # fmt: skip
    return "\n".join([
        table(["said", "of effects that no base takes up", "all"], rows),
        table(["effect", "body", "gap (floor)", "said", "alternatives", "not identifiable"], lines),
    ])  # fmt: skip


def libraw_section(records: list[Record]) -> str:
    """LibRaw's switches: what was named, and whether that is right."""

    def right(record: Record) -> bool:
        first = record["causes"][0] if record["causes"] else record["verdict"]
        return first in SWITCHES[truth(record)[0]].right

    rows = []
    for name, switch in SWITCHES.items():
        mine = [r for r in records if truth(r)[0] == name]
        said = Counter((r["causes"] or [f"({r['verdict']})"])[0] for r in mine)
        told = ", ".join(f"{n} {c}" for n, c in said.most_common())
        rows.append([name, " or ".join(switch.right), told, share(mine, right)])
    wrong = [[r["case"], ", ".join(r["causes"]) or r["verdict"], gap_of(r)] for r in records if not right(r)]
    return "\n".join([
        table(["switch", "right would be", "named first, times", "right"], rows),
        table(["not right", "said", "gap (floor)"], wrong),
    ])  # fmt: skip


SECTIONS = {
    "develop": ("Effects to develop on", effects_section),
    "sealed": ("Sealed effects", effects_section),
    "nulls": ("Nothing missing", nulls_section),
    "outside": ("Effects outside the vocabulary", outside_section),
    "pairs": ("Two effects at once", pairs_section),
    "deleted": ("The true effect left out", deleted_section),
    "libraw": ("LibRaw as the camera", libraw_section),
    "stripped": ("Headers lost", stripped_section),
}


def markdown(records: Sequence[Record], head: str = "") -> str:
    """The head; sections by kind of data and split; then seconds and failures."""
    whole = with_each([r for r in records if "failed" not in r])
    parts = [head]
    for kind in sorted({r["kind"] for r in whole}):
        for split, (title, section) in SECTIONS.items():
            mine = [r for r in whole if r["kind"] == kind and r["split"] == split]
            if mine:
                parts.append(f"## {title}, {kind}\n\n{section(mine)}")
    seconds = [r["seconds"] for r in whole]
    if seconds:
        parts.append(f"Seconds a diagnosis: median {median(seconds):.0f}, longest {max(seconds):.0f}.\n")
    broken = [[r["case"], r["failed"]] for r in records if "failed" in r]
    if broken:
        parts.append("## Broken off\n\n" + table(["case", "why"], broken))
    return "\n".join(parts)


def collected(paths: Iterable[Path]) -> tuple[list[Record], list[str]]:
    """The cases of all files, and the commands that asked for them."""
    records: dict[str, Record] = {}
    commands: list[str] = []
    for path in paths:
        found = json.loads(path.read_text())
        records |= found["cases"]
        commands += found.get("commands", [])
    return list(records.values()), commands


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--note", default="", help="a sentence about these results")
    arguments = parser.parse_args()
    records, commands = collected(arguments.results)
    levels = {level for r in records if r["split"] == "sealed" for _, level in r["effects"]}
    head = HEAD.format(
        strengths=f", strength {' and '.join(map(str, sorted(levels)))}" if levels else "",
        note=f" {arguments.note}" if arguments.note else "",
        results=" ".join(str(path) for path in arguments.results),
        commands="\n".join(f"$study {command}" for command in dict.fromkeys(commands)),
        page=arguments.out,
    )
    arguments.out.write_text(markdown(records, head))


if __name__ == "__main__":
    main()
