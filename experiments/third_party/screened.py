"""How screening ranks the effects of a case, its own among them: what it refits are the first six.

    python -m experiments.third_party.screened CASE... --scenes 4

The predicted share is of the gap above its floor. Where the base demosaics square roots, the search screens
a second time beside linear values; that is left out here.
"""

import argparse
import json
from pathlib import Path

from experiments.withheld.tables import table
from jaxisp.gap.base.raw_jpeg import raw_case
from jaxisp.gap.pairs.read import aligned_pairs
from jaxisp.gap.search.screening import screen
from jaxisp.io import open_dataset
from jaxisp.process.cache import keep_compiled


def row(folder: Path, scenes: int | None) -> list[object]:
    """Gap, floor, the rank of the right effect with its predicted share, and the best of the others."""
    truth = json.loads((folder / "truth.json").read_text())
    case = raw_case(aligned_pairs(open_dataset(folder)).kept[:scenes], None, [], lambda *_: None)
    gap = case.gap()
    drops, _ = screen(case.evidence, case.point, case.offered)
    share = {name: drop / gap.scale for name, drop in drops.items()}
    ranked, right = sorted(share, key=lambda name: -share[name]), {truth["truth"], *truth["also"]}
    own = next((name for name in ranked if name in right), None)
    place = [] if own is None else [ranked.index(own) + 1, f"{share[own]:.2f}"]
    others = ", ".join(f"{name} {share[name]:.2f}" for name in ranked[:4] if name != own)
    return [
        folder.name,
        own or truth["truth"],
        f"{gap.before:.1f}",
        f"{gap.floor:.1f}",
        *(place or ["", ""]),
        others,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path, nargs="+", help="folders of `experiments.third_party make`")
    parser.add_argument("--scenes", type=int, help="the first so many alone")
    asked = parser.parse_args()
    keep_compiled()
    found = [row(case, asked.scenes) for case in asked.cases]
    print(table(["case", "effect", "gap", "floor", "rank", "predicted", "best of others"], found))


if __name__ == "__main__":
    main()
