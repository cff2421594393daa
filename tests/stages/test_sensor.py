"""The sensor against NumPy, SciPy, scikit-image and colour-demosaicing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
from colour_demosaicing import mosaicing_CFA_Bayer
from skimage.util import img_as_ubyte

from jaxisp.cfa import PATTERNS
from jaxisp.stages import sensor
from jaxisp.testing import smooth_image

SHAPE = (21, 34)


def wide_mosaic(seed: int = 0) -> np.ndarray:
    """Values below 0 and above 1 too."""
    return (2 * smooth_image(SHAPE, seed) - 0.5).astype(np.float32)


@pytest.mark.parametrize("cfa", PATTERNS)
@pytest.mark.parametrize("shape", [SHAPE, (7, 5), (1, 1)])
def test_mosaic_matches_colour_demosaicing(cfa, shape):
    image = smooth_image((*shape, 3)).astype(np.float32)
    np.testing.assert_array_equal(sensor.mosaic(image, cfa=cfa), mosaicing_CFA_Bayer(image, cfa).astype("f4"))


@pytest.mark.parametrize(
    "fn", [sensor.mosaic, lambda x, cfa: sensor.green_imbalance(sensor.GreenImbalance(), x, cfa=cfa)]
)
def test_unknown_pattern_is_refused(fn):
    with pytest.raises(ValueError, match="RGBG"):
        fn(smooth_image((*SHAPE, 3)).astype(np.float32), cfa="RGBG")


@pytest.mark.parametrize("image", [wide_mosaic(), smooth_image((*SHAPE, 3)).astype(np.float32)])
def test_black_level_adds(image):
    got = sensor.black_level(sensor.BlackLevel(offset=np.float32(0.0625)), image)
    np.testing.assert_array_equal(got, image + np.float32(0.0625))
    np.testing.assert_array_equal(sensor.black_level(sensor.BlackLevel(), image), image)


def test_linearization_by_place():
    black, white = np.array([0.01, 0.05, 0.1, 0.2]), 0.9
    image = wide_mosaic()
    want = image.astype(np.float64)
    for place in range(4):
        part = np.s_[place // 2 :: 2, place % 2 :: 2]
        want[part] = (want[part] - black[place]) / (white - black[place])
    params = sensor.Linearization(black=black.astype("f4"), white=np.float32(white))
    got = sensor.linearization(params, image)
    assert got.dtype == np.float32 and (np.asarray(got) < 0).any(), "what is below black is kept"
    np.testing.assert_allclose(got, want, atol=1e-6)


@pytest.mark.parametrize("bits", [2, 8, 10, 14, 16])
def test_quantization_matches_numpy(bits):
    image, levels = wide_mosaic(), 2**bits - 1
    got = sensor.adc_quantization(sensor.AdcQuantization(bits=np.float32(bits)), image)
    # float32 products, as a tie could fall either way
    want = np.round((image * np.float32(levels)).astype(np.float64)) / levels
    np.testing.assert_allclose(got, want, atol=3e-7)
    assert np.abs(got - image).max() > 0.4 / levels
    for x in (0.0, 1.0):
        assert (
            sensor.adc_quantization(sensor.AdcQuantization(bits=np.float32(bits)), jnp.full((1, 1), x)) == x
        )


def test_quantization_to_8_bits_matches_scikit_image():
    image = smooth_image((*SHAPE, 3)).astype(np.float32)
    got = sensor.adc_quantization(sensor.AdcQuantization(bits=np.float32(8)), image)
    np.testing.assert_allclose(got, img_as_ubyte(image) / 255, atol=1e-7)


def test_quantization_rounds_the_bits_and_legacy_floors():
    image = wide_mosaic()
    ten, about_ten = (sensor.AdcQuantization(bits=np.float32(b)) for b in (10, 10.4))
    np.testing.assert_array_equal(
        sensor.adc_quantization(ten, image), sensor.adc_quantization(about_ten, image)
    )
    got = sensor.adc_quantization(ten, image, legacy=True)
    np.testing.assert_array_equal(got, np.floor(image * 1024) / 1024)
    assert -0.6 / 1024 < np.mean(got - image) < -0.4 / 1024, "half a step too dark"


@pytest.mark.parametrize("legacy", [False, True])
def test_quantization_gradient_is_the_declared_surrogate(x64, legacy):
    image = smooth_image(SHAPE)

    def total(bits, x):
        return jnp.sum(sensor.adc_quantization(sensor.AdcQuantization(bits=bits), x, legacy=legacy) ** 2)

    to_bits, to_image = jax.grad(total, (0, 1))(jnp.asarray(6.0), image)
    levels = 64 if legacy else 63
    out = np.floor(image * 64) / 64 if legacy else np.round(image * 63) / 63
    np.testing.assert_allclose(to_image, 2 * out, rtol=1e-12)
    np.testing.assert_allclose(to_bits, np.sum(2 * out * (image - out) / levels) * 64 * np.log(2), rtol=1e-9)


def test_fewer_bits_are_found_by_their_gradient():
    """The surrogate's expected error grows as bits fall, so a fitter sees which way to go."""
    image = np.random.default_rng(0).uniform(size=(64, 65)).astype(np.float32)

    def error(bits):
        return jnp.mean((sensor.adc_quantization(sensor.AdcQuantization(bits=bits), image) - image) ** 2)

    for bits in (3.0, 5.0, 7.0):
        slope, step = jax.grad(error)(jnp.float32(bits)), 1 / (2**bits - 1)
        want = -2 * step**2 / 12 * np.log(2) * 2**bits * step  # d/dbits of a uniform error's step**2 / 12
        np.testing.assert_allclose(slope, want, rtol=0.06)


def test_clip_and_its_gradient(x64):
    image = np.array([[-0.3, 0.2, 0.7], [0.9, 1.4, 0.0501]])

    def run(white, x, **static):
        return sensor.clip(sensor.Clip(white=white), x, **static)

    white = jnp.asarray(0.8)
    np.testing.assert_array_equal(run(white, image), np.clip(image, 0, 0.8))
    np.testing.assert_array_equal(run(white, image, low=-0.1, leak=0.2), np.clip(image, -0.1, 0.8))
    to_white, to_image = jax.grad(lambda *a: jnp.sum(run(*a)), (0, 1))(white, image)
    np.testing.assert_array_equal(to_image, [[0, 1, 1], [0, 0, 1]])
    assert to_white == 2
    to_white, to_image = jax.grad(lambda *a: jnp.sum(run(*a, leak=0.25)), (0, 1))(white, image)
    np.testing.assert_allclose(to_image, [[0.25, 1, 1], [0.25, 0.25, 1]])
    assert to_white == 1.5
    for bad in ({"leak": 1.5}, {"leak": -0.1}, {"low": 0.3}):
        with pytest.raises(ValueError, match="clip"):
            run(white, image, **bad)


@pytest.mark.parametrize("cfa", PATTERNS)
def test_green_imbalance_site_by_site(cfa):
    image = wide_mosaic()
    got = sensor.green_imbalance(sensor.GreenImbalance(difference=np.float32(0.1)), image, cfa=cfa)
    red_row = cfa.index("R") // 2
    for (y, x), value in np.ndenumerate(image):
        gain = 1.0
        if cfa[2 * (y % 2) + x % 2] == "G":
            gain = 1.05 if y % 2 == red_row else 0.95
        np.testing.assert_allclose(got[y, x], value * gain, rtol=1e-6)
    same = sensor.green_imbalance(sensor.GreenImbalance(difference=np.float32(0)), image, cfa=cfa)
    np.testing.assert_array_equal(same, image)


def crosstalk_params(h, v, d):
    return sensor.Crosstalk(horizontal=np.float32(h), vertical=np.float32(v), diagonal=np.float32(d))


@pytest.mark.parametrize("shares", [(0.05, 0.02, 0.01), (-0.1, -0.05, 0.3), (0.3, 0.3, 0.3)])
def test_crosstalk_matches_scipy(shares):
    h, v, d = shares
    kernel = np.array([[d / 4, v / 2, d / 4], [h / 2, 1 - h - v - d, h / 2], [d / 4, v / 2, d / 4]])
    for shape in (SHAPE, (2, 3)):
        image = smooth_image(shape).astype(np.float32)
        want = scipy.ndimage.convolve(image.astype(np.float64), kernel, mode="mirror")
        np.testing.assert_allclose(sensor.crosstalk(crosstalk_params(*shares), image), want, atol=4e-7)


def test_crosstalk_keeps_light_flat_fields_and_zero():
    point = np.zeros(SHAPE, np.float32)
    point[9, 16] = 1
    params = crosstalk_params(0.05, 0.02, 0.01)
    np.testing.assert_allclose(np.sum(sensor.crosstalk(params, point)), 1, rtol=1e-6)
    np.testing.assert_allclose(sensor.crosstalk(params, np.full(SHAPE, 0.3, np.float32)), 0.3, rtol=1e-6)
    np.testing.assert_array_equal(sensor.crosstalk(crosstalk_params(0, 0, 0), wide_mosaic()), wide_mosaic())
