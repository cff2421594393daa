"""Where a diagnosis of cameras of others fails: each case of the score's whose effect is not named first, and
what is named where no effect was added.

    python -m experiments.score.misses docs/results/score-cases.json
    python -m experiments.score.misses docs/results/score-cases.json --all

The cases keep what the search found when they ran; the probabilities are those of the score as it stands.
Of several names the first is that which closes most.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.withheld.tables import table
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.search import score

Record = Mapping[str, Any]
SCREENED = "screening preferred others: it was not refitted"
NO_GAP = "less than half a floor above it: no gap"
BEHIND = "refitted, and another closes more"
DOUBTED = "closes most, and is not probable enough"
OTHER_FIRST = "closes most, and another is named"
NAMED = "named first"


def likely(record: Record) -> dict[str, float]:
    """The probability of each refitted effect."""
    kinds = {e: score.EFFECT if "form" in own else score.GRAIN for e, own in record["signs"].items()}
    return {e: score.probability(kinds[e], own) for e, own in record["signs"].items()}


def names(record: Record) -> list[str]:
    """The effects that are named, that which closes most first."""
    found, least = likely(record), CRITERIA[record["kind"]].named
    named = (e for e in record["found"] if found.get(e, 0.0) >= least)
    return sorted(named, key=lambda e: -record["closed"][e])


def row_of(record: Record) -> list[object]:
    """A case's row of the table; at its end what became of its effect."""
    right, found, closed = record["truth"][0].split("|"), likely(record), record["closed"]
    ranked = sorted(closed, key=lambda e: -closed[e])
    named = names(record)
    own = next((e for e in ranked if e in right), None)
    others = [e for e in ranked if e != own]
    first = f"{others[0]} {closed[others[0]]:.2f}" if others else ""
    size = record["gap"]["before"] / record["gap"]["floor"]
    head = [record["name"].removeprefix("develop "), right[0], f"{size:.1f}"]
    if own is None:
        return [*head, "", "", first, SCREENED if others else NO_GAP]
    why = BEHIND if ranked[0] != own else OTHER_FIRST if named else DOUBTED
    why = NAMED if named and named[0] in right else why
    return [*head, f"{closed[own]:.2f}", f"{found[own]:.2f}", first, why]


def rows(records: Sequence[Record], every: bool = False) -> list[list[object]]:
    """Of the cases whose effect is not named first, or of every case that has an effect."""
    found = [row_of(r) for r in records if r["group"] == "third party" and r["truth"]]
    return [row for row in found if every or row[-1] != NAMED]


def row_of_nothing(record: Record) -> list[object]:
    """Of a case to which no effect of the library was added: what is named, and what closes most."""
    found, closed = likely(record), record["closed"]

    def told(effects: Sequence[str]) -> str:
        return ", ".join(f"{e} {closed[e]:.2f} ({found[e]:.2f})" for e in effects)

    most = sorted(closed, key=lambda e: -closed[e])[:1]
    gap = record["gap"]
    return [record["name"], f"{gap['before']:.1f}", f"{gap['floor']:.1f}", told(names(record)), told(most)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("--all", action="store_true", help="those that are named first, too")
    asked = parser.parse_args()
    records = json.loads(asked.cases.read_text())["cases"]
    found = rows(records, asked.all)
    print(table(["case", "truth", "floors", "closed", "probability", "most of others", "why"], found))
    print(table(["why", "cases"], Counter(str(row[-1]) for row in found).most_common()))
    nothing = [row_of_nothing(r) for r in records if r["group"] == "third party" and not r["truth"]]
    print(table(["case", "gap", "floor", "named, closed (probability)", "closes most"], nothing))


if __name__ == "__main__":
    main()
