"""The null bank: how large each axis is for cameras that lack nothing, from results of `study`.

    python -m experiments.null_bank docs/results/diagnosis.json -o jaxisp/gap/axes/nulls.json

Results are files that `study` wrote, or the one that `experiments.evaluation` collects them in.

Prints how often a camera of one body would be said to have an axis beyond the bank that the others make.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.withheld.effects import KINDS
from jaxisp.gap.axes.null_bank import as_large
from jaxisp.gap.criteria import CRITERIA
from jaxisp.io.files import atomic_write

_CLEAR = min(criteria.clear for criteria in CRITERIA.values())
"""The p-value above which an axis is not said to have a gap."""

Sizes = Mapping[str, float]
BEYOND = 95
"""Per cent of the cameras that stay below what is usual."""
LEAST = 0.02
"""Of a floor, or a unit: what is smaller is usual, though no camera of the bank has as much."""


def bank_of(nulls: Sequence[Sizes]) -> dict[str, Any]:
    """Of each axis what 95 % of these stay below, and of each the most times that an axis has that."""
    axes = sorted({axis for sizes in nulls for axis in sizes})
    found = {axis: [sizes[axis] for sizes in nulls if axis in sizes] for axis in axes}  # not all have frames
    usual = {axis: max(float(np.percentile(own, BEYOND)), LEAST) for axis, own in found.items()}
    largest = sorted(max(size / usual[axis] for axis, size in sizes.items()) for sizes in nulls)
    return {
        "usual": {axis: round(size, 4) for axis, size in usual.items()},
        "largest": [round(times, 3) for times in largest],
    }


def beyond(bank: Mapping[str, Any], sizes: Sizes) -> list[str]:
    """The axes of a camera that are beyond the bank."""
    usual, largest = bank["usual"], bank["largest"]
    return [a for a, size in sizes.items() if a in usual and as_large(size / usual[a], largest) <= _CLEAR]


def left_out(by_body: Mapping[str, Sequence[Sizes]]) -> tuple[int, int]:
    """How many cameras have an axis that is beyond the bank of the other bodies, and of how many."""
    named = 0
    for body, own in by_body.items():
        bank = bank_of([s for other, sizes in by_body.items() if other != body for s in sizes])
        named += sum(bool(beyond(bank, sizes)) for sizes in own)
    return named, sum(map(len, by_body.values()))


def nulls_in(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The cases of a file of `study`, or of the groups of nulls in one of `evaluation`."""
    groups = [found] if "cases" in found else [found["nulls"], found["frames"]]
    return [record for group in groups for record in group["cases"].values()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    records = [r for path in arguments.results for r in nulls_in(json.loads(path.read_text()))]
    banks = {}
    for kind in KINDS:
        by_body: dict[str, list[Sizes]] = {}
        for r in records:
            if r["split"] == "nulls" and r["kind"] == kind and "axes" in r.get("gap", {}):
                by_body.setdefault(r["body"], []).append(r["gap"]["axes"])
        if not by_body:
            parser.error(f"{', '.join(map(str, arguments.results))}: no {kind} nulls with their axes")
        banks[kind] = bank_of([sizes for own in by_body.values() for sizes in own])
        named, count = left_out(by_body)
        print(f"{kind}: {count} cameras, {named} have an axis beyond the other bodies' bank")
    with atomic_write(arguments.out) as file:
        file.write((json.dumps(banks) + "\n").encode())


if __name__ == "__main__":
    main()
