"""Losses against their closed forms, and the masks."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.losses import border_mask, charbonnier, clip_mask, log_rms


def test_charbonnier_is_its_formula(x64):
    x = np.array([-2.0, -1e-3, 0.0, 1e-9, 0.3])
    np.testing.assert_allclose(charbonnier(x, 0.01), np.sqrt(x**2 + 1e-4) - 0.01, atol=1e-15)
    np.testing.assert_allclose(charbonnier(1e-9, 0.01), 1e-18 / 0.02, rtol=1e-6)
    slope = jax.vmap(jax.grad(lambda v: charbonnier(v, 0.01)))(jnp.asarray(x))
    np.testing.assert_allclose(slope, x / np.sqrt(x**2 + 1e-4), atol=1e-12)


def test_log_rms_is_psnr_in_nats_and_its_gradient_is_finite_at_no_difference(rng):
    from skimage.metrics import peak_signal_noise_ratio

    one, other = rng.random((2, 3, 8, 8, 3))
    psnr = [peak_signal_noise_ratio(a, b, data_range=1.0) for a, b in zip(one, other)]
    np.testing.assert_allclose(log_rms(one - other, 0.0), -np.log(10) / 20 * np.asarray(psnr), rtol=1e-6)
    still = jax.grad(lambda x: log_rms(x).mean())(np.zeros((2, 4, 4, 3), np.float32))
    assert np.isfinite(still).all()


def test_masks():
    inner = np.zeros((7, 9), bool)
    inner[2:-2, 2:-2] = True
    np.testing.assert_array_equal(border_mask((7, 9, 3), 2), inner)
    assert border_mask((7, 9), 0).all()
    assert not border_mask((7, 9), 4).any()
    image = np.full((2, 3, 3), 0.5)
    image[0, 1, 2], image[1, 2, 0], image[1, 0, 1] = 1.0, 0.0, 254 / 255
    np.testing.assert_array_equal(clip_mask(image), [[True, False, True], [True, True, False]])
    np.testing.assert_array_equal(clip_mask(image[..., 2], 0.6, 1.0), [[False, True, False], [False] * 3])
