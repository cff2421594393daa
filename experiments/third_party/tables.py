"""Tables of what a run said, all cases counted, with Wilson's 95 % intervals."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import inf
from typing import Any

from experiments.withheld.tables import share, table

from .run import PAIRS
from .switches import NONE, OUTSIDE

Record = dict[str, Any]
_SIZES = (-inf, 1.25, 2.0, 4.0, inf)
_SURE = 0.9
"""Probability from which on a name is a claim; where a report has none, every cause is one."""


def right(record: Record) -> list[str]:
    """The effects that are right answers."""
    truth = record["truth"]
    return [name for name in (truth["truth"], *truth["also"]) if name not in (NONE, OUTSIDE)]


def causes(record: Record) -> list[str]:
    return [c["effect"] for c in record.get("report", {}).get("causes", ())]


def first(record: Record) -> bool:
    """A right effect is named first."""
    return causes(record)[:1] != [] and causes(record)[0] in right(record)


def strictly_first(record: Record) -> bool:
    return causes(record)[:1] == [record["truth"]["truth"]]


def ranked(record: Record, count: int) -> bool:
    """A right effect is among the first of the ranking."""
    rows = [r["effect"] for r in record.get("report", {}).get("ranking", ())[:count]]
    return any(name in rows for name in right(record))


def surely_named(record: Record) -> list[str]:
    """Effects that are claimed and are not right."""
    found = record.get("report", {}).get("causes", ())
    sure = [c["effect"] for c in found if (c.get("probability") is None or c["probability"] > _SURE)]
    return [name for name in sure if name not in right(record)]


def beside(record: Record) -> bool:
    """Whether the camera's plain pictures were given: nothing is taken up by a base then."""
    return bool(record.get("how", PAIRS) != PAIRS)


def of_effects(records: Sequence[Record]) -> list[Record]:
    """Cases with something to be named; what a base takes up is, where the plain pictures are given."""

    def counts(record: Record) -> bool:
        truth = record["truth"]["truth"]
        return truth not in (NONE, OUTSIDE) or (truth == NONE and beside(record) and right(record) != [])

    return [r for r in records if counts(r)]


def of_nothing(records: Sequence[Record], truth: str) -> list[Record]:
    """Cases with nothing to be named: of `NONE` or `OUTSIDE`."""
    named = {r["truth"]["case"] for r in of_effects(records)}
    return [r for r in records if r["truth"]["truth"] == truth and r["truth"]["case"] not in named]


def size(record: Record, records: Mapping[str, Record]) -> float | None:
    """One, and what the switch adds to the gap of the same camera without it, in floors; None where one of
    the two is not known. Where a base is right, and beside plain pictures, it is the gap over its floor; one
    where the gap is no larger than what two files leave."""
    if beside(record):
        own = record.get("report", {}).get("gap")
        return None if own is None else own["before"] / own["floor"] if own["floor"] else 1.0
    plain = records.get(record["truth"]["plain"])
    if plain is None or "report" not in plain or "report" not in record:
        return None
    own, other = record["report"]["gap"], plain["report"]["gap"]
    return 1 + (own["before"] - other["before"]) / max(own["floor"], 1e-9)


RATES: dict[str, Callable[[Record], bool]] = {
    "truth named first": first,
    "by its main name": strictly_first,
    "truth ranked first": lambda r: ranked(r, 1),
    "in the first three": lambda r: ranked(r, 3),
    "another named for sure": lambda r: bool(surely_named(r)),
    "unknown": lambda r: r.get("report", {}).get("verdict") == "unknown",
    "none": lambda r: r.get("report", {}).get("verdict") == "none",
    "failed": lambda r: "failed" in r,
}


def summary(records: Sequence[Record]) -> dict[str, Any]:
    """Counts, as `--json` prints them: of effects by size, of plain cameras and of what is outside."""
    parts = {name: own for name, own in groups(records).items() if own}
    return {
        name: {"cases": len(own), **{rate: sum(map(hit, own)) for rate, hit in RATES.items()}}
        for name, own in parts.items()
    }


def groups(records: Sequence[Record]) -> dict[str, list[Record]]:
    by_name = {r["truth"]["case"]: r for r in records}
    effects = of_effects(records)
    sized = [(size(r, by_name), r) for r in effects]
    found = {"effects, all": effects}
    for low, high in pairwise(_SIZES):
        name = f"effects of {low:g} to {high:g} floors" if low > -inf else f"effects below {high:g} floors"
        found[name] = [r for own, r in sized if own is not None and low <= own < high]
    found["effects, size not known"] = [r for own, r in sized if own is None]
    found["nothing added"] = of_nothing(records, NONE)
    found["outside the library"] = of_nothing(records, OUTSIDE)
    return found


def markdown(records: Sequence[Record]) -> str:
    """The rates by size, by converter and by switch, and a line for each case."""
    return "\n".join([
        rates(records),
        table(["switch", "truth", "named first", "in three", "named instead"], _by_switch(records)),
        by_case(records),
    ])  # fmt: skip


def kept(record: Record) -> Record:
    """What of a record the tables need, for a file of results."""
    truth = {name: value for name, value in record["truth"].items() if name != "settings"}
    if "failed" in record:
        return {"truth": truth, "how": record["how"], "failed": record["failed"], "trace": record["trace"]}
    report = record["report"]
    causes = [{n: c.get(n) for n in ("effect", "probability", "closed", "ci")} for c in report["causes"]]
    gap = {name: report["gap"][name] for name in ("before", "floor")}
    ranking = [{"effect": r["effect"]} for r in report["ranking"][:3]]
    own = {"verdict": report["verdict"], "causes": causes, "ranking": ranking, "gap": gap}
    return {"truth": truth, "how": record["how"], "report": own}


def rates(records: Sequence[Record]) -> str:
    """The rates by size, of all cases."""
    found = [(name, own) for name, own in groups(records).items() if own]
    rows = [[name, len(own), *(share(own, hit) for hit in RATES.values())] for name, own in found]
    return table(["cases", "number", *RATES], rows)


def by_case(records: Sequence[Record]) -> str:
    return table(["case", "truth", "floors", "said", "ranking"], _by_case(records))


def _by_switch(records: Sequence[Record]) -> list[list[object]]:
    found: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        truth = record["truth"]
        found.setdefault((truth["converter"], truth["switch"]), []).append(record)
    return [
        [
            " ".join(key), own[0]["truth"]["truth"], f"{sum(map(first, own))}/{len(own)}",
            f"{sum(ranked(r, 3) for r in own)}/{len(own)}",
            ", ".join(sorted({name for r in own for name in surely_named(r)})) or "",
        ]
        for key, own in sorted(found.items())
    ]  # fmt: skip


def _by_case(records: Sequence[Record]) -> list[list[object]]:
    by_name = {r["truth"]["case"]: r for r in records}
    rows: list[list[object]] = []
    for record in records:
        truth, report = record["truth"], record.get("report")
        own = size(record, by_name)
        said = record["failed"] if report is None else ", ".join(causes(record)) or report["verdict"]
        first_three = ", ".join(r["effect"] for r in report["ranking"][:3]) if report else ""
        rows.append([truth["case"], truth["truth"], "" if own is None else f"{own:.2f}", said, first_three])
    return rows
