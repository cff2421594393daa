"""A fitted camera less one of its stages, diagnosed on the pairs that it was fitted to.

    python -m experiments.less_one_stage PAIRS -o RESULTS.json [--camera CAMERA.toml]

The stage that was taken out is the truth. It should be named wherever the gap is higher by half a floor or
more without it. A run that was interrupted goes on where it stopped.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.withheld.tables import share, table
from jaxisp.io.files import atomic_write
from jaxisp.recipe import Recipe

EFFECTS = {
    "vignetting": ("vignetting",),
    "lateral_chromatic_aberration": ("lateral_chromatic_aberration",),
    "geometric_distortion": ("geometric_distortion",),
    "color_difference_median": ("chroma_denoising", "demosaicking"),
    "bilateral": ("luma_denoising", "chroma_denoising"),
    "median": ("luma_denoising", "chroma_denoising", "optical_blur"),
    "saturation": ("saturation", "color_lut"),
    "unsharp_mask": ("sharpening",),
    "chroma_subsampling": ("chroma_subsampling", "chroma_denoising"),
}
"""The effects that each stage of a fitted camera is; tone, matrix and demosaicker are refitted anyway."""
_VISIBLE = 0.5
"""Floors by which the gap must rise without a stage for it to count."""
Record = dict[str, Any]


def removable(camera: Recipe) -> list[str]:
    """The stages of a camera that are an effect."""
    there = [stage.name for stage in camera.chain.stages()]
    return [name for name in there if name in EFFECTS]


def examined(folder: Path, camera: Recipe) -> Record:
    """What a diagnosis with this camera says."""
    from jaxisp.gap import diagnose
    from jaxisp.gap.report.page import plain

    report = plain(diagnose(folder, camera).report)
    return {
        "gap": {name: report["gap"][name] for name in ("before", "after", "floor")},
        "moved": report["base"].get("moved"),
        "verdict": report["verdict"],
        "causes": [[c["effect"], c["closed"]] for c in report["causes"]],
        "ranking": [r["effect"] for r in report["ranking"][:3]],
    }


def run(folder: Path, camera: Recipe, out: Path) -> dict[str, Record]:
    """Diagnose with the whole camera, and less each stage that is an effect."""
    found: dict[str, Record] = json.loads(out.read_text()) if out.exists() else {}
    for name in ("", *removable(camera)):
        if name not in found:
            own = camera.without(name) if name else camera
            found[name] = examined(folder, own)
            with atomic_write(out) as file:
                file.write((json.dumps(found, indent=1) + "\n").encode())
            print(name or "whole", found[name], flush=True)
    return found


def raised(found: dict[str, Record], name: str) -> float:
    """Floors by which the gap is higher without a stage."""
    own, whole = found[name]["gap"], found[""]["gap"]
    return float((own["before"] - whole["before"]) / max(own["floor"], 1e-9))


def named(record: Record, name: str) -> bool:
    """Whether one of the stage's effects is among the causes."""
    return any(effect in EFFECTS[name] for effect, _ in record["causes"])


def markdown(found: dict[str, Record]) -> str:
    """A row for each stage, and how many are named of those that count."""
    names = [name for name in found if name]
    rows = []
    for name, own in ((name, found[name]) for name in names):
        said = ", ".join(f"{effect} {closed:.2f}" for effect, closed in own["causes"]) or own["verdict"]
        first, right = ", ".join(own["ranking"]), "yes" if named(own, name) else "no"
        rows.append([name, f"{own['gap']['before']:.3g}", f"{raised(found, name):.2f}", said, first, right])
    counted = [name for name in names if raised(found, name) >= _VISIBLE]
    whole, verdict = found[""]["gap"], found[""]["verdict"]
    told = share([{"name": name} for name in counted], lambda r: named(found[r["name"]], r["name"]))
    return "\n".join([
        f"Whole camera: gap {whole['before']:.3g}, floor {whole['floor']:.3g}, {verdict}.\n",
        table(["less", "gap", "floors more", "named", "ranking", "right"], rows),
        f"Named where the gap rises by {_VISIBLE} floors or more: {told}.",
    ])  # fmt: skip


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pairs", type=Path, help="RAW+JPEG pairs")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--camera", type=Path, help="default: fit one to the pairs, kept beside OUT")
    return parser.parse_args(words)


def main() -> None:
    arguments = parse()
    file = arguments.camera or arguments.out.with_suffix(".toml")
    if not file.exists():
        from jaxisp.fit import fit_dataset

        fit_dataset(arguments.pairs).camera.save(file)
    print(markdown(run(arguments.pairs, Recipe.load(file), arguments.out)))


if __name__ == "__main__":
    main()
