"""Wavelet coring against PyWavelets and scikit-image, and the transform's gradient."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import pywt
from skimage.restoration import denoise_wavelet, estimate_sigma

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.stages.denoise.dwt import SCALING, analyse, synthesise
from jaxisp.stages.denoise.wavelet import (
    WaveletCoring,
    core_plane,
    estimate_noise,
    soft_threshold,
    wavelet_coring,
)
from jaxisp.testing import smooth_image

cored = jax.jit(core_plane, static_argnums=(3, 4, 5))


@pytest.mark.parametrize("wavelet", SCALING)
def test_filters_equal_published(wavelet):
    np.testing.assert_allclose(SCALING[wavelet], pywt.Wavelet(wavelet).rec_lo, atol=2e-12)


@pytest.mark.parametrize("wavelet", SCALING)
def test_transform_equals_pywavelets(wavelet, rng, x64):
    for shape in ((20, 13), (5, 4), (1, 3)):
        plane = rng.standard_normal(shape)
        low, details = pywt.dwt2(plane, wavelet, mode="symmetric")
        got = jax.jit(analyse, static_argnums=1)(plane, wavelet)
        for band, want in zip(got, (low, *details)):
            np.testing.assert_allclose(band, want, atol=1e-11)
        np.testing.assert_allclose(
            jax.jit(synthesise, static_argnums=(1, 2))(got, shape, wavelet), plane, atol=1e-11
        )


@pytest.mark.parametrize("shape", [(8, 13), (7, 6)])
def test_transform_gradient_is_the_transpose(shape, rng, x64):
    """<A x, c> = <x, A' c> for all of a basis would be slow: random vectors, against PyWavelets."""
    plane, weights = rng.standard_normal((2, *shape))
    bands = [rng.standard_normal(np.shape(b)) for b in analyse(jnp.asarray(plane), "db2")]

    def inner(x):
        return sum(jnp.sum(b * c) for b, c in zip(analyse(x, "db2"), bands))

    low, details = pywt.dwt2(plane, "db2", mode="symmetric")
    want = sum(np.sum(b * c) for b, c in zip((low, *details), bands))
    np.testing.assert_allclose(np.sum(jax.jit(jax.grad(inner))(jnp.asarray(plane)) * plane), want, rtol=1e-11)

    def outer(b):
        return jnp.sum(synthesise(b, shape, "db2") * weights)

    slope = jax.jit(jax.grad(outer))(tuple(map(jnp.asarray, bands)))
    back = pywt.idwt2((bands[0], tuple(bands[1:])), "db2", mode="symmetric")[: shape[0], : shape[1]]
    np.testing.assert_allclose(sum(np.sum(s * b) for s, b in zip(slope, bands)), np.sum(back * weights))


def test_transform_is_linear_in_forward_mode(rng, x64):
    plane, change = rng.standard_normal((2, 2, 8, 13))
    transform = jax.jit(jax.vmap(lambda x: analyse(x, "db2")))
    bands, tangent = jax.jvp(transform, (plane,), (change,))
    for t, want in zip(tangent, transform(change)):
        np.testing.assert_allclose(t, want, atol=1e-12)
    inverse = jax.jit(jax.vmap(lambda b: synthesise(b, (8, 13), "db2")))
    back, moved = jax.jvp(inverse, (bands,), (tangent,))
    np.testing.assert_allclose(back, plane, atol=1e-12)
    np.testing.assert_allclose(moved, change, atol=1e-12)


@pytest.mark.parametrize("method, name", [("bayes", "BayesShrink"), ("visu", "VisuShrink")])
@pytest.mark.parametrize("wavelet, shape", [("db2", (45, 62)), ("sym4", (57, 62))])
def test_shrinkage_equals_scikit_image(method, name, wavelet, shape, rng, x64):
    plane = smooth_image(shape) + rng.normal(0, 0.05, shape)
    want = denoise_wavelet(
        plane, sigma=0.05, wavelet=wavelet, mode="soft", wavelet_levels=3, method=name, rescale_sigma=False
    )
    got = cored(plane, 0.05, 1.0, wavelet, 3, method)
    assert np.abs(want - plane).max() > 0.05
    np.testing.assert_allclose(got, want, atol=1e-10)


def test_float32_equals_scikit_image(rng):
    plane = smooth_image((45, 62)) + rng.normal(0, 0.05, (45, 62))
    want = denoise_wavelet(
        plane, sigma=0.05, wavelet="db2", mode="soft", wavelet_levels=3, method="BayesShrink"
    )
    np.testing.assert_allclose(cored(plane.astype(np.float32), 0.05, 1.0, "db2", 3, "bayes"), want, atol=1e-5)


def test_fixed_threshold_equals_pywavelets(rng, x64):
    plane = rng.standard_normal((33, 30))
    low, *details = pywt.wavedec2(plane, "db4", mode="symmetric", level=2)
    shrunk = [tuple(pywt.threshold(d, 2.4, "soft") for d in level) for level in details]
    want = pywt.waverec2([low, *shrunk], "db4", mode="symmetric")[:33]
    np.testing.assert_allclose(cored(plane, 0.8, 3.0, "db4", 2, "fixed"), want, atol=1e-10)


def test_stage_filters_luma_and_chroma_apart(x64):
    image = smooth_image((21, 34, 3))
    params = WaveletCoring(luma_sigma=0.03, chroma_sigma=0.1, strength=1.5)
    out = jax.jit(lambda p, x: wavelet_coring(p, x, method="visu"))(params, jnp.asarray(image))
    before, after = (rgb_to_ycbcr_planes(*np.moveaxis(np.asarray(x), -1, 0)) for x in (image, out))
    for plane, got, sigma in zip(before, after, (0.03, 0.1, 0.1)):
        np.testing.assert_allclose(got, cored(np.asarray(plane), sigma, 1.5, "db2", 3, "visu"), atol=1e-6)


@pytest.mark.parametrize("shape", [(21, 34, 3), (5, 7, 3), (1, 2, 3)])
def test_strength_zero_is_identity(shape):
    image = 3 * smooth_image(shape).astype(np.float32) - 1
    out = jax.jit(lambda x: wavelet_coring(WaveletCoring(strength=0.0), x, levels=4))(image)
    np.testing.assert_allclose(out, image, atol=3e-6)


def test_white_noise_is_removed_and_estimated(rng):
    noise = rng.normal(0, 0.04, (120, 161)).astype(np.float32)
    plane = smooth_image(noise.shape).round(1).astype(np.float32) + noise
    np.testing.assert_allclose(jax.jit(estimate_noise)(plane), estimate_sigma(plane), rtol=1e-5)
    np.testing.assert_allclose(estimate_noise(noise), 0.04, rtol=0.05)
    assert np.std(cored(noise, 0.04, 1.0, "db2", 3, "bayes")) < 0.3 * 0.04


def test_soft_threshold_equals_pywavelets(rng):
    x = rng.standard_normal(50)
    np.testing.assert_allclose(soft_threshold(x, 0.7), pywt.threshold(x, 0.7, "soft"), atol=1e-6)


@pytest.mark.parametrize("option, match", [({"wavelet": "db99"}, "db99"), ({"method": "hard"}, "hard")])
def test_unknown_options_are_refused(option, match):
    with pytest.raises(ValueError, match=match):
        wavelet_coring(WaveletCoring(), jnp.zeros((5, 6, 3)), **option)
