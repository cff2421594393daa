"""Degrade files: clean photographs in, a clean+noisy data set out, each image with its parameters."""

import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomli_w

from jaxisp.errors import InputError
from jaxisp.io.files import atomic_write, find_images, output_folder
from jaxisp.io.images import read_image, write_png
from jaxisp.recipe import Recipe

BATCH_PIXELS = 2_000_000
"""Pixels that go to the device at once; bounds the memory of a run."""


@dataclasses.dataclass
class Outcome:
    """What a run did, and the inputs that it could not use."""

    images: int = 0
    seconds: float = 0.0
    failed: list[tuple[str, str]] = dataclasses.field(default_factory=list)

    @property
    def images_per_second(self) -> float:
        return self.images / max(self.seconds, 1e-9)

    def as_dict(self) -> dict[str, Any]:
        return {
            "images": self.images,
            "images_per_second": round(self.images_per_second, 3),
            "seconds": round(self.seconds, 3),
            "failed": [{"file": name, "reason": reason} for name, reason in self.failed],
        }


@dataclasses.dataclass(frozen=True)
class _Job:
    """One input: its name in the output, its pixels, the global index of its first version."""

    stem: str
    path: Path
    image: np.ndarray
    index: int


def degrade_files(
    inputs: Sequence[str | Path],
    out: str | Path,
    recipe: Recipe,
    *,
    count: int = 1,
    seed: int = 0,
    start: int = 0,
    tick: Callable[[int, int], Any] = lambda done, total: None,
) -> Outcome:
    """Write `STEM_000.clean.png`, `STEM_000.noisy.png` and `STEM_000.toml` for each version of each image.

    The TOML file is a recipe that holds the drawn parameters; with the seed and the index in it,
    `jaxisp degrade IMAGE --recipe STEM_000.toml --seed S --start I` makes the same image again.

    Args:
        inputs: images and folders of images.
        out: the folder, made where it is missing.
        recipe: takes and gives encoded sRGB.
        count: versions of each image; version j of input i has the index start + i * count + j.
        seed: of the root key.
        start: index of the first version.
        tick: called with (done, total).

    Returns:
        What was done; inputs that cannot be read are listed in `failed` and the rest goes on.

    Raises:
        InputError: no input, a recipe for other domains, or the folder cannot be written.
    """
    if recipe.chain.domain_in.channels != 3 or recipe.chain.domain_out.channels != 3:
        raise InputError(f"recipe {recipe.name!r} takes {recipe.chain.domain_in.name}, not photographs")
    paths, out = find_images(inputs), output_folder(out)
    outcome, clock = Outcome(), time.perf_counter()
    key = jax.random.key(seed)
    for jobs in _batches(paths, count, start, outcome):
        images = np.stack([job.image for job in jobs])
        noisy, _, params = jax.device_get(_degrade_jobs(recipe, key, images, jobs))
        for i, job in enumerate(jobs):
            drawn = jax.tree.map(lambda leaf, i=i: leaf[i], params)
            _write(out, job, noisy[i], recipe, drawn, seed)
            outcome.images += 1
            tick(outcome.images, len(paths) * count)
    outcome.seconds = time.perf_counter() - clock
    if outcome.images:
        with atomic_write(out / "dataset.toml") as file:
            file.write(tomli_w.dumps({"camera": f"jaxisp {recipe.name}", "clean_encoding": "srgb"}).encode())
    return outcome


def _degrade_jobs(recipe: Recipe, key: jax.Array, images: np.ndarray, jobs: list[_Job]) -> Any:
    return recipe.degrade(key, images, np.asarray([job.index for job in jobs], np.int32))


def _batches(paths: Sequence[Path], count: int, start: int, outcome: Outcome) -> Iterator[list[_Job]]:
    """Versions of one size together, so that a size is compiled once; the last batch may be smaller."""
    waiting: dict[tuple[int, ...], list[_Job]] = defaultdict(list)
    seen: dict[str, Path] = {}
    for i, path in enumerate(paths):
        try:
            if path.stem in seen:
                raise InputError(f"{path}: {seen[path.stem]} has the same name, which outputs would share")
            seen[path.stem] = path
            image = read_image(path)
        except InputError as error:
            outcome.failed.append((str(path), str(error)))
            continue
        size = max(1, BATCH_PIXELS // (image.shape[0] * image.shape[1]))
        for j in range(count):
            jobs = waiting[image.shape]
            jobs.append(_Job(f"{path.stem}_{j:03d}", path, image, start + i * count + j))
            if len(jobs) == size:
                yield waiting.pop(image.shape)
    yield from waiting.values()


def _write(
    out: Path, job: _Job, noisy: np.ndarray, recipe: Recipe, params: dict[str, Any], seed: int
) -> None:
    sample = {"source": job.path.name, "recipe": recipe.name, "seed": seed, "index": job.index}
    drawn = Recipe(recipe.chain, params, f"the parameters drawn for {job.stem}", {"sample": sample})
    write_png(out / f"{job.stem}.clean.png", job.image)
    write_png(out / f"{job.stem}.noisy.png", noisy)
    drawn.save(out / f"{job.stem}.toml")
