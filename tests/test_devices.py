"""Degrading on many devices and processes gives the bits of one device."""

import json
import os
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.data.loader import degrader
from jaxisp.recipes import RECIPES
from jaxisp.samples import scene, scene_names
from jaxisp.stages.denoise.grid_blur import _gaussian
from tests.conftest import smooth_image

pytestmark = pytest.mark.optimised

IMAGES = np.stack([smooth_image((22, 18, 3), i) for i in range(16)]).astype(np.float32)

PROCESS = """
import sys
import jax, numpy as np
from jax.sharding import Mesh
port, number, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
jax.distributed.initialize(f"127.0.0.1:{port}", 2, number)
assert jax.device_count() == 4 and jax.local_device_count() == 2
from jaxisp.data import Batches
from jaxisp.recipes import RECIPES
from tests.test_devices import Rows
mesh = Mesh(np.asarray(jax.devices()), ("batch",))
rows = Rows()
with Batches(rows, RECIPES["phone-kodak"](), batch=8, seed=3, mesh=mesh) as batches:
    noisy, clean = next(batches)
    noisy, clean = next(batches)
for part in noisy.addressable_shards:
    np.save(f"{out}/{part.index[0].start}.npy", part.data)
print(sorted(set(rows.asked)))
"""


class Rows:
    """A source of clean patches: IMAGES by index, and which were asked for."""

    def __init__(self):
        self.asked = []

    def batch(self, indices):
        self.asked += indices
        return IMAGES[np.asarray(indices) % len(IMAGES)]


@pytest.mark.parametrize(("name", "count", "each"), [("phone-kodak", 8, 1), ("amwgn", 2, 8)])
def test_a_sharded_batch_has_the_bits_of_one_device(name, count, each):
    recipe, key, images = RECIPES[name](), jax.random.key(2), IMAGES[: count * each]
    wanted, _, params = recipe.degrade(key, images, 5)
    mesh = Mesh(np.asarray(jax.devices()[:count]), ("batch",))
    rows = NamedSharding(mesh, PartitionSpec("batch"))
    indices = np.arange(5, 5 + len(images), dtype=np.int32)
    spread = jax.jit(degrader(recipe, key, mesh))(*jax.device_put((images, indices), rows))
    assert len(spread.sharding.device_set) == count
    np.testing.assert_array_equal(spread, wanted)
    again = recipe.repeat(key, params, images, 5)
    np.testing.assert_array_equal(again, wanted)


@pytest.mark.parametrize(("name", "sizes"), [("phone", [1]), ("phone-any", [1]), ("phone-ahd", [1, 2])])
def test_an_image_has_its_bits_in_a_batch_of_any_size(name, sizes):
    """Photographs and noise, alone or in twos, as in a batch of sixteen."""
    recipe, key = RECIPES[name](), jax.random.key(0)
    noise = np.random.default_rng(0).uniform(size=(12, 64, 64, 3))
    photographs = [scene(n, 64) for n in scene_names()[:4]]
    images = np.concatenate([photographs, noise]).astype(np.float32)
    wanted = np.asarray(recipe.degrade(key, images)[0])
    for size in sizes:
        parts = [recipe.degrade(key, images[i : i + size], i)[0] for i in range(0, len(images), size)]
        np.testing.assert_array_equal(np.concatenate(parts), wanted)


@pytest.mark.parametrize("bins", [3, 20, 33])
def test_the_kernel_of_a_bilateral_grid_has_its_bits_in_a_batch_of_any_size(bins):
    """XLA sums a product with a single column, or with few, in other orders."""
    variances = np.linspace(0.1, 9, 32).astype(np.float32)
    kernels = jax.jit(jax.vmap(partial(_gaussian, bins)))
    for size in (1, 2, 8):
        parts = [kernels(variances[i : i + size]) for i in range(0, len(variances), size)]
        np.testing.assert_array_equal(np.concatenate(parts), kernels(variances))


def test_two_processes_give_the_bits_of_one(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    flags = "--xla_force_host_platform_device_count=2"
    settings = {
        **os.environ,
        "XLA_FLAGS": flags,
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": str(Path(__file__).parent.parent),
    }
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, str(port), str(i), str(tmp_path)],
            env=settings, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for i in range(2)
    ]  # fmt: skip
    said = [process.communicate(timeout=240) for process in started]
    assert all(process.returncode == 0 for process in started), said
    got = np.concatenate([np.load(tmp_path / f"{i}.npy") for i in (0, 2, 4, 6)])
    key = jax.random.fold_in(jax.random.key(3), 0)
    np.testing.assert_array_equal(got, RECIPES["phone-kodak"]().degrade(key, IMAGES[8:16], 8)[0])
    for i, (out, _) in enumerate(said):  # each process cut its own half alone
        cut = json.loads(out.splitlines()[-1])
        assert len(cut) >= 8 and {n % 8 // 4 for n in cut} == {i}
