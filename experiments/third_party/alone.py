"""What effects close by themselves of a case's gap, refitted one at a time beside the base.

    python -m experiments.third_party.alone CASE EFFECT... --scenes 4

No search and no score: whether form and base let an effect be seen at all.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from experiments.withheld.tables import table
from jaxisp.gap import EFFECTS
from jaxisp.gap.base.raw_jpeg import raw_case
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.pairs.read import aligned_pairs
from jaxisp.io import open_dataset
from jaxisp.process.cache import keep_compiled


def rows(folder: Path, effects: Sequence[str], scenes: int | None) -> list[list[object]]:
    """The gap of the held-out pairs, its floor, and by effect the share that it closes."""
    loaded = aligned_pairs(open_dataset(folder)).kept[:scenes]
    case = raw_case(loaded, None, sorted(set(EFFECTS) - set(effects)), lambda *_: None)
    evidence, gap = case.evidence, case.gap()
    (part, start), (held, there) = evidence.fitted(case.point), evidence.held_out(case.point)
    found: list[list[object]] = []
    for effect in effects:
        moving = [*start.model.base_indices, *start.model.indices([effect])]
        end = fit(part, start, moving, steps=4).point
        left = held.at(there.model, end.z).error
        closed = (there.error - left) / gap.scale
        found.append([folder.name, f"{gap.before:.1f}", f"{gap.floor:.1f}", effect, f"{closed:.2f}"])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=Path, help="a folder of `experiments.third_party make`")
    parser.add_argument("effects", nargs="+", choices=sorted(EFFECTS))
    parser.add_argument("--scenes", type=int, help="the first so many alone")
    asked = parser.parse_args()
    keep_compiled()
    print(table(["case", "gap", "floor", "effect", "closed"], rows(asked.case, asked.effects, asked.scenes)))


if __name__ == "__main__":
    main()
