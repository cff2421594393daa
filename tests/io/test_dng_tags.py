"""What the tags of a DNG state of its colours, levels, lens, layout and shot, against closed forms."""

import os
import struct
from concurrent.futures import ThreadPoolExecutor

import colour
import imagecodecs
import numpy as np
import pytest
import rawpy
import tifffile

from jaxisp.cfa import shifted
from jaxisp.errors import InputError
from jaxisp.io import tags as tag
from jaxisp.io.dng_color import calibration
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, pack_opcodes
from jaxisp.io.raw import read_raw
from tests.io.samples import WHITE, XYZ_TO_CAMERA, dng, mosaic
from tests.io.test_raw import _patched, refused

WARM = np.array([[0.856, -0.2487, -0.0752], [-0.45, 1.23, 0.25], [-0.06, 0.17, 0.52]])
A, D50, D65 = (0.44758, 0.40745), (0.3457, 0.3585), (0.31271, 0.32902)


def rationals(values) -> tuple[int, ...]:
    return tuple(n for v in np.ravel(values) for n in (round(float(v) * 10**6), 10**6))


def matrix(code: int, values):
    return code, 10, 9, rationals(values)


def undefined(code: int, data: bytes):
    return code, 7, len(data), data


def chromaticity(xy, order: str = "<") -> bytes:
    return struct.pack(f"{order}H4I", 0, *rationals(xy))


def spectrum(name: str, order: str = "<") -> bytes:
    shape = colour.SpectralShape(380, 780, 5)
    power = colour.SDS_ILLUMINANTS[name].copy().align(shape).values
    pairs = rationals([380, 5, *power / power.max()])
    return struct.pack(f"{order}HI{len(pairs)}I", 1, power.size, *pairs)


# --- colours ---


def in_light(path, *extra, xy=(0.3377, 0.3401)):
    """A file that states the chromaticity of its light alone, with the matrices of A and D65."""
    both = [matrix(50721, WARM), matrix(50722, XYZ_TO_CAMERA)]
    white = [(50728, 5, 3, (0, 1) * 3), (50729, 5, 2, rationals(xy))]
    return read_raw(dng(path, extra_tags=[*both, *white, *extra]))


@pytest.mark.parametrize("data", [chromaticity, spectrum], ids=["xy", "spectrum"])
def test_illuminant_data_stands_for_the_light_that_has_no_code(tmp_path, data):
    stated = [data(A), data(D65)] if data is chromaticity else [data("A"), data("D65")]
    want = in_light(tmp_path / "a.dng", (50778, 3, 1, 17), (50779, 3, 1, 21))
    lights = [undefined(52533, stated[0]), undefined(52534, stated[1])]
    got = in_light(tmp_path / "b.dng", (50778, 3, 1, 255), (50779, 3, 1, 255), *lights)
    np.testing.assert_allclose(got.white_balance, want.white_balance, rtol=5e-3)
    np.testing.assert_allclose(got.camera_to_srgb, want.camera_to_srgb, atol=0.01)
    assert got.notes == want.notes == ()  # an AsShotNeutral of zeros is how phones leave it to the other tag


def test_illuminant_data_is_in_the_order_of_the_file():
    for order in "<>":
        main = {50721: WARM.ravel(), 50778: np.array([255.0]), 52533: chromaticity(A, order)}
        found = calibration(tag.DngTags(main, {}, order), pytest.fail)
        assert found.illuminants == (pytest.approx(A),)


@pytest.mark.parametrize(
    "data", [b"", b"\2\0", chromaticity((0, 0)), chromaticity(A)[:-1], spectrum("A")[:-4]]
)
def test_illuminant_data_that_is_damaged_is_told(tmp_path, data):
    lights = [(50778, 3, 1, 255), undefined(52533, data), (50779, 3, 1, 21)]
    raw = in_light(tmp_path / "a.dng", *lights)
    np.testing.assert_allclose(raw.xyz_to_camera, WARM, atol=1e-5)
    assert "IlluminantData1" in raw.notes[0] and "ColorMatrix1 alone" in raw.notes[1]


def test_the_third_illuminant_has_its_matrices(tmp_path):
    third, forward = XYZ_TO_CAMERA @ np.diag([1.1, 1, 0.8]), [np.eye(3), 2 * np.eye(3), 3 * np.eye(3)]
    extra = [(50778, 3, 1, 17), (50779, 3, 1, 21), (52529, 3, 1, 23), matrix(52531, third)]
    extra += [matrix(code, m) for code, m in zip((50964, 50965, 52532), forward)]
    raw = in_light(tmp_path / "a.dng", *extra, xy=D50)
    np.testing.assert_allclose(raw.xyz_to_camera, third, atol=2e-3)
    np.testing.assert_allclose(raw.calibration.at(np.array(D50))[2], 3 * np.eye(3), atol=5e-3)
    cold = in_light(tmp_path / "b.dng", *extra, xy=D65)
    np.testing.assert_allclose(cold.xyz_to_camera, XYZ_TO_CAMERA, atol=2e-3)


@pytest.mark.parametrize("unknown", [0, 1, 2])
def test_of_three_illuminants_the_two_that_are_known_count(tmp_path, unknown):
    """As if the third and its matrix were not there; of two, or where one is known, the first alone."""
    third = XYZ_TO_CAMERA @ np.diag([1.1, 1, 0.8])
    matrices, codes = [WARM, XYZ_TO_CAMERA, third], [17, 21, 23]
    others = [i for i in range(3) if i != unknown]
    extra = [(code, 3, 1, 0 if i == unknown else codes[i]) for i, code in enumerate((50778, 50779, 52529))]
    got = in_light(tmp_path / "a.dng", *extra, matrix(52531, third), xy=(0.37, 0.37))
    known = [(code, 3, 1, codes[i]) for code, i in zip((50778, 50779), others)]
    two = [matrix(code, matrices[i]) for code, i in zip((50721, 50722), others)]
    want = in_light(tmp_path / "b.dng", *known, *two, xy=(0.37, 0.37))
    np.testing.assert_allclose(got.xyz_to_camera, want.xyz_to_camera, atol=1e-9)
    np.testing.assert_allclose(got.white_balance, want.white_balance)
    assert got.notes == (f"the light of its ColorMatrix{unknown + 1} is unknown: the others are used",)
    alone = in_light(tmp_path / "c.dng", extra[unknown], matrix(52531, third), (50778, 3, 1, 0))
    assert "ColorMatrix1 alone is used" in alone.notes[0]
    np.testing.assert_allclose(alone.xyz_to_camera, WARM, atol=1e-6)


def test_a_white_balance_that_is_odd_is_told_where_another_counts(tmp_path):
    white = [(50728, 5, 3, (1, 10**6, 1, 1, 1, 1)), (50729, 5, 2, rationals(D65))]
    raw = read_raw(dng(tmp_path / "a.dng", extra_tags=white))
    assert len(raw.notes) == 1 and "AsShotNeutral" in raw.notes[0]
    both = [(50728, 5, 3, (0, 0) * 3), (50729, 5, 2, (0, 0) * 2)]
    notes = read_raw(dng(tmp_path / "b.dng", extra_tags=both)).notes
    assert len(notes) == 1 and "AsShotWhiteXY gives no white balance" in notes[0]


@pytest.mark.parametrize("one", [0, 1], ids=["ForwardMatrix1", "ForwardMatrix2"])
def test_a_forward_matrix_alone_is_used_in_any_light(tmp_path, one):
    forward = colour.RGB_COLOURSPACES["ProPhoto RGB"].matrix_RGB_to_XYZ
    lights = (50778, 3, 1, 17), (50779, 3, 1, 21)
    got = in_light(tmp_path / "a.dng", *lights, matrix((50964, 50965)[one], forward))
    both = in_light(tmp_path / "b.dng", *lights, matrix(50964, forward), matrix(50965, forward))
    none = in_light(tmp_path / "c.dng", *lights)
    np.testing.assert_allclose(got.camera_to_srgb, both.camera_to_srgb, atol=1e-9)
    assert np.abs(none.camera_to_srgb - both.camera_to_srgb).max() > 0.1


def test_a_camera_calibration_counts_for_its_own_profile(tmp_path):
    unit = matrix(50723, np.diag([1.2, 1, 0.8]))

    def read(*extra):
        return read_raw(dng(tmp_path / "a.dng", extra_tags=extra))

    def signed(ours, theirs):
        return read(unit, (50931, 2, 0, ours), (50932, 2, 0, theirs))

    plain, applied = read(), read(unit)
    assert np.abs(plain.camera_to_srgb - applied.camera_to_srgb).max() > 0.01
    np.testing.assert_array_equal(signed("com.adobe", "com.adobe").camera_to_srgb, applied.camera_to_srgb)
    for same in ((b"com.adobe\0\0", b"com.adobe\0"), ("", ""), (b"\x83\x81\x81", b"\x83\x81\x81")):
        np.testing.assert_array_equal(signed(*same).camera_to_srgb, applied.camera_to_srgb)
    # exactly, as they stand in the file, whatever their coding
    pairs = [("com.adobe", "somebody.else"), ("com.adobe ", "com.adobe"), (" com.adobe", "com.adobe"),
             ("com.adobe", "Com.Adobe"), (b"\x83\x81\x81", b"\x83\x81\x8d")]  # fmt: skip
    for other in (*(signed(*pair) for pair in pairs), read(unit, (50931, 2, 0, "com.adobe"))):
        np.testing.assert_array_equal(other.camera_to_srgb, plain.camera_to_srgb)
        assert "CameraCalibration1 is for another profile" in other.notes[0]


# --- levels ---


def test_grey_is_grey_where_the_black_differs_in_the_cell(tmp_path):
    """As LibRaw has it: one scale for all pixels."""
    black, neutral = np.array([64, 80, 96, 128]), np.array([0.5, 1, 1, 0.625])
    pixels = np.tile((black + 400 * neutral).reshape(2, 2), (40, 40)).astype(np.uint16)
    path = dng(tmp_path / "a.dng", pixels, black=black, as_shot_neutral=(0.5, 1, 0.625))
    raw = read_raw(path)
    grey = raw.mosaic[:2, :2].ravel() * raw.white_balance[[0, 1, 1, 2]]
    np.testing.assert_allclose(grey, 400 / (WHITE - 128), rtol=1e-5)
    with rawpy.imread(str(path)) as file:
        rgb = file.postprocess(
            use_camera_wb=True, output_color=rawpy.ColorSpace.raw, gamma=(1, 1), no_auto_bright=True,
            output_bps=16,
        )  # fmt: skip
    theirs = rgb[20:-20, 20:-20].mean((0, 1))
    np.testing.assert_allclose(theirs / theirs[1], grey[[0, 1, 3]] / grey[1], atol=0.003)


@pytest.mark.parametrize("dims", [(3, 5), (1, 80), (100, 2)])
def test_black_cells_of_any_size_with_row_and_column_terms(tmp_path, dims):
    rows, columns = dims
    cell = 40.0 + np.arange(rows * columns).reshape(dims) % 23
    down, across = np.arange(41) % 3, np.arange(58) % 7
    extra = [
        (50713, 3, 2, dims), (50714, 5, cell.size, tuple(v for c in cell.ravel() for v in (int(c), 1))),
        (50715, 10, 58, tuple(v for c in across for v in (int(c), 1))),
        (50716, 10, 41, tuple(v for c in down for v in (-int(c), 1))),
    ]  # fmt: skip
    y, x = np.mgrid[:41, :58]
    black = cell[y % rows, x % columns] + across[x] - down[y]
    pixels = (black + 300).astype(np.uint16)
    raw = read_raw(dng(tmp_path / "a.dng", pixels, crop=(1, 3, 40, 55), extra_tags=extra))
    np.testing.assert_allclose(raw.mosaic, 300 / (WHITE - black.max()), rtol=1e-5)
    assert raw.notes == ()


@pytest.mark.parametrize(
    ("extra", "words", "white"),
    [
        ((50717, 4, 1, 0), "WhiteLevel of 0 is not from 1 to 65535: 65535 is taken", 65535),
        ((50717, 4, 1, 2**32 - 1), "WhiteLevel of 4.29497e+09", 65535),
        ((50717, 4, 4, (16383, 15000, 15000, 14000)), "WhiteLevels differ: that of the first", 16383),
        ((50712, 3, 3, (1023, 512, 0)), "LinearizationTable falls", WHITE),
        ((50712, 3, 2, (500, 500)), "LinearizationTable is of one value", WHITE),
        ((50720, 4, 2, (71, 52)), "DefaultCrop ends outside of its 70 x 52 pixels", WHITE),
        ((50728, 5, 3, (1, 10**6, 1, 1, 1, 1)), "AsShotNeutral", WHITE),
        ((274, 3, 1, 9), "Orientation of 9", WHITE),
        ((50715, 10, 3, (1, 1) * 3), "BlackLevelDeltaH has 3 numbers for 70 pixels", WHITE),
        ((50716, 10, 3, (1, 1) * 3), "BlackLevelDeltaV has 3 numbers for 52 pixels", WHITE),
        ((50707, 1, 4, b"\1\x09\0\0"), "readers of DNG 1.9.0.0", WHITE),
        ((50730, 10, 1, (99, 1)), "BaselineExposure of 99 EV", WHITE),
        ((50718, 5, 2, (9, 1, 1, 1)), "DefaultScale is not two numbers", WHITE),
        ((51125, 5, 4, (0, 1, 0, 1, 1, 2, 1, 1)), "DefaultUserCrop is not applied", WHITE),
        ((50940, 11, 4, (0.0, 0.0, 1.0, 1.0)), "ProfileToneCurve is not applied", WHITE),
        ((50831, 7, 8, bytes(8)), "AsShotICCProfile is not applied", WHITE),
        ((50879, 3, 1, 1), "ColorimetricReference", WHITE),
        ((50727, 5, 3, (0, 1) * 3), "AnalogBalance", WHITE),
        ((50728, 5, 3, (0, 1) * 3), "AsShotNeutral", WHITE),
        ((50733, 4, 1, 100), "its BayerGreenSplit of 100 is not applied", WHITE),
        ((50734, 5, 1, (9, 10)), "its LinearResponseLimit of 0.9 is not applied", WHITE),
        ((50739, 5, 1, (2, 1)), "its ShadowScale of 2 is not applied", WHITE),
        ((50780, 5, 1, (3, 2)), "its BestQualityScale of 1.5 is not applied", WHITE),
        ((51110, 4, 1, 0), "its DefaultBlackRender of 0 is not applied", WHITE),
        ((50830, 4, 4, (0, 0, 52, 2)), "its MaskedAreas is not applied", WHITE),
        ((50939, 11, 3, (0.0, 1.0, 1.0)), "its ProfileHueSatMap is not applied", WHITE),
        ((52537, 11, 3, (0.0, 1.0, 1.0)), "its ProfileHueSatMap is not applied", WHITE),
        ((52551, 7, 8, struct.pack("<2Hf", 1, 1, 4)), "its ProfileDynamicRange (HDR) is not applied", WHITE),
        ((52551, 7, 3, b"\1\0\1"), "its ProfileDynamicRange (HDR) is not applied", WHITE),
        ((50721, 10, 9, (1, 1) * 9), "ColorMatrix cannot be used", WHITE),
        ((50778, 4, 1, 2**32 - 1), "CalibrationIlluminant1 of 4.29497e+09 is no light source", WHITE),
        ((50778, 3, 1, 5), "CalibrationIlluminant1 of 5 is no light source", WHITE),
        ((50778, 12, 1, float("nan")), "CalibrationIlluminant1 of nan is no light source", WHITE),
        ((50778, 12, 1, 1e300), "CalibrationIlluminant1 of 1e+300 is no light source", WHITE),
        ((34855, 4, 1, 2**32 - 1), "ISO of 4.29497e+09 is that of no camera", WHITE),
        ((34855, 5, 1, (1, 2**32 - 1)), "ISO of 2.32831e-10 is that of no camera", WHITE),
        ((33434, 5, 1, (1, 2**32 - 1)), "ExposureTime of 2.32831e-10 is that of no camera", WHITE),
        ((50727, 5, 3, (2**32 - 1, 1, 1, 1, 1, 1)), "AnalogBalance is not three numbers", WHITE),
        ((50721, 12, 9, tuple(1e30 * np.eye(3).ravel())), "ColorMatrix cannot be used", WHITE),
        ((50721, 12, 9, tuple(1e-9 * np.eye(3).ravel())), "ColorMatrix cannot be used", WHITE),
        ((50714, 3, 4, (WHITE - 1,) * 4), "leaves less than half of its WhiteLevel", WHITE),
    ],
)  # fmt: skip
def test_what_is_not_used_as_it_is_stated_is_told(tmp_path, extra, words, white):
    raw = read_raw(dng(tmp_path / "a.dng", extra_tags=[extra]))
    assert len(raw.notes) == 1 and words in raw.notes[0] and "\n" not in raw.notes[0]
    assert raw.white == white and np.isfinite(raw.mosaic).all()


@pytest.mark.parametrize(
    ("extra", "name"),
    [
        ((50714, 9, 4, (-1000,) * 4), "BlackLevel"),
        ((50714, 12, 4, (float("nan"),) * 4), "BlackLevel"),
        ((50712, 11, 1, float("nan")), "LinearizationTable"),
        ((50712, 5, 1, (0, 0)), "LinearizationTable"),
    ],
)
def test_levels_that_are_none_are_refused(tmp_path, extra, name):
    with pytest.raises(InputError, match=f"a.dng: has a damaged {name}"):
        read_raw(dng(tmp_path / "a.dng", extra_tags=[extra]))


def test_the_exposure_offset_of_the_profile_adds_to_the_baseline(tmp_path):
    extra = [(50730, 10, 1, (3, 2)), (51109, 10, 1, (-1, 4))]
    assert read_raw(dng(tmp_path / "a.dng", extra_tags=extra)).baseline_exposure == 1.25
    extra = [(50730, 10, 1, (0, 0)), (51109, 10, 1, (1, 4))]
    assert read_raw(dng(tmp_path / "b.dng", extra_tags=extra)).baseline_exposure == 0.25


def test_colours_that_are_not_stated_are_told(tmp_path):
    assert read_raw(dng(tmp_path / "a.dng", color_matrix=None)).notes == (
        "it states no ColorMatrix: colours stay the camera's",
    )
    path = tmp_path / "b.dng"
    data = dng(path).read_bytes().replace(struct.pack("<HHL", 50728, 5, 3), struct.pack("<HHL", 50727, 5, 3))
    path.write_bytes(data)
    assert read_raw(path).notes == ("it states no white balance",)


def test_a_value_that_is_not_in_the_file_is_told(tmp_path):
    path = dng(tmp_path / "a.dng", extra_tags=[(51041, 12, 2, (1e-4, 1e-6))])
    whole, data = read_raw(path), bytearray(path.read_bytes())
    entry = data.index(struct.pack("<HHL", 51041, 12, 2))
    assert whole.notes == () and whole.noise_profile is not None
    for place in (0xFFFFFFFF, len(data) - 1):
        data[entry + 8 : entry + 12] = struct.pack("<L", place)
        path.write_bytes(data)
        cut = read_raw(path)
        assert cut.notes == ("tag 51041 states a value that is not in the file: it is left out",)
        assert cut.noise_profile is None


def test_a_plain_file_has_no_notes(tmp_path):
    extra = [(50717, 4, 1, 1024), (51125, 5, 4, (0, 1, 0, 1, 1, 1, 1, 1)), (50730, 10, 1, (0, 0))]
    assert read_raw(dng(tmp_path / "a.dng")).notes == ()
    extra += [
        (50733, 4, 1, 0), (50734, 5, 1, (1, 1)), (50739, 5, 1, (1, 1)), (51110, 4, 1, 1),
        (50780, 5, 1, (1, 1)), (52551, 7, 8, struct.pack("<2Hf", 1, 0, 1)),
    ]  # fmt: skip
    raw = read_raw(dng(tmp_path / "b.dng", extra_tags=extra))
    assert (raw.notes, raw.baseline_exposure) == ((), 0)


def test_all_that_is_not_applied_is_one_line(tmp_path):
    tags = [(50938, 11, 3, (0.0, 1.0, 1.0)), (50939, 11, 3, (0.0, 1.0, 1.0)), (50739, 5, 1, (2, 1))]
    raw = read_raw(dng(tmp_path / "a.dng", extra_tags=tags))
    assert raw.notes == ("its ProfileHueSatMap, ShadowScale of 2 are not applied",)


@pytest.mark.parametrize(
    "values",
    [(1e-3,), (1e-3, 1e-6, 1e-3), (1e-3, 1e-6) * 2, (1e308, 1e-6), (-1e-3, 1e-6), (float("nan"), 0.0)],
)
def test_a_noise_profile_of_no_use_is_told(tmp_path, values):
    raw = read_raw(dng(tmp_path / "a.dng", extra_tags=[(51041, 12, len(values), values)]))
    assert raw.noise_profile is None and "NoiseProfile" in raw.notes[0]


# --- lens ---

GAINS = np.array([[[2.0, 1.0, 1.5], [1.0, 1.25, 1.0]], [[1.0, 1.0, 1.0], [2.0, 1.0, 1.5]]])


def expected(gains: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W, planes) of a grid of 2x2 corners that spans the area."""
    y, x = ((np.arange(n) + 0.5) / n for n in shape)
    return np.einsum("yi,ijc,xj->yxc", np.stack([1 - y, y], 1), gains, np.stack([1 - x, x], 1))


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
@pytest.mark.parametrize("crop", [None, (3, 5, 30, 41)])
def test_maps_of_three_planes_for_the_demosaicked_picture(tmp_path, cfa, crop):
    """Every pixel has the gain of its own colour; of two maps, one for green alone, the product."""
    shape = 52, 70
    maps = [
        GainMap(GAINS, (0, 0, *shape), planes=3),
        GainMap(np.full((1, 1, 1), 1.5), (0, 0, *shape), plane=1, planes=1),
    ]
    raw = read_raw(dng(tmp_path / "a.dng", mosaic(*shape), cfa=cfa, opcodes_3=maps, crop=crop))
    y, x = np.mgrid[: shape[0], : shape[1]]
    colors = np.array(["RGB".index(c) for c in cfa]).reshape(2, 2)[y % 2, x % 2]
    gain = np.take_along_axis(expected(GAINS, shape), colors[..., None], -1)[..., 0]
    gain = gain * np.where(colors == 1, 1.5, 1)
    top, left, height, width = crop or (0, 0, *shape)
    np.testing.assert_allclose(raw.shading, gain[top : top + height, left : left + width], rtol=1e-5)
    assert raw.cfa == shifted(cfa, top, left) and raw.notes == ()


def test_planes_beyond_those_of_a_map_have_its_last(tmp_path):
    flat = GainMap(np.array([[[2.0, 3.0]]]), (0, 0, 52, 70), planes=3)
    raw = read_raw(dng(tmp_path / "a.dng", opcodes_3=[flat]))
    np.testing.assert_array_equal(raw.shading[:2, :2], [[2, 3], [3, 3]])


def test_every_known_opcode_of_either_list_counts(tmp_path):
    terms = np.array([0.4, -0.1, 0.05, 0.02, -0.01])
    vignette, flat = (
        FixVignetteRadial(terms, (0.5, 0.5)),
        GainMap(np.full((1, 1, 1), 2.0), (0, 0, 41, 61), planes=3),
    )
    once = read_raw(dng(tmp_path / "a.dng", mosaic(41, 61), opcodes_3=[vignette])).shading
    for name, before, after in (("b", [vignette, flat, flat], []), ("c", [flat, vignette], [flat])):
        raw = read_raw(dng(tmp_path / f"{name}.dng", mosaic(41, 61), gain_map=before, opcodes_3=after))
        np.testing.assert_allclose(raw.shading, 4 * once, rtol=1e-6)
    twice = read_raw(dng(tmp_path / "d.dng", mosaic(41, 61), gain_map=[vignette], opcodes_3=[vignette]))
    np.testing.assert_allclose(twice.shading, once**2, rtol=1e-6)


def opcode(kind: int, optional: bool = False) -> bytes:
    return struct.pack(">L4L", 1, kind, 0x01030000, int(optional), 0)


@pytest.mark.parametrize("code", [51008, 51009, 51022])
def test_opcodes_that_are_not_applied_are_told(tmp_path, code):
    number = {51008: 1, 51009: 2, 51022: 3}[code]
    for kind, name in ((5, "FixBadPixelsList"), (99, "an opcode of unknown kind 99")):
        raw = read_raw(dng(tmp_path / "a.dng", extra_tags=[undefined(code, opcode(kind))]))
        assert raw.notes == (f"its OpcodeList{number} has {name}, which is not applied",)
    raw = read_raw(dng(tmp_path / "a.dng", extra_tags=[undefined(code, opcode(8, True))]))
    assert raw.notes == (f"its OpcodeList{number} has MapPolynomial (optional), which is not applied",)


def test_maps_for_what_a_mosaic_is_not_are_told(tmp_path):
    flat = GainMap(np.full((1, 1, 1), 2.0), (0, 0, 52, 70), plane=1)
    raw = read_raw(dng(tmp_path / "a.dng", gain_map=[flat]))
    assert raw.shading is None and "OpcodeList2 has GainMap" in raw.notes[0]
    raw = read_raw(dng(tmp_path / "b.dng", extra_tags=[undefined(51008, pack_opcodes([flat]))]))
    assert raw.shading is None and "OpcodeList1 has GainMap" in raw.notes[0]


@pytest.mark.parametrize("gain", [-1.0, 0.0, 1e-4, 2e4, 1e38])
def test_gains_of_no_lens_are_refused(tmp_path, gain):
    """Two together are what overflows, or leaves nothing."""
    maps = [GainMap(np.full((2, 2, 1), gain), (0, 0, 52, 70))] * 2
    refused(dng(tmp_path / "a.dng", gain_map=maps), "GainMap with gains from")
    refused(dng(tmp_path / "b.dng", gain_map=maps[:1], opcodes_3=maps[1:]), "GainMap with gains from")
    dark = FixVignetteRadial(np.array([-2.0, 0, 0, 0, 0]), (0.5, 0.5))
    refused(dng(tmp_path / "c.dng", opcodes_3=[dark]), "FixVignetteRadial with gains from -1")


# --- layout ---


@pytest.mark.parametrize(("rows", "columns"), [(2, 1), (1, 2), (2, 2), (3, 5)])
def test_interleaved_pixels_are_put_in_place(tmp_path, rows, columns):
    pixels = mosaic(41, 58)
    order = [np.concatenate([np.arange(i, n, f) for i in range(f)]) for n, f in ((41, rows), (58, columns))]
    extra = [(50975, 4, 1, rows), (52547, 4, 1, columns)]
    stored = pixels[np.ix_(*order)]
    raw = read_raw(dng(tmp_path / "a.dng", stored, extra_tags=extra, active_area=(1, 2, 41, 58)))
    want = read_raw(dng(tmp_path / "b.dng", pixels, active_area=(1, 2, 41, 58)))
    np.testing.assert_array_equal(raw.mosaic, want.mosaic)


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ((50711, 3, 1, 2), "CFALayout 2"),
        ((50974, 3, 2, (2, 1)), "SubTileBlockSize"),
        ((50975, 4, 1, 0), "RowInterleaveFactor"),
        ((52547, 4, 1, 4096), "ColumnInterleaveFactor"),
    ],
)
def test_other_layouts_are_refused_by_name(tmp_path, extra, words):
    refused(dng(tmp_path / "a.dng", extra_tags=[extra]), words)


def test_several_samples_a_pixel_are_refused(tmp_path):
    refused(_patched(dng(tmp_path / "a.dng"), 277, struct.pack("<H", 2)), "2 samples a pixel")


def jpeg_dng(path, parts, tile=None):
    """A DNG whose pixels are these streams of lossless JPEG: one strip of 64x96, or tiles."""
    tags = [
        (50706, 1, 4, b"\1\4\0\0", True), (33421, 3, 2, (2, 2), True), (33422, 1, 4, b"\0\1\1\2", True),
        (50714, 3, 1, 64, True), (50717, 3, 1, WHITE, True),
    ]  # fmt: skip
    shape = {"tile": tile} if tile else {"rowsperstrip": 64}
    with tifffile.TiffWriter(path) as tif:
        tif.write(
            iter(parts), shape=(64, 96), dtype=np.uint16, compression=7, photometric=32803, metadata=None,
            extratags=tags, **shape,
        )  # fmt: skip
    return path


def test_lossless_jpeg_that_is_not_whole_is_refused(tmp_path, capfd):
    """LibRaw takes zeros, and what stands where the data were, for pixels."""
    y, x = np.mgrid[:64, :96]
    pixels = (200 + x + y).astype(np.uint16)
    data = imagecodecs.ljpeg_encode(pixels, bitspersample=14)
    half = len(data) // 2
    whole = read_raw(jpeg_dng(tmp_path / "whole.dng", [data + bytes(3)]))
    np.testing.assert_allclose(whole.mosaic * (WHITE - 64) + 64, pixels, atol=1e-3)
    for name, bad in {
        "cut": data[:half], "zeros": data[:half] + bytes(len(data) - half), "ended": data[:half] + data[-2:],
        "ones": data[:half] + b"\xff\0" * half, "middle": data[: half // 2] + data[half:],
    }.items():  # fmt: skip
        refused(jpeg_dng(tmp_path / f"{name}.dng", [bad]), "")
    short = imagecodecs.ljpeg_encode(pixels[:32], bitspersample=14)
    refused(jpeg_dng(tmp_path / "short.dng", [short]), "a JPEG of 3072 samples for 6144 RAW pixels")
    lossy = imagecodecs.jpeg8_encode((pixels // 4).astype(np.uint8))
    refused(jpeg_dng(tmp_path / "lossy.dng", [lossy]), "no lossless JPEG")
    assert capfd.readouterr().err == "", "a library wrote beside the error"


@pytest.mark.parametrize("components", [1, 2])
@pytest.mark.parametrize("predictor", range(1, 8))
def test_lossless_jpeg_whose_middle_is_lost_is_refused(tmp_path, predictor, components):
    """It still has its end; another's encoder (libjpeg-turbo's) writes all kinds."""
    rng = np.random.default_rng(predictor)
    pixels = (300 + 100 * np.sin(np.arange(96) / 9) + rng.normal(0, 8, (64, 96))).astype(np.uint16)
    shape = (64, 96) if components == 1 else (64, 48, 2)
    options = {"lossless": True, "predictor": predictor, "bitspersample": 12}
    data = imagecodecs.jpeg8_encode(pixels.reshape(shape), **options)
    whole = read_raw(jpeg_dng(tmp_path / "a.dng", [data]))
    np.testing.assert_allclose(whole.mosaic * (WHITE - 64) + 64, pixels, atol=1e-3)
    first, last = len(data) // 3, 5 * len(data) // 6
    noise = rng.integers(0, 255, last - first, np.uint8).tobytes()  # without markers
    for lost in (bytes(last - first), noise, b""):
        refused(jpeg_dng(tmp_path / "b.dng", [data[:first] + lost + data[last:]]), "")


def test_tiles_that_are_not_there_are_refused(tmp_path):
    y, x = np.mgrid[:64, :96]
    pixels = (200 + 3 * x + y).astype(np.uint16)
    tiles = [pixels[i : i + 32, j : j + 48] for i in (0, 32) for j in (0, 48)]
    parts = [imagecodecs.ljpeg_encode(np.ascontiguousarray(t), bitspersample=14) for t in tiles]
    raw = read_raw(jpeg_dng(tmp_path / "a.dng", parts, (32, 48)))
    np.testing.assert_allclose(raw.mosaic * (WHITE - 64) + 64, pixels, atol=1e-3)
    for name, change in {"none": lambda v: (*v[:3], 0), "fewer": lambda v: v[:3]}.items():
        (tmp_path / f"{name}.dng").write_bytes((tmp_path / "a.dng").read_bytes())
        with tifffile.TiffFile(tmp_path / f"{name}.dng", mode="r+b") as tif:
            tags = tif.pages[0].tags
            for code in (325,) if name == "none" else (324, 325):
                tags[code].overwrite(change(tags[code].value))
        refused(tmp_path / f"{name}.dng", "3 of 4 strips or tiles")


@pytest.mark.parametrize(("code", "name"), [(34892, "lossy JPEG"), (52546, "JPEG XL"), (8, "Deflate")])
def test_the_compression_that_is_not_read_is_named(tmp_path, code, name):
    path = dng(tmp_path / "a.dng")
    data = path.read_bytes()
    old = struct.pack("<HHI", 259, 3, 1) + struct.pack("<H", 1)
    assert old in data
    path.write_bytes(data.replace(old, old[:-2] + struct.pack("<H", code)))
    refused(path, f"compressed with {name}")


def test_standard_error_is_open_again_after_many_threads(tmp_path, capfd):
    (tmp_path / "a.nef").write_bytes(np.random.default_rng(0).bytes(5000))
    good = dng(tmp_path / "b.dng")

    def read(i):
        try:
            return read_raw(good if i % 2 else tmp_path / "a.nef").cfa
        except InputError:
            return None

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(read, range(40))) == [None, "RGGB"] * 20
    os.write(2, b"heard\n")
    assert capfd.readouterr().err == "heard\n"


# --- the shot ---


@pytest.mark.parametrize(
    ("extra", "iso"),
    [
        ([], None),
        ([(34864, 3, 1, 2), (34866, 4, 1, 102400)], 102400),
        ([(34864, 3, 1, 1), (34865, 4, 1, 204800), (34866, 4, 1, 102400)], 204800),
        ([(34864, 3, 1, 3), (34867, 4, 1, 409600)], 409600),
        ([(34866, 4, 1, 102400)], 102400),
        ([(34855, 3, 2, (400, 0)), (34866, 4, 1, 102400)], 400),
        ([(34855, 3, 2, (65535, 65535)), (34866, 4, 1, 102400)], 102400),
    ],
)
def test_speed_above_what_its_tag_can_say(tmp_path, extra, iso):
    assert read_raw(dng(tmp_path / "a.dng", extra_tags=[(34855, 3, 1, 65535), *extra])).iso == iso


ISO, TYPE, OUTPUT, INDEX, SPEED, SECONDS = 34855, 34864, 34865, 34866, 34867, 33434


def with_exif(path, *tags):
    """A DNG whose EXIF directory holds these tags (code, type, count, value of 4 bytes or 8), and whose first
    directory states no speed and no time."""
    data, extra = bytearray(dng(path, extra_tags=[(34660, 4, 1, 1)]).read_bytes()), b""
    start = len(data)
    for code, kind, other in ((ISO, 3, 34850), (SECONDS, 5, 33437), (34660, 4, 34665)):
        at = data.index(struct.pack("<HHL", code, kind, 1))
        data[at : at + 2] = struct.pack("<H", other)
    data[at + 8 : at + 12] = struct.pack("<L", start)
    table, behind = struct.pack("<H", len(tags)), start + 2 + 12 * len(tags) + 4
    for code, kind, count, value in sorted(tags):
        if len(value) > 4:
            table += struct.pack("<HHLL", code, kind, count, behind + len(extra))
            extra += value
        else:
            table += struct.pack("<HHL", code, kind, count) + value.ljust(4, b"\0")
    path.write_bytes(bytes(data) + table + bytes(4) + extra)
    return path


def short(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}H", *values)


def long(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}L", *values)


@pytest.mark.parametrize(
    ("tags", "iso"),
    [
        ([(ISO, 3, 1, short(400))], 400),
        ([(ISO, 3, 2, short(0, 800))], 800),
        ([(ISO, 3, 2, short(100, 200))], 100),
        ([(ISO, 3, 1, short(0))], None),
        ([(ISO, 3, 1, short(65535))], None),
        ([(ISO, 4, 1, long(204800))], 204800),
        ([(ISO, 3, 1, short(65535)), (TYPE, 3, 1, short(2)), (INDEX, 4, 1, long(102400))], 102400),
        ([(TYPE, 3, 1, short(2)), (INDEX, 4, 1, long(12800))], 12800),
        ([(TYPE, 3, 1, short(1)), (OUTPUT, 4, 1, long(250)), (INDEX, 4, 1, long(200))], 250),
        ([(OUTPUT, 4, 1, long(250))], 250),
        ([(SPEED, 4, 1, long(64))], 64),
        ([], None),
    ],
)
def test_speeds_of_the_exif_directory(tmp_path, tags, iso):
    """By the rule that pictures have."""
    assert read_raw(with_exif(tmp_path / "a.dng", *tags)).iso == iso


@pytest.mark.parametrize(
    ("value", "seconds"), [((1, 50), 0.02), ((1, 0), None), ((0, 1), None), ((0, 0), None), ((30, 1), 30)]
)
def test_exposure_times(tmp_path, value, seconds):
    """In EXIF and in the first directory; 1/0 is no time."""
    assert read_raw(with_exif(tmp_path / "a.dng", (SECONDS, 5, 1, long(*value)))).exposure_time == seconds
    path = dng(tmp_path / "b.dng", extra_tags=[(SECONDS, 5, 1, value)])
    assert read_raw(path).exposure_time == seconds
    below = dng(tmp_path / "c.dng", extra_tags=[(SECONDS, 10, 1, (-1, 50))])
    assert read_raw(below).exposure_time is None


@pytest.mark.parametrize("speed", [[(34855, 3, 2, (0, 800))], [(34855, 3, 1, 0), (34866, 4, 1, 800)]])
def test_speeds_of_the_first_directory(tmp_path, speed):
    assert read_raw(dng(tmp_path / "a.dng", extra_tags=speed)).iso == 800


@pytest.mark.parametrize("iso", [100, 65535, 102400])
@pytest.mark.parametrize("seconds", [1 / 8000, 30.5, 5000.123456, 1e-8, 2.4e-10, 3e9])
def test_what_is_written_is_read(tmp_path, iso, seconds):
    raw = read_raw(
        dng(tmp_path / "a.dng", iso=iso, exposure_time=seconds, make="Bölts & Söhne", model="相機")
    )
    assert (raw.iso, raw.make, raw.model) == (iso, "Bölts & Söhne", "相機")
    assert raw.exposure_time == pytest.approx(seconds, rel=1e-6)


@pytest.mark.parametrize(
    ("stated", "make"),
    [
        ("Größe".encode("latin-1"), "Größe"),
        (b"\x81\x8d", "\x81\x8d"),  # no UTF-8 and not in Windows' alphabet
        (b"  MAKER  \0\0", "MAKER"),
        (b"MAKER\0of RAW", "MAKER"),
    ],
)
def test_text_that_is_not_utf_8(tmp_path, stated, make):
    """By the rule that pictures have."""
    assert read_raw(dng(tmp_path / "a.dng", extra_tags=[(271, 2, 0, stated)])).make == make


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"iso": 0}, "ISO 0 cannot be written, expected 1 to"),
        ({"iso": 0.5}, "ISO 0.5 cannot be written"),
        ({"iso": 2**32}, "ISO 4.29497e"),
        ({"exposure_time": 0}, "exposure_time = 0 s"),
        ({"exposure_time": 1e-10}, "exposure_time = 1e-10 s"),
        ({"exposure_time": 1e10}, "exposure_time"),
        ({"exposure_time": float("nan")}, "exposure_time"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, options, words):
    with pytest.raises(ValueError, match=words):
        dng(tmp_path / "a.dng", **options)
