"""More channels for a network that is trained, and the mean of two: the experiments `widen` and `joined`."""

import jax
import numpy as np
import pytest
from flax import nnx

from experiments.denoisers.joined import joined
from experiments.denoisers.widen import widened
from jaxisp.errors import InputError
from jaxisp.models import make_model
from jaxisp.testing import smooth_image


def levelnet(seed, *features):
    return make_model("levelnet", seed=seed, features=features, estimator=8)


def trained():
    """Fresh networks take nothing off: their last weights are nearly 0."""
    network = levelnet(0, 8, 8, 12)
    kernel = network.last.kernel
    kernel.set_value(0.01 * jax.random.normal(jax.random.key(0), kernel.shape))
    return network


def test_a_wider_network_gives_what_it_gave_with_fresh_weights_beside():
    noisy = np.random.default_rng(0).uniform(0.1, 0.9, (1, 32, 32, 3)).astype(np.float32)
    levels = np.full((1, 2, 2, 2), 0.1, np.float32)
    run = nnx.jit(lambda network: (network(noisy, levels), network.noise_map(noisy)))
    network, wide = trained(), levelnet(1, 12, 20, 16)
    before, expected = run(wide), run(network)
    widened(network, wide)
    assert np.abs(expected[0] - noisy).max() > 0.01 and np.abs(before[0] - expected[0]).max() > 0.01
    for given, told in zip(run(wide), expected, strict=True):
        np.testing.assert_allclose(given, told, atol=2e-6)
    assert np.abs(wide.first.kernel.get_value()[..., 8:]).max() > 0.1  # fresh


def test_a_narrower_one_is_refused():
    with pytest.raises(InputError, match="fewer"):
        widened(trained(), levelnet(1, 4, 8, 12))


def test_a_joined_network_has_the_mean_of_the_weights_and_another_ones_estimator():
    before, after, other = (levelnet(seed, 8, 8, 16) for seed in range(3))
    made = joined(before, after, 0.7, other)
    kernels = [np.asarray(network.first.kernel.get_value()) for network in (before, after, made)]
    np.testing.assert_allclose(kernels[2], 0.3 * kernels[0] + 0.7 * kernels[1], rtol=1e-6, atol=1e-7)
    picture = smooth_image((32, 32, 3))[None]
    np.testing.assert_array_equal(made.noise_map(picture), other.noise_map(picture))
    with pytest.raises(InputError, match="no mean"):
        joined(before, levelnet(0, 8, 16, 16), 0.5, other)
