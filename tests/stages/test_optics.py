"""Optics that change light, not places, against closed forms."""

import numpy as np
import pytest

from jaxisp.stages import optics

from .lens import H, W, apply, picture, squared_radius


@pytest.mark.parametrize("ev", [-8.0, -1.5, 1.0, 8.0])
def test_exposure_is_a_power_of_two(ev):
    image = 4 * picture() - 1
    np.testing.assert_allclose(apply(optics.Exposure(exposure_ev=ev), image), image * 2.0**ev, rtol=2e-6)
    np.testing.assert_array_equal(apply(optics.Exposure(), image), image)


def test_affine_exposure():
    image = 4 * picture() - 1
    out = apply(optics.AffineExposure(gain=1.7, offset=-0.2), image)
    np.testing.assert_allclose(out, 1.7 * image.astype(float) - 0.2, atol=1e-6)
    np.testing.assert_array_equal(apply(optics.AffineExposure(), image), image)


def test_vignetting_gain():
    a2, a4, a6 = -1.2, 0.7, -0.9
    gain = apply(optics.Vignetting(a2=a2, a4=a4, a6=a6), np.ones((H, W, 3), np.float32))
    r2 = squared_radius()
    np.testing.assert_allclose(gain[..., 1], 2 ** (a2 * r2 + a4 * r2**2 + a6 * r2**3), rtol=1e-6)
    np.testing.assert_allclose(gain[[0, 0, -1, -1], [0, -1, 0, -1]], 2 ** (a2 + a4 + a6), rtol=1e-6)
    assert (gain == gain[..., :1]).all()


def test_vignetting_of_an_ideal_lens():
    """Two even powers of r follow the cos**4 law of a 90 degree field to 1.2 %."""
    cosine = 1 / np.sqrt(1 + squared_radius())
    gain = apply(optics.Vignetting(a2=-2.72, a4=0.73), np.ones((H, W, 3), np.float32))
    np.testing.assert_allclose(gain[..., 0], cosine**4, rtol=0.012)


def test_opposite_vignetting_corrects():
    image = 4 * picture() - 1
    there = apply(optics.Vignetting(a2=-2.0, a4=1.0, a6=-1.5), image)
    back = apply(optics.Vignetting(a2=2.0, a4=-1.0, a6=1.5), there)
    np.testing.assert_allclose(back, image, atol=2e-6)
    np.testing.assert_array_equal(apply(optics.Vignetting(), image), image)


def test_color_shading_is_vignetting_of_red_and_blue():
    image = picture()
    out = apply(optics.ColorShading(red_a2=0.5, red_a4=-0.9, blue_a2=-0.4, blue_a4=1.1), image)
    np.testing.assert_allclose(
        out[..., 0], apply(optics.Vignetting(a2=0.5, a4=-0.9), image)[..., 0], rtol=1e-6
    )
    np.testing.assert_array_equal(out[..., 1], image[..., 1])
    np.testing.assert_allclose(
        out[..., 2], apply(optics.Vignetting(a2=-0.4, a4=1.1), image)[..., 2], rtol=1e-6
    )


def test_veiling_glare_keeps_the_mean_and_lifts_blacks():
    image = picture()
    image[3, 4] = 0
    out = apply(optics.VeilingGlare(share=0.1), image)
    np.testing.assert_allclose(out.mean((0, 1)), image.mean((0, 1)), rtol=1e-6)
    np.testing.assert_allclose(out[3, 4], 0.1 * image.mean((0, 1), dtype=float), rtol=1e-6)
    np.testing.assert_allclose(out, 0.9 * image + 0.1 * image.mean((0, 1)), atol=1e-6)
    np.testing.assert_array_equal(apply(optics.VeilingGlare(), image), image)
