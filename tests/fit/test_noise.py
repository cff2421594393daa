"""The figures of noise and edges, on pictures whose noise is known."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxisp.fit import noise
from jaxisp.fit.evaluate import local_processing

SHAPE = (192, 256)


def picture(sigma, correlation_blur=0.0, seed=0):
    """A ramp with grey noise of a known standard deviation."""
    rng = np.random.default_rng(seed)
    grain = rng.standard_normal(SHAPE)
    if correlation_blur:
        grain = ndimage.gaussian_filter(grain, correlation_blur)
    grain *= sigma / grain.std()
    ramp = np.linspace(0.2, 0.7, SHAPE[1])[None] + np.zeros(SHAPE)
    return np.repeat((ramp + grain)[..., None], 3, -1).astype(np.float32)


def sums(image, found):
    return noise.moments(image, found.flat, found.edges).astype(np.float64)


@pytest.mark.parametrize("sigma", [0.003, 0.02])
def test_the_standard_deviation_is_that_of_the_noise(sigma):
    image = picture(sigma)
    found = noise.regions(image, np.ones(SHAPE, bool))
    figures = noise.statistics(sums(image, found))
    np.testing.assert_allclose(figures["std"][:, 0], sigma, rtol=0.06)
    np.testing.assert_allclose(figures["std"][:, 1], 0, atol=1e-5)  # grey noise has no chroma
    np.testing.assert_allclose(figures["lag1"][:, 0], 0, atol=0.06)
    assert np.all(np.diff(found.levels) > 0.1)


def test_the_correlation_is_that_of_the_noise():
    image = picture(0.01, correlation_blur=0.8)
    noise_only = image[..., 0] - np.linspace(0.2, 0.7, SHAPE[1], dtype=np.float32)
    neighbours = [np.corrcoef(noise_only[1:].ravel(), noise_only[:-1].ravel())[0, 1],
                  np.corrcoef(noise_only[:, 1:].ravel(), noise_only[:, :-1].ravel())[0, 1]]  # fmt: skip
    found = noise.regions(image, np.ones(SHAPE, bool))
    # a block of 16 px loses its plane, and its last pixel has no neighbour: a few per cent
    np.testing.assert_allclose(
        noise.statistics(sums(image, found))["lag1"][:, 0], np.mean(neighbours), atol=0.09
    )


def test_no_figure_where_the_mask_leaves_nothing():
    image = picture(0.01)
    found = noise.regions(image, np.zeros(SHAPE, bool))
    assert found.flat.sum() == 0 and found.edges.sum() == 0
    assert noise.misfit(sums(image, found), sums(image, found)).tolist() == [0.0] * 17


def test_misfit_is_in_tolerances():
    image, louder = picture(0.01), picture(0.0105)
    found = noise.regions(image, np.ones(SHAPE, bool))
    rows = noise.misfit(sums(louder, found), sums(image, found), std=0.05)
    np.testing.assert_allclose(rows[[0, 2, 4]], np.log(1.05) / 0.05, rtol=1e-3)
    np.testing.assert_allclose(rows[12], 2 * np.log(1.05) / 0.05, rtol=1e-3)
    assert noise.misfit(sums(image, found), sums(image, found)).tolist() == [0.0] * 17


def test_rounding_adds_its_own_noise():
    rng = np.random.default_rng(1)
    image = (0.3 + 0.01 * rng.standard_normal((*SHAPE, 3))).astype(np.float32)
    found = noise.regions(image, np.ones(SHAPE, bool))
    eight_bits = np.round(image * 255) / 255
    difference = sums(eight_bits, found)[:-2] - sums(image, found)[:-2]
    added = (noise.rounded(sums(image, found)) - sums(image, found))[:-2]
    squares = difference.reshape(3, 2, 3)[..., 1].sum(0), added.reshape(3, 2, 3)[..., 1].sum(0)
    np.testing.assert_allclose(*squares, rtol=0.4)


def test_an_edge_that_is_sharpened_has_more_detail():
    step = np.zeros(SHAPE, np.float32)
    step[:, 100:] = 0.5
    soft = ndimage.gaussian_filter(step, 1.2)
    sharp = soft + (soft - ndimage.gaussian_filter(soft, 1.5))
    found = noise.regions(np.repeat(soft[..., None], 3, -1), np.ones(SHAPE, bool))
    edges = [noise.statistics(sums(np.repeat(p[..., None], 3, -1), found))["edge"] for p in (soft, sharp)]
    assert edges[1] > 1.3 * edges[0]


def test_local_processing_is_measured():
    rng = np.random.default_rng(2)
    detail = ndimage.gaussian_filter(rng.standard_normal((256, 320)), 1.5)
    image = np.repeat((0.4 + 0.3 * detail)[..., None], 3, -1).astype(np.float32)
    mask = np.ones(image.shape[:2], bool)
    assert local_processing(image, image, mask) == (0.0, 0.0)
    brighter = image.copy()
    brighter[:, :160] += 0.1
    tone, blurred = local_processing(image, brighter, mask)
    assert 0.049 < tone < 0.11  # half the tiles are 0.1 up, about the median
    assert blurred == 0
    portrait = image.copy()
    portrait[:, :96] = ndimage.gaussian_filter(image, (6, 6, 0))[:, :96]
    tone, blurred = local_processing(image, portrait, mask)
    assert blurred == pytest.approx(0.3, abs=0.06) and tone < 0.02


def test_in_a_program_the_sums_are_the_same():
    image = picture(0.02, 1.0)
    found = noise.regions(image, np.ones(SHAPE, bool))
    traced = jax.jit(partial(noise.moments, xp=jnp))(image, found.flat, found.edges)
    np.testing.assert_allclose(traced, sums(image, found), rtol=1e-5, atol=1e-6)
