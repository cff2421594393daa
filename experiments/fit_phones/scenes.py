"""Cameras on pictures that they were not fitted to: halves, other scenes, pairs left out, crops far apart.

What is reported of the other pictures is what `develop` makes of them, at the best shift by whole pixels.
"""

import dataclasses
import resource
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from experiments.fit_phones.common import SEED, Cases, Run, fitted_examples, framed
from experiments.fit_phones.libraw import FRAME, against, developed_alike, framed_dng, grey_dng
from experiments.fit_phones.recovery import DESIGNS, developed, known_pairs
from jaxisp.camera import develop
from jaxisp.fit import Example
from jaxisp.gap.base.plain_raw import raw_model
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.stored import as_stored
from jaxisp.gap.simulator.choices import unsampled
from jaxisp.io import open_dataset, read_raw
from jaxisp.io.datasets import Loaded
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, Phone

BORDER = 8
MOST_SHIFT = 2
SIDE, APART = 320, 512  # px of a crop, and between two
FOLDS = 4  # of eight pairs: two are left out at a time
THIRD_PARTY = ("fo_base", "rt_base")
INFINITE = "infinite_isp"
"""Frames of one sensor, 8 bits GRBG as PNG, black 12.5 of 255; the first outdoors is fitted."""
FITTED = "Outdoor1"

MUST: dict[str, tuple[str, str, float]] = {
    "iphone7": ("right half by the left's camera, and back [dB]", "at least", 33.5),
    "iphone7 tiles": ("held-out tiles [dB]", "at least", 39.0),
    "time": ("a 512x512 pair, whole process [s of CPU time]", "at most", 45.0),
    "other": ("scenes that were not fitted, below those that were [dB]", "at most", 1.0),
    "plain": ("the same, below the diagnosis' plain base [dB]", "at most", 0.0),
    "left_out": ("pairs left out, below the true parameters [dB]", "at most", 0.5),
    "libraw": ("a crop 512 px away [dB]", "at least", 36.0),
    "other raw": ("other RAW files of the camera [dB]", "at least", 36.0),
}
"""By what a case reports: what it is, and what it must reach."""


def runs(data: Path | None) -> dict[str, Run]:
    own: dict[str, Run] = {f"phone_{name}": partial(left_out, name, PHONES[name]) for name in DESIGNS}
    if data is None:
        return own
    frame, raws = data / "raw" / f"{FRAME}.raw", sorted((data / "raw").glob("*.dng"))
    frames = data / "raw" / INFINITE
    return (
        {"iphone7": partial(halves, data / "iphone7"), "iphone7_tiles": partial(tiles, data / "iphone7")}
        | {name: partial(other_scenes, data / "third_party" / name) for name in THIRD_PARTY}
        | {path.stem: partial(crops, path, i) for i, path in enumerate(raws)}
        | ({FRAME: partial(frame_crops, frame)} if frame.exists() else {})
        | ({INFINITE: partial(other_raws, frames)} if frames.exists() else {})
        | own
    )


def tiles(folder: Path) -> dict[str, Any]:
    """Held-out tiles of the whole pair, and CPU time: of a process of its own if it is the only case."""
    result = fitted_examples("tiles", [loaded_example(p) for p in _loaded(folder)])
    used = resource.getrusage(resource.RUSAGE_SELF)
    (pair,) = result.pairs
    return {
        "iphone7 tiles": [pair.held_out_psnr], "ssim": pair.held_out_ssim,
        "time": [used.ru_utime + used.ru_stime], "design": result.design,
    }  # fmt: skip


def halves(folder: Path) -> dict[str, Any]:
    """Each half of the pair fitted as a picture of its own, and the other developed."""
    (whole,) = [loaded_example(p) for p in _loaded(folder)]
    middle = whole.picture.shape[1] // 4 * 2
    sides = [part(whole, columns=slice(0, middle)), part(whole, columns=slice(middle, None))]
    found = [fitted_examples(f"half-{i}", [side]) for i, side in enumerate(sides)]
    return {
        "iphone7": [measured(f.camera, other) for f, other in zip(found, reversed(sides))],
        "own": [measured(f.camera, side) for f, side in zip(found, sides)],
        "design": [f.design for f in found],
    }


def other_scenes(folder: Path) -> dict[str, Any]:
    """Fitted to three scenes, measured on the other three; the diagnosis' plain base fitted to the same.

    The base is a picture before it is stored. It goes through the file's own encoder, as the camera's does.
    """
    pairs = _loaded(folder)
    count = len(pairs) // 2
    examples = [loaded_example(p) for p in pairs]
    result = fitted_examples(folder.name, examples[:count])
    own = [measured(result.camera, e) for e in examples]
    compared = raw_pairs(pairs)
    base = raw_model(pairs, compared, (), range(count))
    files = [p.jpeg for p in pairs]
    model, still = unsampled(base.model, files[0]), np.zeros(len(base.model.coordinates))
    done = PixelObjective.of(compared).rendered(model, still)
    plain = [best_psnr(as_stored(d, f), wanted) for d, f, wanted in zip(done, files, compared.pictures)]
    mean, apart = float(np.mean(own[count:])), float(np.mean(own[:count]))
    return {
        "other": [apart - mean],
        "plain": [float(np.mean(plain[count:])) - mean],
        "each": own, "plain_each": plain, "design": result.design, "unidentified": result.unidentified,
    }  # fmt: skip


def left_out(name: str, phone: Phone) -> dict[str, Any]:
    """Eight pairs by known parameters: those of a fold before the encoder, by the camera of the others.

    The true demosaicker and median are given: what the numbers lose is measured, not the choices.
    """
    with tempfile.TemporaryDirectory() as temporary:
        truth = known_pairs(Path(temporary), phone, DESIGNS[name], framed())
        loaded = open_dataset(temporary).pairs
        examples = [loaded_example(p.load()) for p in loaded]
        design = DESIGNS[name]
        settled = {"demosaic": design.demosaic, "median": design.median or "none"}
        below = []
        for fold in range(FOLDS):
            kept = [e for i, e in enumerate(examples) if i % FOLDS != fold]
            camera = fitted_examples(f"without-{fold}-{name}", kept, **settled).camera
            below += [developed(p, truth) - developed(p, camera) for p in loaded[fold::FOLDS]]
    return {"left_out": [float(np.mean(below))], "each": below}


def crops(path: Path, seed: int) -> dict[str, Any]:
    """LibRaw's picture of a RAW: a crop is fitted, and one far from it developed."""
    settings, picture = against(path, seed)
    raw = dataclasses.replace(read_raw(path), orientation=1)
    whole = Example(path.stem, raw, picture)
    places = [(0, 0), (0, SIDE + APART)]
    near, far = (part(whole, slice(y, y + SIDE), slice(x, x + SIDE)) for y, x in _centred(whole, places))
    result = fitted_examples(f"crop-{path.stem}", [near])
    return {
        "libraw": [measured(result.camera, far)],
        "own": [measured(result.camera, near)],
        "settings": settings, "design": result.design,
    }  # fmt: skip


def frame_crops(frame: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as temporary:
        return crops(framed_dng(frame, Path(temporary) / "frame.dng"), 200)


def other_raws(folder: Path) -> dict[str, Any]:
    """LibRaw's pictures of RAW files of one camera: the middle of one is fitted, that of others developed."""
    paths = sorted(folder.glob("*.png"), key=lambda path: not path.name.startswith(FITTED))
    with tempfile.TemporaryDirectory() as temporary:
        frames = [np.asarray(Image.open(path), np.uint16) * 16 for path in paths]
        dngs = [
            grey_dng(frame, "GRBG", 200, 255 * 16, Path(temporary) / f"{path.stem}.dng")
            for path, frame in zip(paths, frames)
        ]
        settings, first = against(dngs[0], 300)
        pictures = [first, *(developed_alike(dng, settings) for dng in dngs[1:])]
        middles = []
        for dng, picture in zip(dngs, pictures):
            whole = Example(dng.stem, read_raw(dng), picture)
            ((y, x),) = _centred(whole, [(0, 0)])
            middles.append(part(whole, slice(y, y + SIDE), slice(x, x + SIDE)))
    result = fitted_examples(INFINITE, middles[:1])
    return {
        "other raw": [measured(result.camera, middle) for middle in middles[1:]],
        "own": [measured(result.camera, middles[0])],
        "settings": settings, "design": result.design,
    }  # fmt: skip


def _centred(whole: Example, places: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Corners of crops, together in the middle of the picture, on whole cells of the mosaic."""
    spans = [max(p[axis] for p in places) + SIDE for axis in range(2)]
    first = [(n - span) // 4 * 2 for n, span in zip(whole.raw.mosaic.shape, spans)]
    return [(y + first[0], x + first[1]) for y, x in places]


def part(whole: Example, rows: slice = slice(None), columns: slice = slice(None)) -> Example:
    """A part as a picture of its own; rows and columns begin on even numbers, so that the mosaic's stay."""
    mosaic, picture = (np.ascontiguousarray(a[rows, columns]) for a in (whole.raw.mosaic, whole.picture))
    name = f"{whole.name} {rows.start or 0} {columns.start or 0}"
    return Example(name, dataclasses.replace(whole.raw, mosaic=mosaic), picture)


def loaded_example(pair: Loaded) -> Example:
    assert pair.raw is not None, "a raw+jpeg pair has one"
    return Example(pair.name, pair.raw, pair.picture, pair.jpeg)


def _loaded(folder: Path) -> list[Loaded]:
    return [p.load() for p in open_dataset(folder).pairs]


def measured(camera: Recipe, example: Example) -> float:
    """PSNR of what a camera makes of a RAW, against its picture [dB]."""
    return best_psnr(develop(dataclasses.replace(example.raw, orientation=1), camera), example.picture)


def best_psnr(done: np.ndarray, wanted: np.ndarray) -> float:
    """At the best shift by whole pixels: pictures of one size, borders left out [dB]."""
    inner = slice(BORDER, -BORDER)
    shifts = range(-MOST_SHIFT, MOST_SHIFT + 1)
    moved = (np.roll(done, (y, x), (0, 1))[inner, inner] for y in shifts for x in shifts)
    return float(-10 * np.log10(min(np.mean((m - wanted[inner, inner]) ** 2) for m in moved)))


def page(cases: Cases) -> list[str]:
    lines = [
        "## Pictures that were not fitted",
        "",
        f"`python -m experiments.fit_phones DATA --only scenes:CASE`. {__doc__.splitlines()[2]} "
        f"A phone's eight pairs are left out in {FOLDS} groups of two (seed {SEED}).",
        "",
        "| case | figure | must | measured | reached |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, case in cases.items():
        for key, (text, way, limit) in MUST.items():
            if key in case:
                values = case[key]
                good = all(v >= limit if way == "at least" else v <= limit for v in values)
                told, reached = ", ".join(f"{v:.2f}" for v in values), "yes" if good else "**no**"
                lines.append(f"| {name} | {text} | {way} {limit:g} | {told} | {reached} |")
    wanted = ("iphone7", "iphone7_tiles", *THIRD_PARTY, FRAME, INFINITE)
    missing = [name for name in wanted if name not in cases]
    missing += [f"phone_{name}" for name in DESIGNS if f"phone_{name}" not in cases]
    return [*lines, "", f"Not measured yet: {', '.join(missing) or 'none'}."]
