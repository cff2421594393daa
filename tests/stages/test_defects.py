"""Defects against counts and closed forms, their correction against SciPy's median by phase."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
import scipy.stats

from jaxisp.cfa import PATTERNS
from jaxisp.stages import defects, sensor
from jaxisp.stages.denoise.median import median_plane
from jaxisp.testing import smooth_image
from tests.jitted import jitted

hot_pixels, dead_pixels = map(jitted, (defects.hot_pixels, defects.dead_pixels))
defect_correction = jitted(defects.defect_correction)
SHAPE = (21, 34)
KINDS = [(hot_pixels, defects.HotPixels, 1.0), (dead_pixels, defects.DeadPixels, 0.0)]


def corrected(image: np.ndarray, threshold: float) -> np.ndarray:
    """`scipy.ndimage.median_filter` on each phase of the mosaic, reflected as a mosaic first."""
    padded = np.pad(image, 4, mode="reflect")
    out = image.copy()
    for y in (0, 1):
        for x in (0, 1):
            middle = scipy.ndimage.median_filter(padded[y::2, x::2], size=3)[2:, 2:]
            part = out[y::2, x::2]
            middle = middle[: part.shape[0], : part.shape[1]]
            part[:] = np.where(np.abs(part - middle) > threshold, middle, part)
    return out


@pytest.mark.parametrize("fn, cls, level", KINDS)
def test_density_level_and_identity(fn, cls, level):
    image = np.full((128, 257), 0.5, np.float32)
    run = jax.jit(lambda density, key: fn(cls(density=density, level=np.float32(level)), image, key=key))
    for density in (0.001, 0.02, 0.1):
        got = np.asarray(run(np.float32(density), jax.random.key(1)))
        assert set(np.unique(got)) == {np.float32(0.5), np.float32(level)}
        expected = density * image.size
        assert abs((got == level).sum() - expected) < 4 * np.sqrt(expected * (1 - density))
    few, many = (np.asarray(run(np.float32(d), jax.random.key(1))) != 0.5 for d in (0.01, 0.1))
    assert (many | ~few).all(), "more density keeps the places"
    assert (few != (np.asarray(run(np.float32(0.01), jax.random.key(2))) != 0.5)).any()
    np.testing.assert_array_equal(run(np.float32(0), jax.random.key(1)), image)


def test_levels_of_hot_photosites_spread_evenly():
    image = np.zeros((256, 257), np.float32)
    params = defects.HotPixels(density=np.float32(0.1), level=np.float32(0.8), spread=np.float32(0.5))
    got = np.asarray(hot_pixels(params, image, key=jax.random.key(3)))
    levels = got[got > 0]
    assert scipy.stats.kstest(levels, scipy.stats.uniform(0.4, 0.4).cdf).pvalue > 0.01
    some = dataclasses.replace(params, dead=np.float32(0.3))
    both = np.asarray(hot_pixels(some, image + 0.1, key=jax.random.key(3)))
    alive = both[(got > 0) & (both > 0)]
    assert abs((both == 0).sum() / (got > 0).sum() - 0.3) < 4 * np.sqrt(0.21 / (got > 0).sum())
    assert scipy.stats.kstest(alive, scipy.stats.uniform(0.4, 0.4).cdf).pvalue > 0.01
    bright = np.asarray(hot_pixels(some, image + 0.7, key=jax.random.key(3)))  # light is not lost
    np.testing.assert_allclose(bright[both > 0], np.maximum(both[both > 0], 0.7))
    assert (bright[both == 0] == 0).all()
    one = dataclasses.replace(params, spread=np.float32(0))
    same = np.asarray(hot_pixels(one, image, key=jax.random.key(3)))
    assert ((same > 0) == (got > 0)).all() and set(np.unique(same)) == {0, np.float32(0.8)}


@pytest.mark.parametrize("fn, cls, level", KINDS)
def test_a_sensor_keeps_its_places(fn, cls, level):
    image = np.full((64, 65), 0.5, np.float32)
    params = cls(density=np.float32(0.1), level=np.float32(level))
    one, again, other = (
        fn(params, image, key=jax.random.key(k), sensor=s) for k, s in ((0, 5), (1, 5), (0, 6))
    )
    np.testing.assert_array_equal(one, again)
    assert (np.asarray(one) != np.asarray(other)).any()


def test_hot_and_dead_places_of_a_sensor_differ():
    image, key = np.full((64, 65), 0.5, np.float32), jax.random.key(0)
    hot = hot_pixels(defects.HotPixels(density=np.float32(0.1)), image, key=key, sensor=1)
    dead = dead_pixels(defects.DeadPixels(density=np.float32(0.1)), image, key=key, sensor=1)
    both = np.mean((np.asarray(hot) != 0.5) & (np.asarray(dead) != 0.5))
    assert both < 0.02, "by chance 0.01"


@pytest.mark.parametrize("fn, cls, level", KINDS)
def test_gradient_of_the_density_is_that_of_the_mean(fn, cls, level):
    image = smooth_image(SHAPE).astype(np.float32)
    weights = np.random.default_rng(0).standard_normal(SHAPE).astype(np.float32)

    def loss(params, x):
        return jnp.sum(fn(params, x, key=jax.random.key(0)) * weights)

    params = cls(density=np.float32(0.1), level=np.float32(level))
    to_params, to_image = jax.jit(jax.grad(loss, (0, 1)))(params, image)
    np.testing.assert_allclose(to_params.density, np.sum((level - image) * weights), rtol=1e-4)
    stuck = np.asarray(fn(params, image, key=jax.random.key(0))) == level
    assert 0 < stuck.sum() < stuck.size
    np.testing.assert_array_equal(to_image, np.where(stuck, 0, weights))
    np.testing.assert_allclose(to_params.level, weights[stuck].sum(), rtol=1e-4)


@pytest.mark.parametrize("threshold", [0.0, 0.04, 0.2])
@pytest.mark.parametrize("shape", [SHAPE, (9, 10), (5, 3)])
def test_correction_matches_scipy_by_phase(threshold, shape):
    rng = np.random.default_rng(1)
    image = smooth_image(shape).astype(np.float32)
    hit = rng.uniform(size=shape) < 0.05
    image[hit] = rng.uniform(-0.5, 1.5, hit.sum())
    got = defect_correction(defects.DefectCorrection(threshold=np.float32(threshold)), image)
    want = corrected(image, np.float32(threshold))
    assert (want != image).any()
    np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize("cfa", PATTERNS)
def test_lone_defects_are_taken_away_in_every_pattern(cfa):
    """Colours far apart, so that a neighbour of another colour would show."""
    colors = np.broadcast_to(np.array([0.1, 0.5, 0.9], np.float32), (*SHAPE, 3))
    clean = np.asarray(sensor.mosaic(jnp.asarray(colors), cfa=cfa))
    bad = clean.copy()
    for y, x, value in ((0, 0, 2.0), (0, 33, -1.0), (20, 17, 2.0), (7, 8, 2.0), (8, 8, -1.0), (12, 21, 2.0)):
        bad[y, x] = value
    got = defect_correction(defects.DefectCorrection(), bad)
    np.testing.assert_array_equal(got, clean)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (2, 3), (3, 2)])
def test_correction_of_small_mosaics_is_finite(shape):
    image = smooth_image(shape).astype(np.float32)
    got = defect_correction(defects.DefectCorrection(threshold=np.float32(0)), image)
    assert got.shape == shape and np.isin(got, image).all()


def test_gradient_of_the_median_is_exact(x64):
    """With everything well above the threshold the gate is flat and the output is the median."""
    image = np.random.default_rng(2).uniform(size=SHAPE)
    weights, direction = np.random.default_rng(3).standard_normal((2, *SHAPE))
    median = jax.jit(lambda x: jnp.sum(median_plane(x, "3x3", 2) * weights))
    got = np.sum(jax.jit(jax.grad(median))(image) * direction)
    want = (median(image + 1e-8 * direction) - median(image - 1e-8 * direction)) / 2e-8
    np.testing.assert_allclose(got, want, rtol=1e-5)
    np.testing.assert_allclose(
        jax.jit(jax.jvp, static_argnums=0)(median, (image,), (direction,))[1], want, rtol=1e-5
    )
    flat = jax.jit(jax.grad(lambda x: jnp.sum(median_plane(x, "3x3", 2))))(np.full(SHAPE, 0.3))
    np.testing.assert_allclose(flat[4:-4, 4:-4], 1, rtol=1e-12, err_msg="shared among equals")


def test_gradient_of_the_threshold_is_the_soft_gates(x64):
    image = np.full(SHAPE, 0.3)
    image[10, 12] = 0.51  # just outside: a higher threshold would let it be

    def value(threshold, x):
        return defect_correction(defects.DefectCorrection(threshold=threshold), x)[10, 12]

    width = 0.05 * 0.2 + 1e-4
    z = (0.21 - 0.2) / width
    gate = 1 / (1 + np.exp(-z))
    slope = gate * (1 - gate) * (-1 / width - z * 0.05 / width)
    assert value(0.2, image) == 0.3
    np.testing.assert_allclose(jax.grad(value)(jnp.asarray(0.2), image), slope * (0.3 - 0.51), rtol=1e-6)
