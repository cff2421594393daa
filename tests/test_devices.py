"""Degrading on many devices and processes gives the bits of one device."""

import json
import os
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxisp.arrays.varying import varying
from jaxisp.data.loader import degrader
from jaxisp.pipeline import stage
from jaxisp.recipes import RECIPES
from jaxisp.samples import scene, scene_names
from jaxisp.stages import STAGES
from jaxisp.stages.denoise.grid_blur import _periodic_gaussian
from jaxisp.testing import smooth_image

pytestmark = pytest.mark.optimised

KEY = jax.random.key(2)
MESHES = [
    jax.make_mesh((2,), ("batch",), axis_types=(kind,), devices=jax.devices()[:2])
    for kind in (AxisType.Auto, AxisType.Explicit)
]
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


SIZES = {"phone": [1], "phone-any": [1], "phone-ahd": [1, 2], "rsblur": [2, 4]}  # of rsblur alone see below


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        pytest.param(name, SIZES.get(name, [1, 4]), marks=[pytest.mark.slow] * (name != "phone"))
        for name in RECIPES
    ],
)
def test_an_image_has_its_bits_in_a_batch_of_any_size(name, sizes):
    """Photographs and noise, alone or in small batches, as in a batch of sixteen."""
    recipe, key = RECIPES[name](), jax.random.key(0)
    noise = np.random.default_rng(0).uniform(size=(12, 64, 64, 3))
    photographs = [scene(n, 64) for n in scene_names()[:4]]
    images = np.concatenate([photographs, noise]).astype(np.float32)
    wanted = np.asarray(recipe.degrade(key, images)[0])
    for size in sizes:
        parts = [recipe.degrade(key, images[i : i + size], i)[0] for i in range(0, len(images), size)]
        np.testing.assert_array_equal(np.concatenate(parts), wanted)


@pytest.mark.slow
def test_an_image_of_rsblur_alone_differs_by_as_little_as_it_says():
    """A step of 8 bits in one value of 10,000 at most: a path that is drawn alone is rounded otherwise."""
    recipe, key = RECIPES["rsblur"](), jax.random.key(0)
    images = np.stack([scene(n, 64) for n in scene_names()[:4]]).astype(np.float32)
    wanted = np.asarray(recipe.degrade(key, images)[0])
    parts = [recipe.degrade(key, images[i : i + 1], i)[0] for i in range(len(images))]
    apart = np.abs(np.concatenate(parts) - wanted)
    assert apart.max() < 1.01 / 255 and (apart > 0).mean() < 1e-4


@pytest.mark.parametrize("bins", [3, 20, 33])
def test_the_kernel_of_a_bilateral_grid_has_its_bits_in_a_batch_of_any_size(bins):
    """XLA's CPU code for exp of few numbers is another."""
    variances = np.linspace(0.1, 9, 32).astype(np.float32)
    kernels = jax.jit(jax.vmap(partial(_periodic_gaussian, bins + 1, jnp.int32(bins))))
    for size in (1, 2, 8):
        parts = [kernels(variances[i : i + size]) for i in range(0, len(variances), size)]
        np.testing.assert_array_equal(np.concatenate(parts), kernels(variances))


def traced(fn, mesh, *arguments):
    """`fn(key, *arguments)`, traced in a plain shard_map; arguments are spread by rows."""
    rows = PartitionSpec("batch")
    spread = [jax.ShapeDtypeStruct(a.shape, a.dtype, sharding=NamedSharding(mesh, rows)) for a in arguments]
    specs = (PartitionSpec(), *[rows] * len(arguments))
    return jax.eval_shape(jax.shard_map(fn, mesh=mesh, in_specs=specs, out_specs=rows), KEY, *spread)


@pytest.mark.parametrize("name", ["phone", pytest.param("phone-any", marks=pytest.mark.slow)])
def test_recipes_are_traced_in_a_plain_shard_map(name):
    """And their gradients: what varies over the mesh is told from what does not."""
    recipe, images = RECIPES[name](), np.zeros((4, 32, 32, 3), np.float32)

    def slope(key, images, indices):
        return jax.grad(lambda x: jnp.sum(recipe.degrade(key, x, indices)[0]))(images)

    for mesh in MESHES:
        assert traced(slope, mesh, images, np.arange(4, dtype=np.int32)).shape == images.shape


@pytest.mark.parametrize(
    ("name", "size"),
    [
        # mixes of what goes through this by itself
        pytest.param(n, (32, 36), marks=[pytest.mark.slow] * (n in ("chroma_denoising", "demosaicking")))
        for n in sorted(STAGES)
    ]
    + [(n, (512, 520)) for n in ("bilateral", "demosaic_ahd", "geometric_distortion", "unsharp_mask")],
)
def test_stages_are_traced_in_a_plain_shard_map(name, size):
    """Each device its own image, large ones in strips; the slope to shared parameters is summed."""
    node, devices = stage(name), 2
    shape = size if node.domain_in.channels == 1 else (*size, 3)

    def slope(key, images):
        def total(params):
            return jnp.sum(jax.vmap(lambda x: node(params, x, key=key))(images))

        moved = jax.grad(total)(jax.tree.map(jnp.asarray, node.init()))
        assert not varying(moved), "it is summed over the devices"
        return jnp.zeros_like(images) + sum(jnp.sum(v) for v in jax.tree.leaves(moved))

    image = jnp.zeros((devices, *shape), jnp.float32)
    assert traced(slope, MESHES[0], image).shape == image.shape


@pytest.mark.parametrize("mesh", MESHES, ids=["auto", "explicit"])
def test_a_training_loop_of_ones_own(mesh):
    """A plain shard_map that degrades and averages gradients: noise and model are those of one device."""
    recipe, rows = RECIPES["amwgn"](), PartitionSpec("batch")
    images, indices = IMAGES[:4], np.arange(4, dtype=np.int32)

    def loss(gain, noisy, clean):
        return jnp.mean((gain * noisy - clean) ** 2)

    def local(gain, key, clean, indices):
        noisy = recipe.degrade(key, clean, indices)[0]
        return gain - 0.5 * jax.grad(lambda g: jax.lax.pmean(loss(g, noisy, clean), "batch"))(gain), noisy

    specs = (PartitionSpec(), PartitionSpec(), rows, rows)
    step = jax.jit(jax.shard_map(local, mesh=mesh, in_specs=specs, out_specs=(PartitionSpec(), rows)))
    gain = alone = jnp.float32(0.5)
    for i in range(2):
        numbers = indices + 4 * i
        spread = jax.device_put((images, numbers), NamedSharding(mesh, rows))
        gain, noisy = step(gain, KEY, *spread)
        wanted = recipe.degrade(KEY, images, numbers)[0]
        alone = alone - 0.5 * jax.grad(loss)(alone, wanted, images)
        np.testing.assert_array_equal(noisy, wanted)
    np.testing.assert_allclose(gain, alone, rtol=1e-5)


@pytest.mark.parametrize("mesh", MESHES, ids=["auto", "explicit"])
@pytest.mark.parametrize("image", [0, 3])
def test_nan_on_any_device_is_refused(mesh, image):
    images = IMAGES[:4].copy()
    images[image, 0, 0, 0] = np.nan
    spread = jax.device_put(images, NamedSharding(mesh, PartitionSpec("batch")))
    with pytest.raises(ValueError, match="NaN"):
        RECIPES["awgn"]().degrade(KEY, spread)


def test_a_batch_on_an_explicit_mesh_has_the_bits_of_one_device():
    mesh, recipe = MESHES[1], RECIPES["phone-kodak"]()
    wanted, _, drawn = recipe.degrade(KEY, IMAGES[:4], 3)
    spread = jax.device_put(IMAGES[:4], NamedSharding(mesh, PartitionSpec("batch")))
    noisy, clean, params = recipe.degrade(KEY, spread, 3)
    assert jax.typeof(noisy).sharding.spec[0] == jax.typeof(clean).sharding.spec[0] == "batch"
    np.testing.assert_array_equal(noisy, wanted)
    jax.tree.map(np.testing.assert_array_equal, params, drawn)
    np.testing.assert_array_equal(recipe.repeat(KEY, drawn, spread, 3), wanted)
    for spec in (PartitionSpec(None, "batch"), PartitionSpec(None, None, "batch")):
        across = jax.device_put(IMAGES[:4], NamedSharding(mesh, spec))
        np.testing.assert_array_equal(recipe.degrade(KEY, across, 3)[0], wanted)


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
