"""Degrade files: clean photographs in, a clean+noisy data set out, each image with its parameters."""

import dataclasses
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w

from jaxisp.checks import several
from jaxisp.data.work import Degraded, Outcome, Sample, Tick, Work
from jaxisp.errors import InputError
from jaxisp.io.digests import digest_of, is_file_of, read_sealed, sealed_toml
from jaxisp.io.files import (
    check_new,
    check_output,
    filled_folder,
    parse_toml,
    read_text,
    real_paths,
    write_new,
    write_text,
)
from jaxisp.io.images import write_png
from jaxisp.io.locks import locked
from jaxisp.recipes import RecipeLike

_CAMERA = "jaxisp "
_ENDS = (".clean.png", ".noisy.png", ".toml")


def degrade_files(
    inputs: Sequence[str | Path],
    out: str | Path,
    recipe: RecipeLike,
    *,
    count: int = 1,
    seed: int = 0,
    start: int = 0,
    resume: bool = False,
    tick: Tick = lambda done, total: None,
) -> Outcome:
    """Write `STEM_000.clean.png`, `STEM_000.noisy.png` and `STEM_000.toml` for each version of each image.

    The TOML file is a recipe that holds the drawn parameters; with the seed and the index in it,
    `jaxisp degrade IMAGE --recipe STEM_000.toml --seed S --start I` makes the same image again.

    A folder holds one data set. A later run adds to it or writes it again with the same recipe and seed, and
    not fewer versions; another is refused, and nothing changes.

    Args:
        inputs: images and folders of images.
        out: the folder, made where it is missing.
        recipe: as that of `Work`.
        count: versions of each image; version j of input i has the index start + i * count + j.
        seed: of the root key.
        start: index of the first version.
        resume: leave out the samples that a run with the same arguments has written, where neither they nor
            their photograph have changed since.
        tick: called with (done, total).

    Returns:
        What was done; inputs that cannot be read are listed in `failed` and the rest goes on.

    Raises:
        InputError: no input, a recipe for other domains, the folder is an input, cannot be written, holds
            samples of another run or a dataset.toml that no run wrote, or another process writes into it.
    """
    work, out = Work(inputs, recipe, count, seed, start), Path(out)
    outcome, clock = Outcome(), time.perf_counter()
    about = tomli_w.dumps({"camera": f"{_CAMERA}{work.degradation.name}", "clean_encoding": "srgb"})
    if os.path.realpath(out) in real_paths(several(inputs)):
        raise InputError(f"{out}: is an input too, so that results would be inputs next time; choose another")
    _check_same_run(out, work, about)
    with filled_folder(out, keep=False), locked(out):
        _check_same_run(out, work, about)  # of what another process wrote before it was locked

        def done(sample: Sample) -> bool:
            return resume and is_written(out, sample, work.note(sample))

        for degraded in work.run(range(len(work)), outcome, done):
            try:
                for end in _ENDS:
                    check_output(out / f"{degraded.sample.stem}{end}", work.inputs_real)
            except InputError as error:
                outcome.failed.append((str(degraded.sample.path), str(error)))
                continue
            _write(out, degraded)
            outcome.images += 1
            tick(outcome.images + outcome.kept, len(work))
        if outcome.images or outcome.kept:
            write_new(out / "dataset.toml", about)
    outcome.seconds = time.perf_counter() - clock
    return outcome


def _check_same_run(out: Path, work: Work, about: str) -> None:
    """Raise InputError where a folder holds samples of a run with other settings: none could be told from
    those of this one by who reads the folder."""
    here = f"this run is of {work.degradation.name!r}, seed {work.seed}"
    do = "choose another folder, or empty this one"
    dataset = out / "dataset.toml"
    if os.path.lexists(dataset) and (name := _recipe_of(read_text(dataset))) not in (
        None,
        work.degradation.name,
    ):
        raise InputError(f"{out}: holds a data set of the recipe {name!r}, and {here}; {do}")
    check_new(dataset, about)
    if not out.is_dir():
        return
    if before := _some_sample(out):
        own = (before["recipe"], before["recipe_sha256"], before["seed"])
        if own != (work.degradation.name, work.digest, work.seed):
            other = "other numbers of " if own[0] == work.degradation.name and own[1] != work.digest else ""
            raise InputError(
                f"{out}: holds samples of {other}the recipe {own[0]!r}, seed {own[2]}, and {here}; {do}"
            )
    for path in work.paths:
        if os.path.lexists(out / f"{path.stem}_{work.count:03d}.toml"):
            raise InputError(f"{out}: holds more than {work.count} versions of {path.stem}; {do}")


def _recipe_of(dataset: str) -> str | None:
    """The recipe that a dataset.toml of this module names; None where it is another's."""
    try:
        table = parse_toml(dataset, "dataset.toml")
    except InputError:
        return None
    camera = str(table.get("camera"))
    ours = table.keys() == {"camera", "clean_encoding"} and camera.startswith(_CAMERA)
    return camera.removeprefix(_CAMERA) if ours else None


def _some_sample(out: Path) -> dict[str, Any] | None:
    """What a sample in a folder says of its run; all of them are of one."""
    with os.scandir(out) as entries:
        for entry in entries:
            if entry.name.endswith(".toml") and (meta := _meta(Path(entry.path))):
                sample = meta.get("sample")
                if isinstance(sample, dict) and sample.keys() >= {"recipe", "recipe_sha256", "seed"}:
                    return sample
    return None


def _meta(path: Path) -> dict[str, Any]:
    """What a sample's TOML file says of it; {} where it is none, or damaged."""
    try:
        meta = parse_toml(read_sealed(path), str(path)).get("meta", {})
    except InputError:
        return {}
    return meta if isinstance(meta, dict) else {}


def _write(out: Path, degraded: Degraded) -> None:
    """The three files; the TOML file is the last, so where it stands the sample is whole."""
    stem, digests = degraded.sample.stem, {}
    (out / f"{stem}.toml").unlink(missing_ok=True)  # of a run before this one
    for kind in ("clean", "noisy"):
        write_png(out / f"{stem}.{kind}.png", getattr(degraded, kind))
        digests[kind] = digest_of(out / f"{stem}.{kind}.png")
    told = dataclasses.replace(degraded.drawn, meta={**degraded.drawn.meta, "sha256": digests})
    write_text(out / f"{stem}.toml", sealed_toml(told.to_toml()))


def is_written(out: Path, sample: Sample, note: dict[str, Any]) -> bool:
    """Whether a sample's three files are, to the bit, what was written for the same arguments."""
    meta = _meta(out / f"{sample.stem}.toml")
    digests = meta.get("sha256")
    if not isinstance(digests, dict) or set(digests) != {"clean", "noisy"} or meta.get("sample") != note:
        return False
    return all(is_file_of(out / f"{sample.stem}.{kind}.png", digest) for kind, digest in digests.items())
