"""Many devices and processes: batches spread over all of them, weights the same on each."""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.data.sources import CleanPatches
from jaxisp.errors import InputError
from jaxisp.train.pool import PairPool
from jaxisp.train.step import AXIS


def make_mesh(batch: int) -> Mesh:
    """A mesh of as many devices as divide the batch; with several processes, of all devices.

    Raises:
        InputError: several processes, and the batch cannot be spread evenly over their devices.
    """
    devices = jax.devices()
    if jax.process_count() == 1:
        devices = devices[: max(n for n in range(1, len(devices) + 1) if batch % n == 0)]
    elif batch % len(devices):
        raise InputError(f"batch = {batch}: expected a multiple of the {len(devices)} devices")
    return Mesh(np.asarray(devices), (AXIS,))


def replicate(mesh: Mesh, tree: Any) -> Any:
    """The same values on each device. Every process must hold the same ones."""
    sharding = NamedSharding(mesh, PartitionSpec())

    def put(leaf: Any) -> jax.Array:
        return jax.make_array_from_callback(np.shape(leaf), sharding, lambda index: np.asarray(leaf)[index])

    return jax.tree.map(put, tree)


def spread(mesh: Mesh, source: CleanPatches, indices: range) -> jax.Array:
    """The patches of these global indices as a batch; each process makes those of its own devices."""
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))

    def rows(index: Any) -> np.ndarray:
        return source.batch(indices[index[0]])

    return jax.make_array_from_callback((len(indices), source.size, source.size, 3), sharding, rows)


def spread_pairs(mesh: Mesh, pool: PairPool, indices: range) -> tuple[jax.Array, jax.Array]:
    """The (noisy, target) pairs of these global indices, 8 bits each, as two batches."""
    pairs = pool.batch(indices)
    sharding = NamedSharding(mesh, PartitionSpec(AXIS))
    return jax.device_put(pairs[:, 0], sharding), jax.device_put(pairs[:, 1], sharding)
