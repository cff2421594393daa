"""A batch that is differentiated in groups: the gradients of the whole, in both modes, in less memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays import batches
from jaxisp.arrays.batches import group_size
from jaxisp.pipeline import Chain, compiled_batch, run_batch, stage
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.noise import GaussianNoise
from tests.gradients import both_modes


@pytest.mark.parametrize(
    "images, pixels, stages, size",
    [
        (32, 80 * 80, 13, 32),
        (64, 80 * 80, 13, 8),
        (32, 100 * 100, 13, 4),
        (32, 80 * 80, 1, 32),
        (7, 80 * 80, 30, 7),
        (4, 10**6, 13, 4),
        (64, 16 * 16, 13, 64),
        (31, 80 * 80, 30, 31),
    ],
)
def test_group_size(images, pixels, stages, size):
    """The whole batch within some 128 MB, and where groups would be tiny, or no smaller one fits; else groups
    of some 30 MB."""
    assert group_size(images, pixels, stages) == size


@pytest.fixture
def batch(rng, monkeypatch):
    monkeypatch.setattr(batches, "AT_ONCE", 0)
    monkeypatch.setattr(batches, "SCRATCH", 500 * 3 * batches.PER_STAGE)
    monkeypatch.setattr(batches, "LEAST", 100)
    chain = Chain((stage("gaussian_noise"), stage("unsharp_mask", radius=3), stage("clip")), "chain")
    shared = chain.init() | {"unsharp_mask": UnsharpMask(amount=0.7, sigma=1.1, threshold=0.02)}
    own = {"gaussian_noise": GaussianNoise(std=jnp.linspace(0.01, 0.1, 6, dtype=jnp.float32))}
    return (
        chain,
        jax.tree.map(jnp.asarray, shared | own),
        jnp.asarray(rng.random((6, 12, 17, 3)), jnp.float32),
    )


def test_gradients_are_those_of_each_image(batch):
    """To parameters that are shared and parameters of each image, and to the images."""
    chain, params, images = batch
    key = jax.random.key(3)

    def loss(params, images):
        return jnp.sum(run_batch(chain, params, images, key) ** 2)

    assert "scan" in str(jax.make_jaxpr(jax.grad(loss))(params, images))
    together = jax.jit(jax.grad(loss, argnums=(0, 1)))(params, images)

    def alone(params, images):
        each = [
            run_batch(chain, params | {"gaussian_noise": GaussianNoise(std=std)}, image[None], key, start=i)
            for i, (std, image) in enumerate(zip(params["gaussian_noise"].std, images))
        ]
        return jnp.sum(jnp.concatenate(each) ** 2)

    want = jax.grad(alone, argnums=(0, 1))(params, images)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(want)):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-4)


def test_both_modes_agree(batch, rng):
    chain, params, images = batch

    def run(images):
        return run_batch(chain, params, images, jax.random.key(3))

    tangent, cotangent = jnp.asarray(rng.standard_normal((2, *images.shape)), jnp.float32)
    _, moved, (pulled,) = jax.jit(lambda x: both_modes(run, (x,), (tangent,), cotangent))(images)
    np.testing.assert_allclose(jnp.vdot(moved, cotangent), jnp.vdot(tangent, pulled), rtol=1e-4)


def test_what_is_not_differentiated_goes_together(batch):
    chain, params, images = batch
    jaxpr = str(jax.make_jaxpr(lambda x: run_batch(chain, params, x, jax.random.key(3)))(images))
    assert "custom_jvp_call" in jaxpr and "scan[" not in jaxpr.split("jvp_jaxpr_fun")[0]


def test_the_scratch_memory_is_that_of_a_group(monkeypatch):
    chain = Chain(tuple(stage("unsharp_mask", radius=1, name=name) for name in "abcd"), "chain")
    x = jnp.ones((16, 40, 40, 3))

    def scratch(most):
        monkeypatch.setattr(batches, "AT_ONCE", 0)
        monkeypatch.setattr(batches, "SCRATCH", most * 4 * batches.PER_STAGE)
        monkeypatch.setattr(batches, "LEAST", 0)
        loss = jax.grad(lambda v: jnp.sum(compiled_batch.__wrapped__(chain, chain.init(), v, None, 0) ** 2))
        return jax.jit(loss).lower(x).compile().memory_analysis().temp_size_in_bytes

    # the whole batch's frames go in and come out
    assert scratch(40 * 40) < scratch(x.size) / 2
