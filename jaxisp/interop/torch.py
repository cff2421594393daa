"""PyTorch: clean patches that workers cut, degraded batches as tensors that share JAX's memory.

JAX runs in the main process alone, so that no worker is forked from it. Workers cut patches with NumPy.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import jax
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset, get_worker_info

from jaxisp.data import Batches, CleanPatches
from jaxisp.data.sources import degrade_key
from jaxisp.errors import InputError
from jaxisp.recipes import RecipeLike, find_degradation

Pair = tuple[torch.Tensor, torch.Tensor]


def to_torch(images: jax.Array) -> torch.Tensor:
    """(N, H, W, 3) of JAX as an (N, 3, H, W) tensor on the same device, without a copy.

    The tensor is a view of JAX's memory in the layout channels_last: do not write into it.
    """
    return torch.from_dlpack(images).permute(0, 3, 1, 2)


def from_torch(images: torch.Tensor) -> jax.Array:
    """(N, 3, H, W) of PyTorch as (N, H, W, 3) of JAX on the same device.

    Without a copy where the tensor is in the layout channels_last and lies as JAX needs it.

    Raises:
        InputError: not such a tensor of float32.
    """
    if images.ndim != 4 or images.shape[1] != 3 or images.dtype != torch.float32:
        got = f"{images.dtype} {tuple(images.shape)}"
        raise InputError(f"a recipe takes (N, 3, H, W) tensors of float32 in [0, 1], got {got}")
    return jax.dlpack.from_dlpack(images.detach().permute(0, 2, 3, 1).contiguous())


class DegradedBatches(IterableDataset):  # type: ignore[misc, type-arg, unused-ignore]
    """(noisy, clean) tensors without end, cut and degraded ahead in the main process; see
    `jaxisp.data.Batches`.

    Give it to `DataLoader(dataset, batch_size=None)`, without workers: the next batch is computed on the
    device while the one before it is used.

    Args:
        source: clean patches by global index.
        recipe: takes and gives encoded sRGB: a recipe, a mixture, a chain, a name, or a TOML file.
        **options: those of `jaxisp.data.Batches`: batch, seed, start, ahead, mesh.
    """

    def __init__(self, source: CleanPatches, recipe: RecipeLike, **options: Any) -> None:
        self.source, self.recipe, self.options = source, find_degradation(recipe), options

    def __iter__(self) -> Iterator[Pair]:
        if get_worker_info() is not None:
            raise InputError(
                "DegradedBatches runs JAX in the main process: give num_workers=0, or CleanDataset to the "
                "workers and their loader to degraded"
            )
        with Batches(self.source, self.recipe, **self.options) as batches:
            for noisy, clean in batches:
                yield to_torch(noisy), to_torch(clean)


class CleanDataset(Dataset):  # type: ignore[misc, type-arg, unused-ignore]
    """Clean patches with their global indices: {"clean": (3, size, size) float32, "index"}. Runs no JAX.

    Args:
        patches: the photographs' patches.
        epochs: `len` is this many; each has other crops.
        start: global index of the first, to go on where a run stopped.
    """

    def __init__(self, patches: CleanPatches, epochs: int = 1, start: int = 0) -> None:
        self.patches, self.epochs, self.start = patches, epochs, start

    def __len__(self) -> int:
        return len(self.patches) * self.epochs

    def __getitem__(self, index: int) -> dict[str, Any]:
        if not 0 <= index < len(self):
            raise IndexError(index)
        patch = self.patches.sample(self.start + index)
        return {"clean": torch.from_numpy(patch).permute(2, 0, 1), "index": self.start + index}


def loader(dataset: CleanDataset, **options: Any) -> Any:
    """A `DataLoader` whose workers, if any, are spawned: a fork of a process that runs JAX may hang."""
    if options.get("num_workers"):
        options = {"multiprocessing_context": "spawn", "persistent_workers": True} | options
    return DataLoader(dataset, **options)


def degraded(batches: Iterable[dict[str, torch.Tensor]], recipe: RecipeLike, seed: int = 0) -> Iterator[Pair]:
    """(noisy, clean) of each batch of a loader of `CleanDataset`, degraded in this process.

    Sample i has the bits that `jaxisp.data.Batches` gives for that index, in whatever order they come.

    Args:
        batches: dicts of "clean" (N, 3, H, W) and "index" (N,).
        recipe: as that of `DegradedBatches`.
        seed: of the degradation.

    Yields:
        tensors (N, 3, H, W) float32 on JAX's device.
    """
    key, recipe = degrade_key(seed), find_degradation(recipe)
    for batch in batches:
        indices = np.asarray(batch["index"], np.int32)
        noisy, clean, _ = recipe.degrade(key, from_torch(batch["clean"]), indices)
        yield to_torch(noisy), to_torch(clean)
