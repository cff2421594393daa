"""Training that goes on from a network for all cameras, on the recipe of one."""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.checks import several
from jaxisp.data.clean import downsample_linear
from jaxisp.errors import InputError
from jaxisp.io.files import find_images, output_folder
from jaxisp.io.images import read_image, write_png
from jaxisp.models import read_network
from jaxisp.models.apply import SHIPPED, Denoiser
from jaxisp.recipes import RecipeLike, find_degradation
from jaxisp.train.config import TrainConfig
from jaxisp.train.folder import CONFIG, load_settings
from jaxisp.train.trainer import TrainResult, train

PATCH = 64
"""Side of the patches that are learned from [px]."""
KEPT = 0.5
"""Share that the weights to begin with have in the averaged ones at the end. A few pictures teach some things
wrongly: the mean loses less by these than the last weights, and may gain less (Wortsman et al., "Robust
fine-tuning of zero-shot models", 2022). Chosen on cameras of other programs."""


@contextlib.contextmanager
def beginning(start: str | Path | None = None) -> Iterator[tuple[Path, dict[str, Any]]]:
    """The file of the network that training goes on from, and what is kept with its weights.

    Args:
        start: a file of weights; those that come with the package unless given.

    Raises:
        InputError: there are no weights, or the file holds no network.
    """
    with contextlib.ExitStack() as stack:
        if start is None:
            shipped = resources.files("jaxisp.models") / SHIPPED
            if not shipped.is_file():
                raise InputError("no network comes with this jaxisp: give the weights of one to begin with")
            start = stack.enter_context(resources.as_file(shipped))
        yield Path(start), read_network(start)[1]


def clean_from(
    noisy: str | Path | Sequence[str | Path],
    folder: str | Path,
    *,
    start: str | Path | None = None,
    downsample: int = 3,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> list[str]:
    """Clean pictures made of noisy ones: each made smaller, which takes a part of its noise, and denoised.

    Without the second a network learns that what is left of strong noise is to be left.

    Args:
        noisy: pictures, and folders of them; clean ones of pairs are passed over.
        folder: where they are written, as PNG.
        start: a file of weights; those that come with the package unless given.
        downsample: the factor by which pictures are made smaller; those of less than a patch are left out.
        tick: called with (done, total, text).

    Returns:
        the folder, in a list; an empty list where no picture is large enough.

    Raises:
        InputError: there are no weights or no pictures, or something else stands in the folder.
    """
    with beginning(start) as (file, about):
        denoiser = Denoiser(read_network(file)[0], about.get("light", "encoded"))
    paths, count = find_images(noisy, recursive=True), 0
    for i, path in enumerate(paths):
        tick(i, len(paths), "making clean pictures")
        if path.stem.lower().endswith(".clean"):
            continue
        try:
            small = downsample_linear(read_image(path), downsample)
        except InputError:
            continue  # `adapt` has told it
        if min(small.shape[:2]) >= PATCH:
            target = output_folder(folder) / f"{i:05d}.png"
            _keep(target, np.rint(255 * denoiser(small)).astype(np.uint8))
            count += 1
    return [str(folder)] if count else []


def _keep(path: Path, levels: np.ndarray) -> None:
    """Write a picture where there is none; InputError where there is another."""
    if not os.path.lexists(path):
        write_png(path, levels)
    elif not np.array_equal(np.rint(255 * read_image(path)), levels):
        raise InputError(f"{path}: stands there already and would be replaced; choose another folder")


def fine_tune(
    recipe: RecipeLike,
    clean: str | Path | Sequence[str | Path],
    run: str | Path,
    *,
    start: str | Path | None = None,
    downsample: int = 3,
    drawn: int = 0,
    steps: int = 2000,
    seed: int = 0,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> TrainResult:
    """Train a network further on the recipe of one camera; resumed where it was stopped.

    Args:
        recipe: as `jaxisp.adapt` narrows one.
        clean: folders of photographs, which are made smaller; none where pictures are drawn.
        run: the folder of the run.
        start: a file of weights; those that come with the package unless given.
        downsample: the factor by which photographs are made smaller.
        drawn: pictures that are drawn and used beside them: what a few photographs lack.
        steps: updates of 16 patches of 64 px; a run that was begun with another number is refused.
        seed: of everything that is drawn.
        tick: called with (done, total, text).

    Raises:
        InputError: there are no weights to begin with, the run was begun with another number of steps, or
            `train` raises it.
    """
    if (Path(run) / CONFIG).exists() and (begun := load_settings(run)[0].steps) != steps:
        raise InputError(
            f"{run}: was begun with {begun} steps, which decide its average, cannot go on with {steps}"
        )
    found = find_degradation(recipe)
    name = str(recipe) if isinstance(recipe, str | Path) else found.name
    with beginning(start) as (begin, about):
        config = TrainConfig(
            clean=tuple(map(str, several(clean))), recipe=name, model=about["model"],
            model_options=about["options"], light=about.get("light", "encoded"),
            start=str(begin), downsample=downsample, drawn=drawn, steps=steps, seed=seed, batch=16,
            patch=PATCH, per_image=20, target="camera", loss="log_rms", lr=3e-4, ema=KEPT ** (1 / steps),
            pool=min(8192, 16 * steps),
        )  # fmt: skip
        return train(config, run, recipe=found, resume=True, tick=tick)
