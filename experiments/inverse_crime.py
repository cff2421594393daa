"""The diagnosis of pictures that the package itself made: what it says where its own code is on both sides.

    python -m experiments.inverse_crime --kind raw+jpeg --out docs/results/inverse-crime.json

Base and effects are the diagnosis' own, fitted to a withheld body's pairs, so that nothing but the effect is
lacking. That is no evidence: it stands beside the cameras that share no code (`experiments.withheld`), to say
how much of what they show is the method and how much their being others. A run that was broken off goes on.
"""

import argparse
import dataclasses
import json
import shutil
import tempfile
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.withheld.bodies import BODIES
from experiments.withheld.camera import compressed
from experiments.withheld.effects import ABSORBABLE
from experiments.withheld.shoot import write
from experiments.withheld.study import kept
from experiments.withheld.tables import table, wilson
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base.clean_noisy import clean_case
from jaxisp.gap.base.plain_raw import raw_model
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG, candidates
from jaxisp.gap.simulator.model import Model
from jaxisp.io.datasets import open_dataset
from jaxisp.io.files import write_text

BODY = "alder"
DEMOSAICKING, STATED = {"demosaicking": "part of the base"}, {"jpeg_quantization": "stated by the file"}
RANDOM = {"film_grain": "random: no point of the model"}


class Arm(NamedTuple):
    """How one kind of pairs is made.

    Attributes:
        base: a folder's base as a diagnosis fits it, all effects in it and off.
        size: of a point, how large what it changes is.
        wanted: how large that is to be.
        shown: floors from which most effects are found in cameras that share no code.
        taken_up: effects that the base takes up.
        elsewhere: effects left out, and why.
        told: of the page, that in words.
    """

    base: Callable[[Path], "Own"]
    size: Callable[["Own", np.ndarray], float]
    wanted: float
    shown: float
    taken_up: Collection[str]
    elsewhere: Mapping[str, str]
    told: str


class Own(NamedTuple):
    """The package's own camera.

    Attributes:
        model: all effects in it, off.
        names: of the pairs.
        rendered: the pictures (N, H, W, 3) at a point, with the noise that a diagnosis draws or with another.
        error: what a diagnosis would leave at a point, in its own unit.
    """

    model: Model
    names: Sequence[str]
    rendered: Callable[[np.ndarray, bool], np.ndarray]
    error: Callable[[np.ndarray], float]


def raw_base(folder: Path) -> Own:
    loaded = [pair.load() for pair in open_dataset(folder).pairs]
    pairs = raw_pairs(loaded)
    model = raw_model(loaded, pairs, candidates(RAW_JPEG), range(0, len(loaded), 2)).model
    objective = PixelObjective.of(pairs)
    return Own(
        model,
        pairs.names,
        lambda z, other: objective.rendered(model, z),
        lambda z: objective.at(model, z).error,
    )


def noisy_base(folder: Path) -> Own:
    loaded = [pair.load() for pair in open_dataset(folder).pairs]
    case = clean_case(loaded, None, (), 0, lambda *at: None)
    assert case.statistics is not None
    model, objective = case.point.model, case.statistics
    seeds = [objective.measure, dataclasses.replace(objective.measure, seed=1)]
    return Own(
        model,
        case.pairs.names,
        lambda z, other: seeds[other].rendered(model, z),
        lambda z: objective.at(model, z).error,
    )


def steps(own: Own, z: np.ndarray) -> float:
    """Root mean square change of the pictures, in 8-bit steps."""
    change = own.rendered(z, False) - own.rendered(np.zeros_like(z), False)
    return float(255 * np.sqrt(np.mean(change**2)))


def floors(own: Own, z: np.ndarray) -> float:
    """The gap to the body's pictures, in which nothing is missing."""
    return own.error(z)


ARMS = {
    RAW_JPEG: Arm(
        raw_base, steps, 3.0, 1.25, (*ABSORBABLE, "black_level_offset"), DEMOSAICKING | RANDOM | STATED,
        "to change them by {:g} 8-bit steps, root mean square",
    ),
    CLEAN_NOISY: Arm(
        noisy_base, floors, 10.0, 2.0, ABSORBABLE, DEMOSAICKING | STATED,
        "to make a gap of {:g} floors to the body's own, other noise being drawn",
    ),
}  # fmt: skip


def direction(model: Model, name: str) -> np.ndarray:
    """Drawn moves of all of an effect's parameters, as many probes wide."""
    own = model.indices([name])
    drawn = np.random.default_rng(zlib.crc32(name.encode())).standard_normal(len(own))
    low, high = model.ranges[:, own]
    steps = model.steps[own]
    # shares and amounts may go a little below none, which is not what they are for
    one_sided = (low >= -0.2) & (steps > 0)
    towards = np.zeros(len(model.coordinates))
    towards[own] = steps * np.where(one_sided | (high <= 0), np.abs(drawn), drawn)
    return towards


def strong(arm: Arm, own: Own, name: str) -> np.ndarray:
    """A point with the effect as strong as wanted, or as strong as its range allows."""
    towards = direction(own.model, name)
    low, high = own.model.ranges

    def at(length: float) -> np.ndarray:
        return np.where(towards == 0, 0.0, np.clip(length * towards, low, high))

    shortest, longest = 0.0, 8.0
    if arm.size(own, at(longest)) > arm.wanted:
        for _ in range(12):
            middle = (shortest + longest) / 2
            less = arm.size(own, at(middle)) < arm.wanted
            shortest, longest = (middle, longest) if less else (shortest, middle)
    return at(longest)


def examine(arm: Arm, own: Own, base: Path, name: str) -> dict[str, Any]:
    z = strong(arm, own, name)
    body = BODIES[BODY]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shutil.copytree(base, folder, dirs_exist_ok=True)
        for pair, picture in zip(own.names, own.rendered(z, True)):
            pixels = np.rint(255 * picture).astype(np.uint8)
            (folder / f"{pair}.jpg").write_bytes(compressed(pixels, body.quality, "4:4:4"))
        return {"effect": name, "size": round(arm.size(own, z), 2)} | kept(diagnose(folder).report)


def page(kind: str, found: dict[str, Any], out: Path) -> str:
    arm = ARMS[kind]
    sure = [r for r in found.values() if r["effect"] not in arm.taken_up]
    rates = {
        "right effect first": [r["causes"][:1] == [r["effect"]] for r in sure],
        "it or one that it cannot be told from": [
            bool(r["causes"]) and r["effect"] in (r["causes"][0], *r["alternatives"][r["causes"][0]])
            for r in sure
        ],
    }
    lines = [
        f"# The package on both sides, {kind}",
        "",
        "```sh",
        f"python -m experiments.inverse_crime --kind {kind} --out {out}",
        "```",
        "",
        f"Eight pairs of {BODY}, 256x256, half held out; pictures by the diagnosis' own base as fitted "
        f"to them, with one effect, drawn and scaled {arm.told.format(arm.wanted)}, or as far as eight "
        "probes or its range go. No evidence: what stands in [withheld effects](targets.md) is.",
        "",
    ]
    shown = [r["gap"]["before"] >= arm.shown * r["gap"]["floor"] for r in sure]
    for what, hits in rates.items():
        low, high = wilson(sum(hits), len(hits))
        seen = [hit for hit, plain in zip(hits, shown) if plain]
        rest = f"{sum(seen)} of the {len(seen)} whose gap is at least {arm.shown:g} floors"
        lines.append(f"- {what}: {sum(hits)} of {len(hits)} [{low:.0%}, {high:.0%}]; {rest}")
    rows = []
    for r in found.values():
        causes = ", ".join(f"{c} {r['closed'][c]:.2f}" for c in r["causes"])
        gap = f"{r['gap']['before']:.3g}, {r['gap']['floor']:.3g}"
        taken = " (the base takes it up)" if r["effect"] in arm.taken_up else ""
        rows.append([r["effect"] + taken, f"{r['size']:g}", gap, r["verdict"], causes])
    left = ", ".join(f"{name} ({why})" for name, why in arm.elsewhere.items())
    shares = table(["effect", "scaled to", "gap, floor", "verdict", "causes, share closed"], rows)
    return "\n".join([*lines, "", shares, f"Left out: {left}.", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=ARMS, required=True)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    kind, out = arguments.kind, arguments.out
    found: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        write(base, BODY, {}, kind, "two")
        own = ARMS[kind].base(base)
        for name in sorted(e.name for e in EFFECTS.values() if kind in e.shows_in):
            if name in ARMS[kind].elsewhere or name in found:
                continue
            found[name] = examine(ARMS[kind], own, base, name)
            write_text(out, json.dumps(found, indent=1) + "\n")
            print(name, found[name]["size"], found[name]["verdict"], found[name]["causes"], flush=True)
    write_text(out.with_suffix(".md"), page(kind, found, out))


if __name__ == "__main__":
    main()
