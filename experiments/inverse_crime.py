"""The diagnosis of pictures that the package itself made: what it says where its own code is on both sides.

    python -m experiments.inverse_crime --out docs/results/inverse-crime.json

Base and effects are the diagnosis' own, fitted to a withheld body's RAW+JPEG pairs, so that nothing but the
effect is lacking. That is no evidence: it stands beside the cameras that share no code
(`experiments.withheld`), to say how much of what they show is the method and how much their being others. A
run that was broken off goes on.
"""

import argparse
import json
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from experiments.withheld.bodies import BODIES
from experiments.withheld.camera import compressed
from experiments.withheld.effects import ABSORBABLE
from experiments.withheld.shoot import write
from experiments.withheld.study import kept
from experiments.withheld.tables import wilson
from jaxisp.gap import EFFECTS, diagnose, prepare
from jaxisp.gap.effects import RAW_JPEG
from jaxisp.gap.residual import Problem
from jaxisp.io.datasets import open_dataset

BODY = "alder"
RMS = 3.0
"""How much the effect changes the picture, root mean square over its values, in 8-bit steps."""
ELSEWHERE = {
    "demosaicking": "part of the base",
    "film_grain": "random: no point of the model",
    "jpeg_quantization": "stated by the file",
}
SHOWN = 1.25
"""Floors from which most effects are found, in RAW+JPEG pairs of the cameras that share no code."""
TAKEN_UP = (*ABSORBABLE, "black_level_offset")


def base_before(folder: Path) -> Problem:
    """The plain base as a diagnosis fits it to these pairs, all effects in it and off."""
    loaded = [pair.load() for pair in open_dataset(folder).pairs]
    pairs = prepare.raw_pairs(loaded)
    effects = prepare.candidates(RAW_JPEG)
    base = prepare.raw_model(loaded, pairs, effects, range(0, len(loaded), 2))
    return Problem(base.model, pairs)


def direction(problem: Problem, name: str) -> np.ndarray:
    """Drawn moves of all of an effect's parameters, as many probes wide."""
    own = problem.model.indices([name])
    drawn = np.random.default_rng(zlib.crc32(name.encode())).standard_normal(len(own))
    low, high = problem.model.ranges[:, own]
    steps = problem.model.steps[own]
    # shares and amounts may go a little below none, which is not what they are for
    one_sided = (low >= -0.2) & (steps > 0)
    towards = np.zeros(len(problem.model.coordinates))
    towards[own] = steps * np.where(one_sided | (high <= 0), np.abs(drawn), drawn)
    return towards


def strong(problem: Problem, name: str) -> tuple[np.ndarray, float]:
    """A point with the effect as strong as wanted, or as strong as its range allows, and the change."""
    plain, towards = problem.rendered(problem.z), direction(problem, name)
    low, high = problem.model.ranges

    def at(length: float) -> tuple[np.ndarray, float]:
        moved = problem.z + length * towards
        z = np.where(towards == 0, problem.z, np.clip(moved, low, high))
        return z, float(255 * np.sqrt(np.mean((problem.rendered(z) - plain) ** 2)))

    shortest, longest = 0.0, 8.0
    if at(longest)[1] <= RMS:
        return at(longest)
    for _ in range(12):
        middle = (shortest + longest) / 2
        shortest, longest = (middle, longest) if at(middle)[1] < RMS else (shortest, middle)
    return at(longest)


def examine(problem: Problem, base: Path, name: str) -> dict[str, Any]:
    z, change = strong(problem, name)
    body = BODIES[BODY]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "dataset.toml").write_bytes((base / "dataset.toml").read_bytes())
        for pair, picture in zip(problem.pairs.names, problem.rendered(z)):
            (folder / f"{pair}.raw.npy").write_bytes((base / f"{pair}.raw.npy").read_bytes())
            pixels = np.rint(255 * picture).astype(np.uint8)
            (folder / f"{pair}.jpg").write_bytes(compressed(pixels, body.quality, "4:4:4"))
        return {"effect": name, "rms": round(change, 2)} | kept(diagnose(folder).report)


def page(found: dict[str, Any]) -> str:
    sure = [r for r in found.values() if r["effect"] not in TAKEN_UP]
    rates = {
        "right effect first": [r["causes"][:1] == [r["effect"]] for r in sure],
        "it or one that it cannot be told from": [
            bool(r["causes"]) and r["effect"] in (r["causes"][0], *r["alternatives"][r["causes"][0]])
            for r in sure
        ],
    }
    lines = [
        "# The package on both sides",
        "",
        "```sh",
        "python -m experiments.inverse_crime --out docs/results/inverse-crime.json",
        "```",
        "",
        f"Eight RAWs of {BODY}, 256x256, four held out; pictures by the diagnosis' own base as fitted to it, "
        f"with one effect, drawn and scaled to change them by {RMS:g} 8-bit steps, or as far as its range "
        "allows. No evidence: what stands in [withheld effects](withheld.md) is.",
        "",
    ]
    shown = [r["gap"]["before"] >= SHOWN * r["gap"]["floor"] for r in sure]
    for what, hits in rates.items():
        low, high = wilson(sum(hits), len(hits))
        seen = [hit for hit, plain in zip(hits, shown) if plain]
        rest = f"{sum(seen)} of the {len(seen)} whose gap is at least {SHOWN:g} floors"
        lines.append(f"- {what}: {sum(hits)} of {len(hits)} [{low:.0%}, {high:.0%}]; {rest}")
    lines += [
        "",
        "| effect | change [RMS] | gap, floor | verdict | causes, share closed |",
        "| --- " * 5 + "|",
    ]
    for r in found.values():
        causes = ", ".join(f"{c} {r['closed'][c]:.2f}" for c in r["causes"])
        gap = f"{r['gap']['before']:.3g}, {r['gap']['floor']:.3g}"
        taken = " (the base takes it up)" if r["effect"] in TAKEN_UP else ""
        lines.append(f"| {r['effect']}{taken} | {r['rms']:g} | {gap} | {r['verdict']} | {causes} |")
    left = ", ".join(f"{name} ({why})" for name, why in ELSEWHERE.items())
    return "\n".join([*lines, "", f"Left out: {left}.", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    found: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        base = Path(temporary)
        write(base, BODY, {}, RAW_JPEG, "two")
        problem = base_before(base)
        for name in sorted(e.name for e in EFFECTS.values() if RAW_JPEG in e.shows_in):
            if name in ELSEWHERE or name in found:
                continue
            found[name] = examine(problem, base, name)
            partial = out.with_suffix(".partial")
            partial.write_text(json.dumps(found, indent=1))
            partial.replace(out)
            print(name, found[name]["rms"], found[name]["verdict"], found[name]["causes"], flush=True)
    out.with_suffix(".md").write_text(page(found))


if __name__ == "__main__":
    main()
