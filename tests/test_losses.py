"""Losses against their closed forms, and the masks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.losses import border_mask, charbonnier, clip_mask, luma_chroma_loss
from jaxisp.testing import smooth_image


def test_charbonnier_is_its_formula(x64):
    x = np.array([-2.0, -1e-3, 0.0, 1e-9, 0.3])
    np.testing.assert_allclose(charbonnier(x, 0.01), np.sqrt(x**2 + 1e-4) - 0.01, atol=1e-15)
    np.testing.assert_allclose(charbonnier(1e-9, 0.01), 1e-18 / 0.02, rtol=1e-6)
    slope = jax.vmap(jax.grad(lambda v: charbonnier(v, 0.01)))(jnp.asarray(x))
    np.testing.assert_allclose(slope, x / np.sqrt(x**2 + 1e-4), atol=1e-12)


def test_a_gray_error_is_luma_only_and_a_chroma_error_is_weighted(x64):
    a = smooth_image((11, 14, 3))
    np.testing.assert_allclose(luma_chroma_loss(a, a), 0, atol=1e-12)
    gray = luma_chroma_loss(a, a + 0.1, chroma_weight=7.0, epsilon=0.02)
    np.testing.assert_allclose(gray, np.hypot(0.1, 0.02) - 0.02, rtol=1e-9)
    # Cb moves by 0.1 at constant luma: B by 0.1 * 1.772, G by -0.1 * 1.772 * 0.114 / 0.587
    moved = a + 0.1 * 1.772 * np.array([0, -0.114 / 0.587, 1])
    loss = luma_chroma_loss(a, moved, chroma_weight=7.0, epsilon=0.02)
    np.testing.assert_allclose(loss, 7 * (np.hypot(0.1, 0.02) - 0.02), rtol=1e-9)


def test_a_mask_leaves_pixels_out(x64):
    a = smooth_image((11, 14, 3))
    b = a.copy()
    b[3:5, 4:9] += 0.2
    kept = np.zeros((11, 14), bool)
    kept[3:5, 4:9] = True
    inside = luma_chroma_loss(a, b, jnp.asarray(kept), epsilon=0.02)
    np.testing.assert_allclose(inside, np.hypot(0.2, 0.02) - 0.02, rtol=1e-9)
    np.testing.assert_allclose(luma_chroma_loss(a, b, jnp.asarray(~kept)), 0, atol=1e-12)
    gradient = jax.grad(luma_chroma_loss)(a, b, jnp.zeros((11, 14), bool))
    assert (gradient == 0).all()


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


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"\(4, 5\)"):
        luma_chroma_loss(jnp.zeros((4, 5)), jnp.zeros((4, 5)))
