"""White balance, colour matrix, saturation, hue and the colorimetry behind them."""

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp import cfa as bayer
from jaxisp.colorimetry import illuminant_rgb, planckian_uv
from jaxisp.pipeline import run, stage
from jaxisp.stages.balance import (
    ColorMatrix,
    HueRotation,
    Saturation,
    WhiteBalance,
    WhiteBalanceTemperature,
)
from jaxisp.testing import smooth_image

CMFS = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]


def exact_uv(temperature: float) -> np.ndarray:
    """CIE 1960 uv of a Planckian radiator by colour-science, 1 nm."""
    sd = colour.sd_blackbody(temperature, CMFS.shape)
    xyz = colour.sd_to_XYZ(sd, CMFS, method="Integration")
    return colour.UCS_to_uv(colour.XYZ_to_UCS(xyz))


def exact_rgb(temperature: float, tint: float) -> np.ndarray:
    """Linear sRGB, Y = 1, off the locus along its normal by central differences; colour-science only."""
    tangent = exact_uv(temperature * 1.001) - exact_uv(temperature / 1.001)
    normal = np.array([tangent[1], -tangent[0]]) / np.hypot(*tangent)
    xy = colour.UCS_uv_to_xy(exact_uv(temperature) + tint * normal)
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    return np.linalg.inv(srgb.matrix_RGB_to_XYZ) @ colour.xy_to_XYZ(xy)


def test_gains_multiply_each_channel():
    image = smooth_image((5, 7, 3)).astype(np.float32) * 3 - 1
    gains = np.float32([2.0, 1.0, 0.5])
    out = run(stage("white_balance"), {"white_balance": WhiteBalance(gains=gains)}, image)
    np.testing.assert_array_equal(out, image * gains)


@pytest.mark.parametrize("cfa", bayer.PATTERNS)
def test_mosaic_gains_are_those_of_the_image(cfa):
    """Balancing the picture and then taking the mosaic is the same as balancing the mosaic."""
    image = smooth_image((5, 7, 3)).astype(np.float32)
    sites = np.resize(np.array(["RGB".index(c) for c in cfa]).reshape(2, 2), (2, 2))
    index = np.tile(sites, (3, 4))[:5, :7]
    gains = np.float32([2.0, 1.0, 1.5])
    mosaic = np.take_along_axis(image, index[..., None], -1)[..., 0]
    want = np.take_along_axis(image * gains, index[..., None], -1)[..., 0]
    s = stage("mosaic_white_balance", cfa=cfa)
    np.testing.assert_array_equal(run(s, {"mosaic_white_balance": WhiteBalance(gains=gains)}, mosaic), want)


def test_unknown_pattern_is_refused():
    with pytest.raises(ValueError, match="XTRA"):
        stage("mosaic_white_balance", cfa="XTRA")({"mosaic_white_balance": WhiteBalance()}, jnp.zeros((4, 4)))


def test_planckian_locus_is_near_the_exact_one(x64):
    temperatures = np.geomspace(2000, 12000, 41)
    got = np.stack(planckian_uv(temperatures), -1)
    want = np.array([exact_uv(t) for t in temperatures])
    assert np.abs(got - want).max() < 2e-8


def test_tint_is_the_signed_distance_from_the_locus_at_right_angles(x64):
    for temperature in (2000.0, 3000.0, 6504.0, 12000.0):
        step = 1e-4 * temperature
        tangent = np.array(planckian_uv(temperature + step)) - np.array(planckian_uv(temperature - step))
        moved = np.array(planckian_uv(temperature, 0.02)) - np.array(planckian_uv(temperature))
        assert abs(np.hypot(*moved) - 0.02) < 1e-12
        assert abs(moved @ tangent) / np.hypot(*tangent) / 0.02 < 1e-6
        assert moved[1] > 0, "positive is above the locus"


@pytest.mark.parametrize(
    ("temperature", "tint"), [(2850.0, 0.0), (4000.0, 0.01), (5003.0, -0.015), (9000.0, 0.003)]
)
def test_tint_and_temperature_are_read_back(temperature, tint, x64):
    """Ohno's method finds the CCT and the Duv that were asked for."""
    uv = np.array(planckian_uv(temperature, tint))
    cct, duv = colour.temperature.uv_to_CCT_Ohno2013(uv, start=1500, end=14000, spacing=1.001)
    assert abs(cct / temperature - 1) < 1e-3
    assert abs(duv - tint) < 2e-5


def test_default_illuminant_is_d65():
    p = WhiteBalanceTemperature()
    np.testing.assert_allclose(illuminant_rgb(p.temperature, p.tint), 1.0, atol=1e-3)


@pytest.mark.parametrize(
    ("temperature", "tint", "source", "source_tint"),
    [(3000, 0.0, 6504, 0.0), (6504, 0.0, 2856, 0.0), (12000, -0.02, 5000, 0.01), (2300, 0.0, 4000, -0.01)],
)
def test_temperature_gains_match_colour_science(temperature, tint, source, source_tint, x64):
    params = WhiteBalanceTemperature(
        temperature=np.float64(temperature),
        tint=np.float64(tint),
        source_temperature=np.float64(source),
        source_tint=np.float64(source_tint),
    )
    s = stage("white_balance_temperature")
    got = run(s, {s.name: params}, np.ones((2, 3, 3)))[0, 0]
    want = exact_rgb(temperature, tint) / exact_rgb(source, source_tint)
    np.testing.assert_allclose(got, want, rtol=1e-4)


def test_single_precision_temperature_gains_match():
    """Colour-science where the illuminant is inside sRGB, the double everywhere."""
    s = stage("white_balance_temperature")
    for temperature, tint in ((2000.0, 0.0), (2500.0, 0.02), (4321.0, -0.02), (11000.0, 0.01)):
        values = {"temperature": temperature, "tint": tint, "source_temperature": 5500.0, "source_tint": 0.0}
        single = WhiteBalanceTemperature(**{k: np.float32(v) for k, v in values.items()})
        got = run(s, {s.name: single}, np.ones((1, 1, 3), np.float32))
        with jax.enable_x64(True):
            double = WhiteBalanceTemperature(**{k: np.float64(v) for k, v in values.items()})
            want = np.asarray(run(s, {s.name: double}, np.ones((1, 1, 3))))
        np.testing.assert_allclose(got, want, rtol=2e-5)
        reference = exact_rgb(temperature, tint) / exact_rgb(5500.0, 0.0)
        if temperature != 2500.0:
            np.testing.assert_allclose(got[0, 0], reference, rtol=1e-4)


def test_equal_illuminants_change_nothing_and_lower_temperatures_are_redder():
    s = stage("white_balance_temperature")
    image = smooth_image((5, 7, 3)).astype(np.float32)
    np.testing.assert_array_equal(run(s, s.init(), image), image)
    warm = WhiteBalanceTemperature(temperature=np.float32(3000))
    out = np.asarray(run(s, {s.name: warm}, np.ones((1, 1, 3), np.float32)))[0, 0]
    assert out[0] > 1 > out[2]
    green = WhiteBalanceTemperature(tint=np.float32(0.03))
    out = np.asarray(run(s, {s.name: green}, np.ones((1, 1, 3), np.float32)))[0, 0]
    assert out[1] > 1 > max(out[0], out[2])


@pytest.mark.parametrize("temperature", [2000.0, 3000.0, 12000.0])
@pytest.mark.parametrize("tint", [-0.03, 0.03])
def test_temperature_gains_stay_positive_on_the_bounds(temperature, tint):
    s = stage("white_balance_temperature")
    for source, source_tint in ((2000.0, 0.03), (12000.0, -0.03)):
        params = WhiteBalanceTemperature(
            temperature=np.float32(temperature),
            tint=np.float32(tint),
            source_temperature=np.float32(source),
            source_tint=np.float32(source_tint),
        )
        out = run(s, {s.name: params}, np.ones((1, 1, 3), np.float32))
        assert (out > 0).all() and np.isfinite(out).all()


def test_color_matrix_multiplies_each_pixel():
    image = smooth_image((5, 7, 3)).astype(np.float32)
    matrix = np.random.default_rng(0).uniform(-2, 2, (3, 3)).astype(np.float32)
    got = run(stage("color_matrix"), {"color_matrix": ColorMatrix(matrix=matrix)}, image)
    np.testing.assert_allclose(got, np.einsum("ij,hwj->hwi", matrix, image), atol=1e-6)
    np.testing.assert_array_equal(run(stage("color_matrix"), stage("color_matrix").init(), image), image)


def ycbcr(rgb: np.ndarray) -> np.ndarray:
    return colour.RGB_to_YCbCr(rgb, K=colour.WEIGHTS_YCBCR["ITU-R BT.601"], out_legal=False)


@pytest.mark.parametrize("amount", [0.0, 0.5, 1.0, 2.5])
def test_saturation_scales_chroma_and_keeps_luma(amount):
    image = smooth_image((5, 7, 3)).astype(np.float32)
    out = run(stage("saturation"), {"saturation": Saturation(amount=np.float32(amount))}, image)
    want = ycbcr(image) * [1, amount, amount]
    np.testing.assert_allclose(ycbcr(np.asarray(out)), want, atol=1e-6)


@pytest.mark.parametrize("angle", [-180.0, 30.0, 120.0])
def test_hue_rotation_turns_chroma_and_keeps_luma(angle):
    image = smooth_image((5, 7, 3)).astype(np.float32)
    out = run(stage("hue_rotation"), {"hue_rotation": HueRotation(angle=np.float32(angle))}, image)
    got, before = ycbcr(np.asarray(out)), ycbcr(image)
    turned = (before[..., 1] + 1j * before[..., 2]) * np.exp(1j * np.deg2rad(angle))
    np.testing.assert_allclose(got[..., 0], before[..., 0], atol=1e-6)
    np.testing.assert_allclose(got[..., 1] + 1j * got[..., 2], turned, atol=1e-6)
