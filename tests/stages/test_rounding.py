"""Rounding to output levels against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.stages.rounding import rounding


@pytest.mark.parametrize("bits", [1, 8, 10, 16])
def test_rounds_to_the_levels_of_a_file(rng, bits):
    image = rng.uniform(-0.2, 1.2, (7, 9, 3)).astype(np.float32)
    levels = 2**bits - 1
    want = np.round(image.clip(0, 1).astype(np.float64) * levels)
    np.testing.assert_allclose(np.asarray(rounding(image, bits=bits)) * levels, want, atol=1e-3)


def test_uses_every_level():
    ramp = np.linspace(0, 1, 4096, dtype=np.float32).reshape(64, 64, 1)
    for bits in (1, 4, 8):
        assert len(np.unique(rounding(ramp, bits=bits))) == 2**bits


def test_a_file_comes_back():
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, 2)
    got = np.asarray(rounding((levels / 255).astype(np.float32)))
    np.testing.assert_array_equal(np.round(got * 255), levels)
    np.testing.assert_allclose(got, levels / 255, atol=1e-7)


def test_legacy_has_one_level_too_many_and_is_darker():
    image = np.linspace(0, 1, 3 * 4096, dtype=np.float32).reshape(64, 64, 3)
    got = np.asarray(rounding(image, legacy=True))
    np.testing.assert_array_equal(got, np.floor(image * 256) / 256)
    assert len(np.unique(got)) == 257
    np.testing.assert_allclose(np.mean(got - image), -1 / 512, rtol=0.01)
    assert abs(np.mean(np.asarray(rounding(image)) - image)) < 1e-5


@pytest.mark.parametrize("legacy", [False, True])
def test_gradient_is_straight_through_inside_and_nothing_outside(legacy):
    image = jnp.asarray([-0.5, 0.1, 0.7, 1.5]).reshape(2, 2, 1).repeat(3, 2)
    grad = jax.grad(lambda x: rounding(x, legacy=legacy).sum())(image)
    np.testing.assert_array_equal(grad[..., 0].ravel(), [0, 1, 1, 0])


def test_refuses_impossible_bits():
    with pytest.raises(ValueError, match="bits"):
        rounding(np.zeros((2, 3, 3), np.float32), bits=0)
