"""Adjustments taken from the image: statistics against NumPy and SciPy, targets reached, limits kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import gmean, pmean

from jaxisp.pipeline import run, run_batch, stage
from jaxisp.stages.auto import AutoExposure, AutoLevel, GrayWorld, WhitePatch, percentile
from jaxisp.testing import smooth_image

WEIGHTS = np.array([0.299, 0.587, 0.114])
percentile_of = jax.jit(percentile)


def cast(cls, **values):
    return cls(**{k: np.float64(v) for k, v in values.items()})


@given(q=st.floats(0, 100), size=st.sampled_from([1, 2, 3, 50]))
def test_percentile_is_numpys(q, size):
    values = np.random.default_rng(size).standard_normal(size)
    with jax.enable_x64(True):
        got = percentile_of(values, np.float64(q))
    np.testing.assert_allclose(got, np.percentile(values, q), atol=1e-12)


@pytest.mark.parametrize("q", [0.0, 1.0, 37.5, 50.0, 99.0, 100.0])
def test_percentile_with_ties_negatives_and_constants(q):
    rng = np.random.default_rng(0)
    wide = np.array([[0.0, -0.0, 1e30, -1e30, 1e-30]])
    for values in (rng.integers(-3, 4, (11, 13)), np.full((5, 7), -2.0), wide):
        values = values.astype(np.float32)
        want = np.percentile(values.astype(np.float64), q)
        np.testing.assert_allclose(percentile_of(values, np.float32(q)), want, rtol=2e-6, atol=1e-6)


def test_tied_pixels_share_the_gradient():
    values = jnp.array([[2.0, 1.0, 2.0, 2.0, 5.0]])
    got = jax.jit(jax.grad(percentile))(values, jnp.float32(50))
    np.testing.assert_allclose(got, [[1 / 3, 0, 1 / 3, 1 / 3, 0]], atol=1e-6)


def test_percentile_gradients(x64):
    values = jnp.array([3.0, 1.0, 2.0, 10.0])
    to_values, to_q = jax.jit(jax.grad(percentile, argnums=(0, 1)))(values, 50.0)
    np.testing.assert_allclose(to_values, [0.5, 0, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(to_q, 3 / 100, atol=1e-12)
    ends = jax.jit(jax.vmap(jax.grad(lambda q: percentile(values, q))))(np.array([1e-6, 100.0 - 1e-6]))
    np.testing.assert_allclose(ends, [3 / 100, 7 * 3 / 100], rtol=1e-6)


def test_auto_level_puts_the_percentiles_at_black_and_white(x64):
    image = 0.2 + 0.5 * smooth_image((21, 34, 3))
    params = cast(AutoLevel, black=2, white=95, max_gain=16)
    out = np.asarray(run(stage("auto_level"), {"auto_level": params}, image))
    low, high = np.percentile(image @ WEIGHTS, [2, 95])
    np.testing.assert_allclose(out, (image - low) / (high - low), atol=1e-12)
    np.testing.assert_allclose(np.percentile(out @ WEIGHTS, [2, 95]), [0, 1], atol=1e-12)


def test_auto_level_keeps_the_largest_gain(x64):
    image = 0.4 + 0.1 * smooth_image((21, 34, 3))
    params = cast(AutoLevel, black=0, white=100, max_gain=1.5)
    out = run(stage("auto_level"), {"auto_level": params}, image)
    np.testing.assert_allclose(out, 1.5 * (image - (image @ WEIGHTS).min()), atol=1e-12)


def test_statistics_are_of_each_image():
    """A batch is no different from its images one by one."""
    images = np.stack([smooth_image((21, 34, 3), 0), 0.2 * smooth_image((21, 34, 3), 1)]).astype(np.float32)
    for name in ("auto_level", "auto_exposure", "gray_world", "white_patch"):
        s = stage(name)
        batch = run_batch(s, s.init(), images)
        for i in range(2):
            np.testing.assert_allclose(batch[i], run(s, s.init(), images[i]), atol=1e-5)


@pytest.mark.parametrize(("average", "mean"), [("log", gmean), ("mean", np.mean)])
@pytest.mark.parametrize("target", [0.05, 0.18, 0.7])
def test_auto_exposure_hits_its_target(average, mean, target, x64):
    image = 0.3 * smooth_image((21, 34, 3))
    params = cast(AutoExposure, target=target, max_gain_ev=4)
    out = np.asarray(run(stage("auto_exposure", average=average), {"auto_exposure": params}, image))
    np.testing.assert_allclose(mean(out @ WEIGHTS, axis=None), target, rtol=1e-9)
    ratio = out / image
    np.testing.assert_allclose(ratio, ratio[0, 0, 0], rtol=1e-9)


@pytest.mark.parametrize("average", ["log", "mean"])
def test_auto_exposure_keeps_the_largest_gain(average, x64):
    image = 0.01 * smooth_image((21, 34, 3))
    params = cast(AutoExposure, target=0.18, max_gain_ev=2)
    s = stage("auto_exposure", average=average)
    np.testing.assert_allclose(run(s, {"auto_exposure": params}, image), 4 * image, rtol=1e-12)
    for dark in (np.zeros_like(image), -image):
        np.testing.assert_allclose(run(s, {"auto_exposure": params}, dark), 4 * dark, atol=1e-12)


def test_unknown_average_is_refused():
    with pytest.raises(ValueError, match="median"):
        stage("auto_exposure", average="median")(stage("auto_exposure").init(), jnp.zeros((2, 3, 3)))


@pytest.mark.parametrize("norm", [1.0, 6.0, 20.0])
def test_gray_world_makes_the_minkowski_means_equal(norm, x64):
    cast_image = smooth_image((21, 34, 3)) * [0.5, 1.0, 1.7]
    params = cast(GrayWorld, norm=norm, strength=1)
    out = np.asarray(run(stage("gray_world"), {"gray_world": params}, cast_image))
    means = pmean(cast_image.reshape(-1, 3), norm)
    np.testing.assert_allclose(out, cast_image * means[1] / means, rtol=1e-9)
    np.testing.assert_allclose(pmean(out.reshape(-1, 3), norm), means[1], rtol=1e-9)


def test_white_patch_makes_the_percentiles_equal(x64):
    cast_image = smooth_image((21, 34, 3)) * [0.5, 1.0, 1.7]
    params = cast(WhitePatch, percentile=97.3, strength=1)
    out = np.asarray(run(stage("white_patch"), {"white_patch": params}, cast_image))
    levels = np.percentile(cast_image, 97.3, axis=(0, 1))
    np.testing.assert_allclose(out, cast_image * levels[1] / levels, rtol=1e-9)


@pytest.mark.parametrize(("name", "cls"), [("gray_world", GrayWorld), ("white_patch", WhitePatch)])
def test_strength_is_a_share_of_the_way(name, cls, x64):
    image = smooth_image((9, 13, 3)) * [0.5, 1.0, 1.7]

    def gain(strength):
        return np.asarray(run(stage(name), {name: cast(cls, strength=strength)}, image))[0, 0] / image[0, 0]

    gains = [gain(s) for s in (0, 0.5, 1)]
    np.testing.assert_allclose(gains[0], 1.0, atol=1e-12)
    np.testing.assert_allclose(gains[1] ** 2, gains[2], rtol=1e-9)
    assert gains[2][0] > 1.2 and gains[2][2] < 0.8


@pytest.mark.parametrize("name", ["gray_world", "white_patch"])
def test_black_and_scenes_without_red_have_finite_gains(name):
    s = stage(name)
    for scale, gain in (([0, 0, 0], 1.0), ([0, 1, 1], None), ([0.001, 1, 1], 16.0)):
        image = (smooth_image((9, 13, 3)) * scale).astype(np.float32)
        out = np.asarray(run(s, s.init(), image))
        assert np.isfinite(out).all()
        if gain:
            np.testing.assert_allclose(out[..., 0], gain * image[..., 0], rtol=1e-5)


def test_gray_world_takes_no_notice_of_negatives(x64):
    image = smooth_image((9, 13, 3)) * [0.5, 1.0, 1.7] - 0.3
    params = cast(GrayWorld, norm=6, strength=1)
    out = np.asarray(run(stage("gray_world"), {"gray_world": params}, image))
    means = pmean(np.maximum(image, 0).reshape(-1, 3), 6)
    np.testing.assert_allclose(out, image * means[1] / means, rtol=1e-9)
