"""Patches by index: what a patch shows follows from its index and the seed alone, in any order."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxisp.checks import check_whole
from jaxisp.data.clean import CleanImages, load_clean
from jaxisp.errors import InputError, short
from jaxisp.recipes import RecipeLike, find_degradation


class CleanPatches:
    """Random crops of clean photographs, flipped and turned: a `grain.sources.RandomAccessDataSource`.

    One epoch has `per_image` crops of each photograph. `len` is one epoch; `sample` takes any global
    index, each epoch in another order and, with `fresh`, from other places.

    Args:
        images: the photographs.
        size: of a patch [px].
        per_image: crops of each photograph in an epoch.
        seed: of order, place and turn.
        fresh: new crops in each epoch; False: the same ones, as in Jaroensri et al. 2019.
        augment: flip and turn by right angles.
    """

    def __init__(
        self,
        images: CleanImages,
        size: int = 80,
        *,
        per_image: int = 5,
        seed: int = 0,
        fresh: bool = True,
        augment: bool = True,
    ) -> None:
        if not hasattr(images, "images"):
            raise InputError(
                f"CleanPatches takes what load_clean(FOLDER, patch={short(size)}) reads, got {short(images)}"
            )
        check_whole("size", size, 1)
        check_whole("per_image", per_image, 1)
        self.images, self.size, self.per_image = images, size, per_image
        self.seed, self.fresh, self.augment = seed, fresh, augment
        self._epoch = (-1, np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.images.images) * self.per_image

    def __repr__(self) -> str:
        """Grain identifies a source by this when it resumes."""
        return (
            f"CleanPatches({len(self.images.images)} photographs, size={self.size}, "
            f"per_image={self.per_image}, seed={self.seed}, fresh={self.fresh}, augment={self.augment})"
        )

    def __getitem__(self, index: Any) -> np.ndarray:
        """Patch `index` of the first epoch, in the order of the photographs: (size, size, 3) float32."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self._patch(int(index), 0)

    def sample(self, index: int) -> np.ndarray:
        """The patch with a global index, 0 and up: (size, size, 3) float32 encoded sRGB."""
        epoch, position = divmod(int(index), len(self))
        if self._epoch[0] != epoch:
            self._epoch = (epoch, np.random.default_rng((self.seed, 1, epoch)).permutation(len(self)))
        return self._patch(int(self._epoch[1][position]), epoch)

    def batch(self, indices: Any) -> np.ndarray:
        """(N, size, size, 3) of global indices."""
        return np.stack([self.sample(i) for i in indices])

    def _patch(self, slot: int, epoch: int) -> np.ndarray:
        rng = np.random.default_rng((self.seed, 2, slot, epoch if self.fresh else 0))
        image = self.images.images[slot // self.per_image]
        if image.ndim == 4:  # kept as crops
            image = image[slot % len(image)]
        y, x = (rng.integers(0, n - self.size + 1) for n in image.shape[:2])
        patch = image[y : y + self.size, x : x + self.size]
        if self.augment:
            patch = np.rot90(patch, int(rng.integers(4)))
            patch = patch[:, ::-1] if rng.integers(2) else patch
        return patch.astype(np.float32) / np.float32(65535)


class DegradedBatches:
    """Batches of (noisy, clean), degraded with fresh parameters an image: a grain source.

    Sample i of batch b has the global index b * batch + i: its noise and parameters are those that the
    trainer would draw for it.

    Args:
        patches: the clean ones.
        recipe: takes and gives encoded sRGB: a recipe, a mixture, a chain, a name, or a TOML file.
        batch: patches in a batch.
        seed: of the degradation.
        epochs: `len` is this many.
    """

    def __init__(
        self, patches: CleanPatches, recipe: RecipeLike, *, batch: int = 32, seed: int = 0, epochs: int = 1
    ) -> None:
        check_source("DegradedBatches", patches, batch)
        self.patches, self.recipe = patches, find_degradation(recipe)
        self.batch, self.seed, self.epochs = batch, seed, epochs

    def __len__(self) -> int:
        return len(self.patches) * self.epochs // self.batch

    def __repr__(self) -> str:
        return f"DegradedBatches({self.patches!r}, {self.recipe.name}, batch={self.batch}, seed={self.seed})"

    def __getitem__(self, index: Any) -> dict[str, np.ndarray]:
        """{"noisy", "clean"}, (batch, size, size, 3) float32 encoded sRGB each."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        start = int(index) * self.batch
        clean = self.patches.batch(range(start, start + self.batch))
        noisy, _, _ = self.recipe.degrade(degrade_key(self.seed), clean, start)
        return {"noisy": np.asarray(noisy), "clean": clean}


def check_source(who: str, source: Any, batch: Any) -> None:
    """Raise InputError where what gives clean patches, or the size of a batch, is none."""
    if not hasattr(source, "batch"):
        raise InputError(
            f"{who} takes what has batch(indices), as CleanPatches, got {short(source)}; "
            "of a folder jaxisp.data.batches makes batches"
        )
    check_whole("batch", batch, 1)


def degrade_key(seed: int) -> jax.Array:
    """The root key of all degradation in a run."""
    return jax.random.fold_in(jax.random.key(seed), 0)


def patches(
    folder: str | Path | Sequence[str | Path],
    size: int = 80,
    *,
    batch: int = 32,
    downsample: int = 4,
    per_image: int = 5,
    seed: int = 0,
    start: int = 0,
) -> Iterator[np.ndarray]:
    """Batches of clean patches of the photographs in a folder, without end.

    Args:
        folder: photographs, also in folders below; or several.
        size: of a patch [px].
        batch: patches in a batch.
        downsample: photographs are made smaller by this factor first, in linear light.
        per_image: patches of each photograph in an epoch.
        seed: of what is drawn.
        start: batches to leave out, to go on where another iterator stopped.

    Yields:
        (batch, size, size, 3) float32 encoded sRGB.

    Raises:
        InputError: no photograph that can be used.
    """
    check_whole("batch", batch, 1)
    check_whole("start", start, 0)
    images = load_clean(folder, patch=size, downsample=downsample, per_image=per_image, seed=seed)
    source = CleanPatches(images, size, per_image=per_image, seed=seed)
    return _batches(source, batch, start)


def _batches(source: CleanPatches, batch: int, start: int) -> Iterator[np.ndarray]:
    while True:
        yield source.batch(range(start * batch, (start + 1) * batch))
        start += 1
