"""Interleaved images and planes, there and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays.planes import interleaved, per_plane, planes
from tests.gradients import check_grads


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.uint8])
def test_planes_are_the_channels_and_back(channels, dtype, rng):
    image = (100 * rng.random((4, 6, channels))).astype(dtype)
    split = jax.jit(planes)(image)
    for c, plane in enumerate(split):
        np.testing.assert_array_equal(plane, image[..., c])
    joined = jax.jit(interleaved)(split)
    np.testing.assert_array_equal(joined, image)
    assert joined.dtype == dtype
    batch = jax.jit(jax.vmap(lambda x: interleaved(planes(x)[::-1])))(image[None])
    np.testing.assert_array_equal(batch[0], image[..., ::-1])


def test_a_channel_that_is_not_finite_leaves_the_others_alone():
    image = np.ones((2, 3, 3), np.float32)
    image[..., 1] = np.nan
    image[0, 0, 2] = np.inf
    np.testing.assert_array_equal(interleaved(planes(jnp.asarray(image))), image)


def test_gradients_go_to_the_own_channel(rng):
    image = jnp.asarray(rng.random((4, 6, 3)), jnp.float32)
    turned = lambda x: interleaved([r * g for r, g in zip(planes(x), planes(x)[::-1])])  # noqa: E731
    check_grads(jax.jit(turned), (image,), order=2, rtol=2e-2, atol=2e-2)
    to_second = jax.grad(lambda x: interleaved(planes(x))[..., 1].sum())(image)
    np.testing.assert_array_equal(to_second, np.broadcast_to([0, 1, 0], image.shape))


def test_gradients_do_not_sum(rng):
    """As autodiff of slices and of selections would: up to ten times slower on a CPU."""
    image = jnp.asarray(rng.random((4, 6, 3)), jnp.float32)
    apart = jax.vjp(planes, image)[1]
    assert ".add" not in (text := jax.jit(apart).lower(planes(image)).as_text()) and "select" in text
    together = jax.vjp(interleaved, planes(image))[1]
    assert "reduce" not in jax.jit(together).lower(image).as_text()


def test_per_plane_treats_channels_alike(rng):
    image = jnp.asarray(rng.standard_normal((4, 6, 3)), jnp.float32)
    flipped = per_plane(lambda p: p[::-1], image)
    np.testing.assert_array_equal(flipped, image[::-1])
    np.testing.assert_array_equal(per_plane(lambda p: p[::-1], image[..., 0]), image[::-1, :, 0])
