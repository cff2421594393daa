"""The floor of RAW+JPEG pairs beside what a known camera leaves of files that Pillow writes.

    python -m experiments.known_floor
    python -m experiments.known_floor --nulls docs/results/diagnosis.json

The plain camera is fitted to a body of the withheld study and taken for the truth. Its pictures, with one
effect or none, are stored at several qualities and chroma samplings. The truth's own gap on the held-out
pairs, with pixels weighed as a diagnosis weighs them, is what the floor should be.
"""

import argparse
import dataclasses
import io
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.withheld.bodies import BODIES
from experiments.withheld.shoot import write
from experiments.withheld.tables import table
from jaxisp.gap import EFFECTS
from jaxisp.gap.base.plain_raw import plain_parts, raw_model
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.pairs import INNER, Pairs
from jaxisp.gap.pairs.read import aligned_pairs
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.simulator.model import Model, build
from jaxisp.io import Jpeg, open_dataset
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import decode_jpeg
from jaxisp.process.cache import keep_compiled

SAMPLINGS = ("4:4:4", "4:2:2", "4:2:0")
QUALITIES = (80, 88, 95)
CHANGES = {"none": 0.0, "sharpening": 2.5, "luma_denoising": 0.9}
"""Effects that the truth has, and the first number of each."""


def stored(picture: np.ndarray, quality: int, sampling: str) -> Jpeg:
    """An encoded picture (H, W, 3) as Pillow's file of it has it."""
    data = io.BytesIO()
    pixels = Image.fromarray(np.rint(255 * picture).clip(0, 255).astype(np.uint8))
    pixels.save(data, "jpeg", quality=quality, subsampling=SAMPLINGS.index(sampling))
    return decode_jpeg(data.getvalue(), "a")


def known(loaded: Sequence[Loaded], pairs: Pairs) -> Model:
    """The plain camera, fitted to these pairs, without a file's sampling."""
    plain = [dataclasses.replace(pair, jpeg=None) for pair in loaded]
    effects = [EFFECTS[name] for name in CHANGES if name in EFFECTS]
    return raw_model(plain, pairs, effects, split_of(pairs.names).fit).model


def rows(loaded: Sequence[Loaded], sampling: str, quality: int, truth: Model) -> Iterator[list[object]]:
    """Of each change: the truth's own gap and the floor, and of Y', Cb and Cr the share of the two."""
    pairs = raw_pairs(loaded)
    split = split_of(pairs.names)
    held, counted = list(split.held_out), pairs.mask[INNER][list(split.held_out)]
    for change, amount in CHANGES.items():
        z = np.zeros(len(truth.coordinates))
        z[truth.indices([change])[:1] if amount else []] = amount
        files = [stored(p, quality, sampling) for p in truth.render(z, pairs.light)]
        own = [dataclasses.replace(pair, jpeg=file) for pair, file in zip(loaded, files)]
        chain, params, _ = plain_parts(own, pairs, np.ones((len(own), 3)))
        fitted = {name: value for name, value in truth.shared.items() if name in params}
        effects = [EFFECTS[name] for name in truth.effects]
        model = build(chain, params | fitted, truth.per_pair, truth.base, effects)
        pictures = np.stack([file.image for file in files]).astype(np.float32)
        objective = PixelObjective.of(dataclasses.replace(pairs, pictures=pictures), split)
        objective = objective.robust(objective.at(model, np.zeros_like(z)))
        at = objective.at(model, z)
        floor = objective.floor_difference(at, files)
        left = objective.target - at.shown[0]
        shares = [(floor[held][counted] ** 2).mean(0) / (left[held][counted] ** 2).mean(0)]
        sizes = at.errors[held].mean(), objective.floor_errors(at, floor)[held].mean()
        yield [
            sampling,
            quality,
            change,
            *(f"{size:.2f}" for size in sizes),
            *(f"{share:.3f}" for share in (sizes[1] / sizes[0], *shares[0])),
        ]


def of_nulls(path: Path) -> list[list[object]]:
    """By chroma sampling, how many RAW+JPEG nulls of a study have a gap no larger than their floor."""
    samplings = {"full_sampling": "4:4:4", "half_sampling": "4:2:0", "lossless": "none"}
    found: dict[str, list[bool]] = {}
    for case in json.loads(path.read_text())["nulls"]["cases"].values():
        if case["kind"] == "raw+jpeg" and "gap" in case:
            changes = [samplings[name] for name, _ in case["effects"] if name in samplings]
            sampling = changes[0] if changes else BODIES[case["body"]].sampling
            found.setdefault(sampling, []).append(case["gap"]["before"] <= case["gap"]["floor"])
    return [[sampling, len(own), sum(own)] for sampling, own in sorted(found.items())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--body", default="elm")
    parser.add_argument("--size", type=int, default=192, help="of a scene, px a side")
    parser.add_argument("--nulls", type=Path, help="count the nulls of a file of results alone")
    asked = parser.parse_args()
    if asked.nulls is not None:
        print(table(["sampling", "nulls", "gap no larger than the floor"], of_nulls(asked.nulls)))
        return
    keep_compiled()
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), asked.body, {}, "raw+jpeg", "one", asked.size, count=4)
        loaded = aligned_pairs(open_dataset(folder)).kept
    truth = known(loaded, raw_pairs(loaded))
    found = [row for s in SAMPLINGS for q in QUALITIES for row in rows(loaded, s, q, truth)]
    head = ["sampling", "quality", "effect", "left by the truth", "floor", "share", "Y'", "Cb", "Cr"]
    print(table(head, found))


if __name__ == "__main__":
    main()
