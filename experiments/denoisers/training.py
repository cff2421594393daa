"""Runs that differ in nothing but the recipe and the seed, and the photographs that they learn from."""

import dataclasses
from pathlib import Path
from typing import Any

from jaxisp.data import downsample_linear
from jaxisp.fit import fit_dataset, prior_from_cameras
from jaxisp.io import read_image, write_png
from jaxisp.recipe import Recipe
from jaxisp.recipes import find_recipe
from jaxisp.train import Denoiser, TrainConfig, load_denoiser, train

FITTED = "phone-fitted"
"""`phone` with the ranges of a camera that was fitted to the real RAW+JPEG pair."""

SCALES: dict[str, dict[str, Any]] = {
    # Half an hour each on one core, beside another.
    "cpu": {
        "model": "unet", "steps": 20_000, "batch": 6, "patch": 80, "downsample": 1, "per_image": 20,
        "held_out": 6, "validation": 64, "checkpoint_every": 500,
    },
    # Jaroensri et al. 2019: N3Net as they used it, 100 epochs of 25,000 patches, linear light.
    "paper": {
        "model": "n3net-stripped", "steps": 78125, "batch": 32, "patch": 80, "downsample": 4,
        "per_image": 5, "fresh_crops": False, "optimizer": "amsgrad", "weight_decay": 1e-4,
        "schedule": "staircase", "warmup": 0, "clip_norm": 0.0, "loss": "smooth_l1", "light": "linear",
        "checkpoint_every": 2000,
    },
}  # fmt: skip

SHRUNK = {"photos": 4, "kodak": 2, "cbsd68": 2}
"""Folders of DATA/clean and by how much their pictures are made smaller."""
TEST_PICTURES = ("kodim04", "kodim09", "kodim17")
"""Pictures that no network sees in training: simulated test sets are made of them."""


@dataclasses.dataclass(frozen=True)
class Place:
    """Where things are: the data, the folder for runs, and further clean photographs for a large run."""

    data: Path
    work: Path
    clean: tuple[str, ...] = ()


def pictures(place: Place, which: str) -> Path:
    """A folder of clean pictures made smaller, "train" or "test"; written at the first call."""
    root = place.work / "clean"
    if not (root / "done").exists():
        for name, factor in SHRUNK.items():
            for path in sorted((place.data / "clean" / name).iterdir()):
                folder = root / ("test" if path.stem in TEST_PICTURES else "train")
                folder.mkdir(parents=True, exist_ok=True)
                write_png(folder / f"{name}_{path.stem}.png", downsample_linear(read_image(path), factor))
        (root / "done").touch()
    return root / which


def recipe_named(place: Place, name: str) -> Recipe:
    """A built-in recipe, or the one of the fitted camera, which is fitted at the first call."""
    if name != FITTED:
        return find_recipe(name)
    camera = place.work / "iphone7.toml"
    if not camera.exists():
        fit_dataset(place.data / "iphone7").camera.save(camera)
    return prior_from_cameras([camera], name=FITTED)


def configuration(place: Place, scale: str, recipe: str, seed: int, **changes: Any) -> TrainConfig:
    """A run's configuration; all recipes of a scale share everything else."""
    clean = place.clean or (str(pictures(place, "train")),)
    return TrainConfig(clean=clean, recipe=recipe, seed=seed, **{**SCALES[scale], **changes})


def trained(place: Place, scale: str, recipe: str, seed: int, **changes: Any) -> tuple[str, Denoiser]:
    """The name of a run and its network, after training what is left of it."""
    config = configuration(place, scale, recipe, seed, **changes)
    name = f"{recipe}-{scale}-{config.model}-{config.steps}-{config.light}-{seed}"
    run = place.work / name
    result = train(
        config,
        run,
        recipe=recipe_named(place, recipe),
        resume=True,
        tick=lambda done, total, text: (
            print(f"{name}: {done}/{total} {text}", flush=True) if "loss" in text else None
        ),
    )
    if not result.finished:
        raise SystemExit(f"{run}: stopped at step {result.step}; the same command goes on")
    return name, load_denoiser(run, "last")[0]
