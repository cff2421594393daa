"""Whether the interval of what an effect closes holds on scenes that were neither fitted nor held out.

    python -m experiments.fresh_scenes --kind clean+noisy --bodies alder --out fresh-scenes.json

The effect's own refit, as the diagnosis made it, is put before further scenes of the same camera; what it
closes there must lie in the interval that the held-out scenes gave. A run that was broken off goes on.
"""

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.withheld.bodies import BODIES, LATER
from experiments.withheld.effects import ABSORBABLE, DEVELOP, KINDS, PAIRED, SEALED, VOCABULARY, shows_in
from experiments.withheld.scenes import SETS, Scenes, scenes
from experiments.withheld.shoot import write
from experiments.withheld.tables import table, wilson
from jaxisp.gap.base.clean_noisy import plain_case
from jaxisp.gap.base.mean import MeanFit, fit_mean
from jaxisp.gap.base.raw_jpeg import raw_case
from jaxisp.gap.case import Case
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.align_clean import align_clean, clean_pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.trial import Trial
from jaxisp.gap.search.verdict import searched
from jaxisp.gap.simulator.effects import CLEAN_NOISY, candidates
from jaxisp.io.datasets import Loaded, open_dataset

SPLITS = {"develop": DEVELOP, "sealed": SEALED}
OWN = {"develop": "one", "sealed": "two"}
"""The scenes that are diagnosed, as in the study; the fresh ones are the first of the other sets."""
_RANDOM_IN_PIXELS = "film_grain"  # no picture of it can be put before other scenes
_HALF = {PAIRED: (256, 4), CLEAN_NOISY: (128, 3)}
"""Side of a scene, and how many are fitted, as many held out, and as many in each set of fresh ones."""


def quiet(done: int, total: int, text: str) -> None:
    pass


def pictures(own: str, size: int, half: int) -> Scenes:
    """Two halves of one set, turn about, then one half of each other set."""
    found = {f"0{k}{name}": s for k, (name, s) in enumerate(scenes(own, size, 2 * half).items())}
    for other in SETS:
        if other != own:
            found |= {f"1{other}{name}": s for name, s in scenes(other, size, half).items()}
    return found


def groups(half: int) -> list[Split]:
    """The fitted scenes beside those held out, then beside each half of fresh ones."""
    fit = tuple(range(0, 2 * half, 2))
    fresh = [tuple(range(start, start + half)) for start in (2 * half, 3 * half)]
    return [Split(fit, held) for held in (tuple(range(1, 2 * half, 2)), *fresh)]


def raw_cases(loaded: Sequence[Loaded], half: int) -> Iterator[Case]:
    splits = groups(half)
    case = raw_case(loaded, None, (), quiet, splits[0])
    assert case.pixels is not None
    for split in splits:
        pixels = dataclasses.replace(case.pixels, split=split)
        yield dataclasses.replace(case, pixels=pixels, evidence=pixels)


def noisy_cases(loaded: Sequence[Loaded], half: int) -> Iterator[Case]:
    """All with the model of the first: the noise is fitted to the same pairs."""
    splits, loaded = groups(half), align_clean(loaded).kept
    mean = fit_mean(loaded[0].jpeg, clean_pairs(loaded), splits[0], None)
    effects, first = candidates(CLEAN_NOISY, ()), None
    for split in splits:
        which = [*split.fit, *split.held_out]
        own = Split(tuple(range(half)), tuple(range(half, 2 * half)))
        objective = dataclasses.replace(mean.objective.take(which), split=own)
        at = objective.at(mean.point.model.take(which), mean.point.z)
        case = plain_case(MeanFit(mean.camera, objective, at), effects, 0, quiet)
        first = first or case.point.model
        yield dataclasses.replace(case, point=case.evidence.at(first, np.zeros(len(case.point.z))))


def drop(case: Case, trial: Trial) -> tuple[float, float]:
    """By how much the trial's point lowers the gap of the case's held-out pairs, and that gap."""
    evidence, held = case.evidence, list(case.split.held_out)

    def gap(point: Point) -> float:
        return float(np.nanmean(evidence.units(point)[held]))

    scale, model, before = case.gap().scale, case.point.model, gap(case.point)
    if trial.choice is not None:
        model = model.chosen(trial.choice)
        before = min(before, gap(evidence.at(model, case.point.z)))
    return before - gap(evidence.at(model, trial.z)), scale


def examine(kind: str, split: str, body: str, name: str, strength: int) -> dict[str, Any]:
    size, half = _HALF[kind]
    record = {"kind": kind, "split": split, "body": body, "effect": name, "strength": strength}
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), body, {name: strength}, kind, pictures(OWN[split], size, half))
        loaded = [pair.load() for pair in open_dataset(folder).pairs]
        own, *fresh = list((raw_cases if kind == PAIRED else noisy_cases)(loaded, half))
        found = searched(own, own.gap(), quiet)
        named = [trial.effect for trial, _ in found.causes]
        record |= {"named": named, "right": named[:1] == [name]}
        if named[:1] != [name] or name not in found.trials:  # the latter: found beside another
            return record
        trial = found.trials[name]
        drops, scales = zip(*(drop(case, trial) for case in fresh))
    closed = sum(drops) / sum(scales)
    ci = [trial.low, trial.high]
    return record | {"closed": trial.closed, "ci": ci, "fresh": closed, "inside": ci[0] <= closed <= ci[1]}


def page(found: dict[str, Any]) -> str:
    lines = ["# Intervals on fresh scenes", "", __doc__.split("\n\n")[2], ""]
    for kind in KINDS:
        own = [r for r in found.values() if r["kind"] == kind]
        seen = [r for r in own if "fresh" in r]
        if not seen:
            continue
        right, inside = (sum(r.get(key, False) for r in own) for key in ("right", "inside"))
        low, high = wilson(inside, len(seen))
        lower = np.median([r["fresh"] - r["closed"] for r in seen])
        lines += [
            f"## {kind}",
            "",
            f"{len(own)} cases, the right effect first in {right}. The 90 % interval holds what is closed on "
            f"fresh scenes in {inside} of the {len(seen)} found at once: {inside / len(seen):.0%} "
            f"[{low:.0%}, {high:.0%}]. What is closed there less what is closed on those held out: "
            f"{lower:+.2f} in the median.",
            "",
            table(
                ["effect", "strength", "body", "closed [90 % interval]", "on fresh scenes"],
                [
                    [r["effect"], r["strength"], r["body"],
                     f"{r['closed']:.2f} [{r['ci'][0]:.2f}, {r['ci'][1]:.2f}]",
                     f"{r['fresh']:.2f}" + ("" if r["inside"] else " (outside)")]
                    for r in seen
                ],
            ),
        ]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=KINDS, required=True)
    parser.add_argument("--split", choices=sorted(SPLITS), default="develop")
    first = sorted({*BODIES} - {*LATER})
    parser.add_argument("--bodies", nargs="+", choices=sorted(BODIES), default=first)
    parser.add_argument("--effects", nargs="+", choices=sorted(VOCABULARY), help="only these of the split")
    parser.add_argument("--strength", type=int, default=4)
    parser.add_argument("--out", type=Path, required=True)
    a = parser.parse_args()
    found: dict[str, Any] = json.loads(a.out.read_text()) if a.out.exists() else {}
    without = (*ABSORBABLE, _RANDOM_IN_PIXELS) if a.kind == PAIRED else ABSORBABLE
    for name in a.effects or [n for n in SPLITS[a.split] if shows_in(n, a.kind) and n not in without]:
        for body in a.bodies:
            key = f"{a.kind} {a.split} {body} {name}={a.strength}"
            if key not in found:
                found[key] = examine(a.kind, a.split, body, name, a.strength)
                a.out.parent.mkdir(parents=True, exist_ok=True)
                partial = a.out.with_suffix(".partial")
                partial.write_text(json.dumps(found, indent=1))
                partial.replace(a.out)
                a.out.with_suffix(".md").write_text(page(found))
                print(key, {k: found[key].get(k) for k in ("named", "closed", "ci", "fresh")}, flush=True)


if __name__ == "__main__":
    main()
