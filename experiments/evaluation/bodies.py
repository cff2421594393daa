"""Tables of the bodies that were written for this study."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from statistics import median

from experiments.evaluation.kept import Record
from experiments.withheld.effects import ABSORBABLE, KINDS
from experiments.withheld.tables import (
    axis_right,
    both_found,
    by_gap_rows,
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
    with_each,
)
from jaxisp.gap import EFFECTS

SPLITS = ("sealed", "develop")
LATEST = ("elm", "fig")
"""The bodies that came last."""
TITLES = {kind: kind.replace("raw+jpeg", "RAW+JPEG") for kind in KINDS}
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


def middle(values: Sequence[float]) -> str:
    return f"{median(values):.2f} ({len(values)})" if values else "– (0)"


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


def two_effects(records: Sequence[Record]) -> str:
    """Pairs of effects, each alone twice the floor, of which not both are found."""
    own = [r for r in with_each(records) if r["split"] == "pairs" and plain_to_see(r) and all(r["each"])]
    rows = [[TITLES[r["kind"]], r["body"], _effects(r), ", ".join(r["causes"]) or r["verdict"], gap_of(r)]
            for r in sorted(own, key=lambda r: r["case"]) if not both_found(r)]  # fmt: skip
    return table(["pairs", "body", "truth", "named", "gap (floor)"], rows)


def _effects(record: Record) -> str:
    return " and ".join(f"{name} {level}" for name, level in record["effects"])


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


def run(records: Sequence[Record]) -> str:
    """Which bodies were run, and how many cases of each."""
    counts = Counter((r["kind"], r["split"], r["body"]) for r in records)
    rows: dict[tuple[str, str], list[str]] = {}
    for (kind, split, body), count in sorted(counts.items()):
        rows.setdefault((kind, split), []).append(f"{body} {count}")
    return table(["pairs", "split", "cases"], [[*key, ", ".join(own)] for key, own in rows.items()])
