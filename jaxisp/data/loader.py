"""Batches for training loops: degraded on the device while the next ones are cut and sent there."""

import collections
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.checks import check_whole
from jaxisp.data.clean import load_clean
from jaxisp.data.sources import CleanPatches, check_source, degrade_key
from jaxisp.recipe import check_levels
from jaxisp.recipes import RecipeLike, find_degradation

Pair = tuple[jax.Array, jax.Array]


class Source(Protocol):
    """Clean patches by global index, as `CleanPatches`."""

    def batch(self, indices: Any) -> np.ndarray: ...


class Batches:
    """(noisy, clean) batches without end, (batch, size, size, 3) float32 encoded sRGB on the device.

    A thread cuts the patches `ahead` batches before they are needed and sends them to the device; one batch
    is being degraded while the one before it is used. Batch b has the samples b * batch and on, with the
    parameters and noise that the trainer and `DegradedBatches` draw for them.

    Args:
        source: the clean patches.
        recipe: takes and gives encoded sRGB: a recipe, a mixture, a chain, a name, or a TOML file.
        batch: patches in a batch, over all devices.
        seed: of the degradation.
        start: batches to leave out, to go on where another stopped.
        ahead: batches that wait on the device.
        mesh: devices that a batch is spread over, along the mesh's first axis; each process cuts the
            patches of its own devices. One device unless given.

    Close it, or use it in a `with`, to end the thread.
    """

    def __init__(
        self,
        source: Source,
        recipe: RecipeLike,
        *,
        batch: int = 32,
        seed: int = 0,
        start: int = 0,
        ahead: int = 2,
        mesh: Mesh | None = None,
    ) -> None:
        check_source("Batches", source, batch)
        check_whole("start", start, 0)
        self.source, self.batch, self.mesh = source, batch, mesh
        self.next, self._loading = start, start  # the batch that comes next, and that is cut next
        degrade = degrader(recipe, degrade_key(seed), mesh)
        self._degrade = jax.jit(degrade)  # traced: levels are checked on the host, where nothing waits for it
        self._pool = ThreadPoolExecutor(1, "jaxisp-batches")
        self._waiting: collections.deque[Future[tuple[jax.Array, jax.Array]]] = collections.deque()
        for _ in range(max(1, ahead)):
            self._load_one()
        self._ready: Pair | None = None

    def __iter__(self) -> "Batches":
        return self

    def __next__(self) -> Pair:
        current = self._dispatch() if self._ready is None else self._ready
        self._ready = self._dispatch()
        self.next += 1
        return current

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> "Batches":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _dispatch(self) -> Pair:
        """Ask for a degraded batch; it is computed while Python goes on."""
        clean, indices = self._waiting.popleft().result()
        self._load_one()
        return self._degrade(clean, indices), clean

    def _load_one(self) -> None:
        first = self._loading * self.batch
        self._waiting.append(self._pool.submit(self._load, range(first, first + self.batch)))
        self._loading += 1

    def _cut(self, indices: range) -> np.ndarray:
        clean = self.source.batch(indices)
        check_levels(clean, "a batch")
        return clean

    def _load(self, indices: range) -> tuple[jax.Array, jax.Array]:
        numbers = np.asarray(indices, np.int32)
        if self.mesh is None:
            return jax.device_put(self._cut(indices)), jax.device_put(numbers)
        rows = NamedSharding(self.mesh, PartitionSpec(self.mesh.axis_names[0]))
        own = rows.addressable_devices_indices_map((self.batch,))
        parts = [
            jax.device_put(self._cut(indices[place[0]]), device)
            for device, place in own.items()
            if place is not None
        ]
        shape = (self.batch, *parts[0].shape[1:])
        clean = jax.make_array_from_single_device_arrays(shape, rows, parts)
        return clean, jax.make_array_from_callback(numbers.shape, rows, lambda place: numbers[place])


def degrader(
    recipe: RecipeLike, key: jax.Array, mesh: Mesh | None = None
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """`(clean, indices) -> noisy`; over a mesh each device degrades its own rows of the batch.

    The bits of a sample are the same on any number of devices.
    """
    found = find_degradation(recipe)

    def degrade(clean: jax.Array, indices: jax.Array) -> jax.Array:
        return found.degrade(key, clean, indices)[0]

    if mesh is None or mesh.size == 1:
        return degrade
    rows = PartitionSpec(mesh.axis_names[0])
    return jax.shard_map(degrade, mesh=mesh, in_specs=(rows, rows), out_specs=rows, check_vma=False)


def batches(
    folder: str | Path | Sequence[str | Path],
    recipe: RecipeLike,
    size: int = 80,
    *,
    batch: int = 32,
    downsample: int = 4,
    per_image: int = 5,
    seed: int = 0,
    start: int = 0,
    mesh: Mesh | None = None,
) -> Batches:
    """(noisy, clean) batches of the photographs in a folder, without end; see `patches` and `Batches`.

    Raises:
        InputError: no photograph that can be used.
    """
    images = load_clean(folder, patch=size, downsample=downsample, per_image=per_image, seed=seed)
    source = CleanPatches(images, size, per_image=per_image, seed=seed)
    return Batches(source, recipe, batch=batch, seed=seed, start=start, mesh=mesh)
