"""Degrading on many devices and processes gives the bits of one device."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.data.loader import degrader
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image

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


@pytest.mark.parametrize(("name", "count"), [("phone-kodak", 8), ("amwgn", 2)])
def test_a_sharded_batch_has_the_bits_of_one_device(name, count):
    recipe, key = RECIPES[name](), jax.random.key(2)
    wanted, _, params = recipe.degrade(key, IMAGES, 5)
    mesh = Mesh(np.asarray(jax.devices()[:count]), ("batch",))
    rows = NamedSharding(mesh, PartitionSpec("batch"))
    indices = np.arange(5, 5 + len(IMAGES), dtype=np.int32)
    spread = jax.jit(degrader(recipe, key, mesh))(*jax.device_put((IMAGES, indices), rows))
    assert len(spread.sharding.device_set) == count
    np.testing.assert_array_equal(spread, wanted)
    again = recipe.repeat(key, params, IMAGES, 5)
    np.testing.assert_array_equal(again, wanted)


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
