"""PSNR and SSIM against scikit-image; moment matching against its definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from jaxisp.metrics import match_moments, psnr, ssim, ssim_map
from jaxisp.testing import smooth_image

SKIMAGE = {
    "gaussian": {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False},
    "uniform": {},
}


def pair(shape, noise=0.05, gain=1.0):
    a = gain * smooth_image(shape)
    b = np.clip(a + noise * np.random.default_rng(1).standard_normal(shape), 0, 1)
    return a, b


@pytest.mark.parametrize("shape", [(21, 34, 3), (33, 18)])
def test_psnr_is_that_of_scikit_image(x64, shape):
    a, b = pair(shape)
    np.testing.assert_allclose(psnr(a, b), peak_signal_noise_ratio(a, b, data_range=1), atol=1e-9)
    inner = (slice(3, -3), slice(3, -3))
    expected = peak_signal_noise_ratio(a[inner], b[inner], data_range=1)
    np.testing.assert_allclose(psnr(a, b, border=3), expected, atol=1e-9)


def test_psnr_counts_only_what_the_mask_keeps(x64):
    a, b = pair((21, 34, 3))
    mask = np.zeros((21, 34), bool)
    mask[4:9, 10:30] = True
    b[~mask] = np.nan
    expected = peak_signal_noise_ratio(a[4:9, 10:30], b[4:9, 10:30], data_range=1)
    np.testing.assert_allclose(psnr(a, b, mask=jnp.asarray(mask)), expected, atol=1e-9)
    half = np.zeros((21, 34), bool)
    half[4:9, 10:30] = half[0, 0] = True
    both = psnr(a, b, border=2, mask=jnp.asarray(half))  # the border holds for the mask too
    np.testing.assert_allclose(both, expected, atol=1e-9)


def test_psnr_of_equal_images_is_finite_and_of_no_pixels_is_not():
    a, b = (jnp.float32(x) for x in pair((8, 9), noise=0.0))
    assert psnr(a, b) == 120
    assert np.isfinite(jax.grad(lambda x: psnr(x, b))(a)).all()
    assert np.isnan(psnr(a, b, mask=jnp.zeros((8, 9))))


SSIM, SSIM_MAP = (jax.jit(fn, static_argnames="window") for fn in (ssim, ssim_map))


@pytest.mark.parametrize("window", SKIMAGE)
@pytest.mark.parametrize("shape", [(21, 34, 3), (33, 18)])
@pytest.mark.parametrize("gain", [1.0, 0.05])
def test_ssim_is_that_of_scikit_image(window, shape, gain):
    a, b = pair(shape, gain=gain)
    channel = 2 if len(shape) == 3 else None
    expected, full = structural_similarity(
        a, b, data_range=1, channel_axis=channel, full=True, **SKIMAGE[window]
    )
    assert 0.05 < expected < 0.95
    with jax.enable_x64(True):
        np.testing.assert_allclose(SSIM(a, b, window=window), expected, atol=1e-6)
        np.testing.assert_allclose(SSIM_MAP(a, b, window=window), full, atol=1e-6)
    a, b = a.astype(np.float32), b.astype(np.float32)
    single = SSIM(a, b, window=window)
    assert single.dtype == jnp.float32
    a, b = a.astype(np.float64), b.astype(np.float64)
    expected = structural_similarity(a, b, data_range=1, channel_axis=channel, **SKIMAGE[window])
    np.testing.assert_allclose(single, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("gain", [1.0, 0.05])
def test_single_precision_psnr_is_that_of_scikit_image(gain):
    a, b = (x.astype(np.float32) for x in pair((21, 34, 3), gain=gain))
    expected = peak_signal_noise_ratio(a.astype(np.float64), b.astype(np.float64), data_range=1)
    np.testing.assert_allclose(jax.jit(psnr)(a, b), expected, rtol=1e-6)


def test_ssim_of_equal_and_of_constant_images():
    flat = jnp.full((13, 12), 0.9)
    np.testing.assert_allclose(SSIM(flat, flat), 1, atol=1e-6)
    np.testing.assert_allclose(SSIM(flat, 0 * flat), 0.01**2 / (0.81 + 0.01**2), rtol=1e-3)
    assert np.isfinite(jax.jit(jax.grad(ssim))(flat, flat)).all()


def test_moments_become_those_of_the_output(x64):
    clean, output = smooth_image((21, 34, 3)), 0.3 * smooth_image((21, 34, 3), seed=3) + 0.2
    matched = match_moments(clean, output)
    np.testing.assert_allclose(matched.mean((0, 1)), output.mean((0, 1)), atol=1e-12)
    np.testing.assert_allclose(matched.std((0, 1)), output.std((0, 1)), atol=1e-12)
    np.testing.assert_allclose(match_moments(clean, 0.5 * clean + 0.1), 0.5 * clean + 0.1, atol=1e-12)


def test_moments_of_a_constant_image_have_a_finite_gradient():
    clean, output = jnp.full((9, 8, 3), 0.4), jnp.float32(smooth_image((9, 8, 3)))
    matched = match_moments(clean, output)
    np.testing.assert_allclose(matched, jnp.broadcast_to(output.mean((0, 1)), clean.shape), atol=1e-6)
    for argument in (0, 1):
        gradient = jax.grad(lambda c, o: (match_moments(c, o) ** 2).sum(), argument)(clean, output)
        assert np.isfinite(gradient).all()


def test_bad_calls_name_the_shapes():
    a = jnp.zeros((8, 9))
    with pytest.raises(ValueError, match=r"\(8, 9\) and \(9, 8\)"):
        psnr(a, a.T)
    with pytest.raises(ValueError, match="border of 4"):
        psnr(a, a, border=4)
    with pytest.raises(ValueError, match="window of 11"):
        ssim(a, a)
    with pytest.raises(ValueError, match="'hann'"):
        ssim(a, a, "hann")
