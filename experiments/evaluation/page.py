"""The page: its generated parts, by name."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.evaluation.beside import (
    beside,
    drops,
    fresh,
    left,
    libraw,
    null_bank,
    photographs,
    third_party,
)
from experiments.evaluation.bodies import (
    LATEST,
    by_effect,
    by_gap,
    deleted,
    frames,
    misses,
    run,
    targets,
    two_effects,
    variant,
)
from experiments.evaluation.kept import GROUPS, cases_of
from experiments.third_party import tables as switches

RESULTS = Path("docs/results")
PAGE = Path("docs/diagnosis-evaluation.md")
_BLOCK = re.compile(r"(<!-- generated: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


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


def commands(found: Mapping[str, Any]) -> str:
    """What was run for each group of cases."""
    lines = ["```sh", 'study="python -m experiments.withheld.study --out RESULTS.json"']
    for group in GROUPS:
        lines += [f"# {group}", *(f"$study {command}" for command in found[group]["commands"])]
    return "\n".join([*lines, "```", ""])


def rendered(page: str, parts: Mapping[str, str]) -> str:
    """The page with each block between `<!-- generated: NAME -->` and `<!-- end -->` made anew."""
    return _BLOCK.sub(lambda m: f"{m[1]}\n{parts[m[2]]}\n{m[3]}", page)
