"""Opcode lists, colour calibration and the DNG writer, against rawpy (LibRaw) and closed forms."""

import warnings

import colour
import numpy as np
import pytest
import rawpy
from hypothesis import given
from hypothesis import strategies as st

from jaxisp.cfa import PATTERNS
from jaxisp.errors import InputError
from jaxisp.io.calibration import (
    Calibration,
    adaptation,
    camera_to_srgb,
    camera_to_srgb_d65,
    mixing_weights,
    neutral_of,
    temperature_and_tint,
    white_xy,
)
from jaxisp.io.observer import observer, spectrum_xy
from jaxisp.io.opcodes import (
    FixVignetteRadial,
    GainMap,
    WarpRectilinear,
    pack_opcodes,
    parse_opcodes,
    shading_gain,
)
from tests.io.samples import BLACK, NEUTRAL, WHITE, XYZ_TO_CAMERA, dng, mosaic


def test_opcodes_round_trip(rng):
    opcodes = [
        WarpRectilinear(rng.normal(size=(3, 6)), (0.5, 0.49)),
        FixVignetteRadial(rng.normal(size=5), (0.51, 0.5)),
        GainMap(
            rng.uniform(1, 2, (3, 4, 1)).astype(np.float32), (0, 1, 20, 30), (2, 2), (0.1, 0.2), (0.4, 0.2)
        ),
    ]
    warp, vignette, gain_map = parse_opcodes(pack_opcodes(opcodes))
    np.testing.assert_array_equal(warp.coefficients, opcodes[0].coefficients)
    assert warp.center == (0.5, 0.49)
    np.testing.assert_array_equal(vignette.coefficients, opcodes[1].coefficients)
    np.testing.assert_array_equal(gain_map.gains, opcodes[2].gains)
    for name in ("rectangle", "pitch", "origin", "spacing", "plane", "planes"):
        assert getattr(gain_map, name) == getattr(opcodes[2], name)


def test_opcodes_bytes_as_specified():
    """FixVignetteRadial by hand: count, id 3, version 1.3.0.0, flags 0, 56 bytes, 7 doubles."""
    doubles = [0.5, 0, 0, 0, 0, 0.5, 0.5]
    by_hand = (
        bytes.fromhex("00000001 00000003 01030000 00000000 00000038") + np.array(doubles, ">f8").tobytes()
    )
    assert pack_opcodes([FixVignetteRadial(np.array(doubles[:5]), (0.5, 0.5))]) == by_hand


def test_unknown_opcodes_are_told_from_known_ones():
    known = FixVignetteRadial(np.zeros(5), (0.5, 0.5))
    body = pack_opcodes([known])[4:]
    optional = bytes.fromhex("00000063 01030000 00000001 00000003 414243")
    needed = bytes.fromhex("00000008 01030000 00000000 00000000")
    first, second, found = parse_opcodes(bytes.fromhex("00000003") + optional + needed + body)
    assert (first.name, second.name) == ("an opcode of unknown kind 99 (optional)", "MapPolynomial")
    assert found.center == (0.5, 0.5)


@given(st.integers(0, 200), st.integers(0, 255))
def test_damaged_opcodes_raise_input_error(at, value):
    good = pack_opcodes(
        [GainMap(np.ones((3, 4, 1), np.float32), (0, 0, 8, 8)), WarpRectilinear(np.zeros((1, 6)), (0.5, 0.5))]
    )
    for bad in (good[:at], good[:at] + bytes([value]) + good[at + 1 :]):
        try:
            parse_opcodes(bad, "x.dng")
        except InputError as error:
            assert str(error).startswith("x.dng: ")
    with pytest.raises(InputError):
        parse_opcodes(good[:-1])


@pytest.mark.parametrize("lens", [FixVignetteRadial, WarpRectilinear])
def test_a_lens_that_no_light_comes_through_raises(lens):
    """Finite terms that would overflow where they are used."""
    terms = np.full(5 if lens is FixVignetteRadial else (1, 6), -1e30)
    with pytest.raises(InputError, match="a lens with a term of 1e\\+30"):
        parse_opcodes(pack_opcodes([lens(terms, (0.5, 0.5))]))


def test_numbers_that_float32_does_not_hold_are_no_second_line(rng):
    """A signalling NaN, and a spacing by which everything is infinitely far: no warning beside the error."""
    gains = rng.uniform(1, 2, (3, 4, 1))
    data = bytearray(pack_opcodes([GainMap(gains, (0, 0, 8, 10), spacing=(5e-324, 0.25))]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shading = shading_gain(parse_opcodes(bytes(data)), (8, 10))
        assert np.isfinite(shading).all()
        data[-4:] = b"\x7f\xa0\0\0"
        with pytest.raises(InputError, match="NaN or infinity"):
            parse_opcodes(bytes(data))


def test_shading_gain_is_bilinear_in_relative_coordinates():
    """A grid that is linear in place gives that plane at pixel centres, on the pixels it is for alone."""
    v, h = np.mgrid[0:5, 0:4]
    gains = (1 + 0.25 * v + h / 3)[..., None]
    grid = GainMap(gains, (1, 0, 21, 34), (2, 2), spacing=(0.25, 1 / 3))
    got = shading_gain([grid], (21, 34))
    y, x = np.mgrid[0:21, 0:34]
    expected = np.where((y % 2 == 1) & (x % 2 == 0), 1 + (y + 0.5) / 21 + (x + 0.5) / 34, 1)
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_shading_gain_holds_its_border_and_multiplies():
    left = GainMap(np.array([[[2.0], [4.0]]]), (0, 0, 4, 8), origin=(0.0, 0.5), spacing=(1.0, 0.25))
    flat = GainMap(np.full((1, 1, 1), 3.0), (0, 0, 4, 8))
    got = shading_gain([left, flat], (4, 8))
    np.testing.assert_allclose(got[0], 3 * np.array([2, 2, 2, 2, 2.5, 3.5, 4, 4]))


def test_adaptation_is_colour_sciences_bradford():
    a, b = np.array([0.9642, 1, 0.8249]), np.array([0.9505, 1, 1.089])
    expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(a, b, "Bradford")
    np.testing.assert_allclose(adaptation(a, b), expected, atol=1e-6)


@pytest.mark.parametrize(
    "xy", [(0.44757, 0.40745), (0.3457, 0.3585), (0.31271, 0.32902), (0.38, 0.4), (0.35, 0.33)]
)
def test_temperature_and_tint(xy):
    uv = colour.UCS_to_uv(colour.XYZ_to_UCS(colour.xy_to_XYZ(xy)))
    kelvin, tint = colour.temperature.uv_to_CCT_Ohno2013(uv)
    got = temperature_and_tint(np.array(xy))
    assert got[0] == pytest.approx(kelvin, rel=1e-3)
    assert got[1] == pytest.approx(tint, abs=3e-4)


OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]


@pytest.mark.parametrize("name", ["A", "D65", "FL2", "FL11", "FL12", "FL3.15", "LED-B3", "HP1"])
def test_chromaticity_of_a_spectrum(name):
    """Of the CIE's own spectra, in steps of 5 nm: to the four digits that it states, lamps of lines too."""
    power = colour.SDS_ILLUMINANTS[name].copy().align(colour.SpectralShape(380, 780, 5))
    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"][name]
    np.testing.assert_allclose(spectrum_xy(380.0, 5.0, power.values), xy, atol=1e-4)


@pytest.mark.parametrize("nm", [430, 467, 503, 546, 589, 633, 671])
def test_chromaticity_of_one_line(nm):
    """In steps of 1 nm, and spread over 4 nm in steps of 2."""
    seen = OBSERVER[nm]
    np.testing.assert_allclose(
        spectrum_xy(nm - 3.0, 1.0, np.eye(1, 7, 3)[0]), seen[:2] / seen.sum(), atol=1e-4
    )
    seen = 0.5 * OBSERVER[nm - 2] + OBSERVER[nm] + 0.5 * OBSERVER[nm + 2]
    power = np.array([0, 0.5, 1, 0.5, 0])
    np.testing.assert_allclose(spectrum_xy(nm - 4.0, 2.0, power), seen[:2] / seen.sum(), atol=1e-4)


def test_the_observer_is_the_cies():
    nm = OBSERVER.wavelengths
    np.testing.assert_allclose(observer(nm), OBSERVER.values.T, atol=1.1e-3)
    np.testing.assert_allclose(observer(nm[::5]), OBSERVER.values[::5].T, atol=1e-6)
    assert not observer(np.array([359.0, 831.0])).any()


@pytest.mark.parametrize(
    ("first", "step", "count"), [(300, 20, 40), (400, 10, 31), (1e9, 1e6, 3), (500, 1e-6, 9)]
)
def test_any_spectrum_has_a_chromaticity(first, step, count):
    """A level one is that of equal energy, held beyond its ends."""
    np.testing.assert_allclose(spectrum_xy(first, step, np.ones(count)), [1 / 3, 1 / 3], atol=1e-4)


def test_weights_of_three_illuminants():
    """One at its own light, its own share elsewhere; the order of the three does not matter."""
    lights = (17, (0.31271, 0.32902), (0.2990, 0.3149))  # A, D65, D75
    for i, xy in enumerate([(0.44757, 0.40745), *lights[1:]]):
        np.testing.assert_allclose(mixing_weights(lights, np.array(xy)), np.eye(3)[i], atol=2e-3)
    between = mixing_weights(lights, np.array([0.3457, 0.3585]))
    # by hand from Ohno's 5001.8, 6503.6 and 7504 K, and .0032 of tint: 1 / (distance squared in 1500 K / T
    # and 15 Duv), smoothed; of A there is less than .02, which counts as none
    np.testing.assert_allclose(between, [0, 0.7702, 0.2298], atol=5e-3)
    turned = mixing_weights((lights[2], lights[0], lights[1]), np.array([0.3457, 0.3585]))
    np.testing.assert_allclose(turned, between[[2, 0, 1]], rtol=1e-9)
    np.testing.assert_array_equal(mixing_weights((17, 0, 21), np.array([0.3, 0.3])), [0, 0, 1])
    np.testing.assert_array_equal(mixing_weights((0, 99, 21), np.array([0.3, 0.3])), [1, 0, 0])


def _calibration(*illuminants, matrices=(XYZ_TO_CAMERA,), forward=None, balance=(1.0, 1.0, 1.0)):
    count = len(illuminants)
    return Calibration(
        illuminants,
        np.stack(matrices),
        None if forward is None else np.stack(forward),
        np.stack([np.diag([1.02, 1.0, 0.97])] * count),
        np.array(balance),
    )


def test_white_and_neutral_are_inverse_with_two_illuminants():
    warm = XYZ_TO_CAMERA + 0.05 * np.eye(3)
    calibration = _calibration(17, 21, matrices=(warm, XYZ_TO_CAMERA), balance=(1.1, 1.0, 0.9))
    for xy in ([0.40, 0.39], [0.3457, 0.3585], [0.30, 0.31], [0.46, 0.41]):
        np.testing.assert_allclose(
            white_xy(calibration, neutral_of(calibration, np.array(xy))), xy, atol=1e-5
        )


def test_matrices_are_mixed_in_inverse_temperature():
    calibration = _calibration(17, 21, matrices=(np.eye(3), 3 * np.eye(3)))
    xy = np.array([0.3457, 0.3585])
    kelvin = temperature_and_tint(xy)[0]
    share = (1 / kelvin - 1 / 6500) / (1 / 2850 - 1 / 6500)
    np.testing.assert_allclose(np.diag(calibration.at(xy)[0])[1], share * 1 + (1 - share) * 3, rtol=1e-9)


def test_camera_to_srgb_keeps_white_and_recovers_colours():
    """A camera linear in XYZ, in D65 light: the matrix takes its balanced RGB back to sRGB."""
    calibration = _calibration(21)
    to_camera = calibration.at(np.array([0.3127, 0.329]))[0]
    srgb_to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    neutral = to_camera @ srgb_to_xyz @ np.ones(3)
    colors = np.random.default_rng(0).uniform(0, 1, (3, 20))
    balanced = (to_camera @ srgb_to_xyz @ colors) / neutral[:, None]
    got = camera_to_srgb(calibration, neutral / neutral[1])
    np.testing.assert_allclose(got @ balanced, colors, atol=2e-3)
    np.testing.assert_allclose(got.sum(1), 1, atol=1e-12)
    np.testing.assert_allclose(camera_to_srgb_d65(to_camera), got, atol=2e-3)


def test_forward_matrix_is_used():
    """A camera whose balanced RGB is ProPhoto: its forward matrix is the ProPhoto primaries."""
    prophoto = colour.RGB_COLOURSPACES["ProPhoto RGB"].matrix_RGB_to_XYZ
    calibration = _calibration(23, forward=(1.7 * prophoto,))
    neutral = np.array(NEUTRAL)
    expected = colour.matrix_RGB_to_RGB("ProPhoto RGB", "sRGB", chromatic_adaptation_transform="Bradford")
    np.testing.assert_allclose(camera_to_srgb(calibration, neutral), expected, atol=2e-3)


@pytest.mark.parametrize("cfa", PATTERNS)
def test_rawpy_reads_what_write_dng_writes(tmp_path, cfa):
    pixels = mosaic()
    with rawpy.imread(str(dng(tmp_path / "a.dng", pixels, cfa=cfa, orientation=6))) as raw:
        np.testing.assert_array_equal(raw.raw_image, pixels)
        names = raw.color_desc.decode()
        assert "".join(names[i] for i in raw.raw_pattern.ravel()) == cfa
        levels = np.array(raw.black_level_per_channel)[raw.raw_pattern]
        np.testing.assert_array_equal(levels.ravel(), BLACK)
        assert raw.white_level == WHITE
        gains = np.array(raw.camera_whitebalance[:3])
        np.testing.assert_allclose(gains / gains[1], 1 / np.array(NEUTRAL), rtol=1e-5)
        assert raw.sizes.flip == 6
        rows = camera_to_srgb_d65(XYZ_TO_CAMERA)  # LibRaw's sRGB primaries have other last digits
        np.testing.assert_allclose(raw.color_matrix[:, :3], rows, atol=3e-4)


def test_write_dng_refuses_other_arrays(tmp_path):
    with pytest.raises(ValueError, match="uint16"):
        dng(tmp_path / "a.dng", np.zeros((8, 8), np.float32))
    with pytest.raises(ValueError, match="cfa"):
        dng(tmp_path / "a.dng", cfa="RGBG")
    assert list(tmp_path.iterdir()) == []
