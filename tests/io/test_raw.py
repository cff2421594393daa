"""Reading RAW files: levels, phase, metadata, and every way a file can be bad."""

import itertools
import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageOps

from jaxisp.cfa import PATTERNS, shifted
from jaxisp.errors import InputError
from jaxisp.io.jpeg import encode_jpeg
from jaxisp.io.libraw import embedded_jpeg
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, WarpRectilinear
from jaxisp.io.orientation import INVERSE, orient, unorient
from jaxisp.io.raw import read_raw
from tests.io.samples import BLACK, NEUTRAL, WHITE, dng, mosaic


def refused(path, words: str) -> None:
    """Reading raises InputError of one line that names the file and holds the words."""
    with pytest.raises(InputError) as caught:
        read_raw(path)
    text = str(caught.value)
    assert str(path) in text and "\n" not in text and words in text, text


def normalised(pixels: np.ndarray, black=BLACK) -> np.ndarray:
    """Closed form of black and white scaling, from the top-left of the active area."""
    height, width = pixels.shape
    plane = np.tile(np.reshape(black, (2, 2)), (height // 2 + 1, width // 2 + 1))[:height, :width]
    return (pixels.astype(np.float64) - plane) / (WHITE - np.max(black))


@pytest.mark.parametrize("cfa", PATTERNS)
def test_levels_and_header(tmp_path, cfa):
    pixels = mosaic(41, 58)
    path = dng(
        tmp_path / "a.dng", pixels, cfa=cfa, iso=800, orientation=8, make="Maker", model="Phone 1",
        exposure_time=0.02,
        noise_profile=np.array([[1e-3, 1e-6], [2e-3, 4e-6], [3e-3, 9e-6]]),
    )  # fmt: skip
    raw = read_raw(path)
    assert raw.mosaic.dtype == np.float32 and raw.cfa == cfa
    np.testing.assert_allclose(raw.mosaic, normalised(pixels), atol=1e-6)
    assert raw.mosaic.min() < 0
    np.testing.assert_array_equal(raw.black, BLACK)
    np.testing.assert_allclose(raw.white_balance, 1 / np.array(NEUTRAL))
    np.testing.assert_allclose(raw.noise_profile, [[1e-3, 1e-3], [2e-3, 2e-3], [3e-3, 3e-3]])
    np.testing.assert_allclose(raw.camera_to_srgb.sum(1), 1)
    assert (raw.white, raw.iso, raw.exposure_time, raw.orientation) == (WHITE, 800, 0.02, 8)
    assert (raw.make, raw.model, raw.white_balanced, raw.gain_map) == ("Maker", "Phone 1", False, None)


@pytest.mark.parametrize("area", [None, (3, 2, 49, 67), (2, 5, 51, 70), (1, 1, 50, 69)])
@pytest.mark.parametrize("crop", [None, (5, 7, 30, 41), (2, 4, 31, 40), (1, 2, 32, 33)])
def test_phase_and_black_after_odd_crops(tmp_path, area, crop):
    """Each photosite holds its own colour's level, so a wrong phase or a shift of one pixel shows."""
    cfa = "GBRG"
    top, left, bottom, right = area or (0, 0, 52, 70)
    y, x = np.mgrid[0:52, 0:70]
    color = np.array(["RGB".index(c) for c in cfa]).reshape(2, 2)[(y - top) % 2, (x - left) % 2]
    pixels = (200 * (color + 1) + y + x).astype(np.uint16)
    raw = read_raw(dng(tmp_path / "a.dng", pixels, cfa=cfa, active_area=area, crop=crop))
    rows, columns, height, width = crop or (0, 0, bottom - top, right - left)
    window = np.s_[top + rows : top + rows + height, left + columns : left + columns + width]
    active = normalised(pixels[top:bottom, left:right])[rows : rows + height, columns : columns + width]
    np.testing.assert_allclose(raw.mosaic, active, atol=1e-6)
    assert raw.crop == (rows, columns, height, width) and raw.active_area == (top, left, bottom, right)
    assert raw.cfa == shifted(cfa, rows, columns)
    for i, j in itertools.product((0, 1), (0, 1)):
        expected = "RGB".index(raw.cfa[2 * i + j])
        assert (color[window][i::2, j::2] == expected).all()
        assert raw.black[2 * i + j] == BLACK[2 * ((i + rows) % 2) + (j + columns) % 2]


def test_libraw_agrees_on_the_phase_of_an_odd_active_area(tmp_path):
    """LibRaw renders a pure red scene red where our pattern says so."""
    area = (3, 5, 51, 69)
    y, x = np.mgrid[0:52, 0:70]
    red = ((y - area[0]) % 2 == 0) & ((x - area[1]) % 2 == 1)
    path = dng(
        tmp_path / "a.dng",
        np.where(red, 900, 64).astype(np.uint16),
        cfa="GRBG",
        black=(64,),
        active_area=area,
    )
    raw = read_raw(path)
    assert raw.cfa == "GRBG" and raw.mosaic[0::2, 1::2].min() > 0.8
    with rawpy.imread(str(path)) as other:
        image = other.postprocess(output_color=rawpy.ColorSpace.raw, no_auto_bright=True, use_camera_wb=True)
    middle = image[8:-8, 8:-8].reshape(-1, 3).mean(0)
    assert middle[0] > 200 and middle[1:].max() < 20


def test_row_and_column_black(tmp_path):
    pixels = mosaic(25, 30)
    columns, rows = np.arange(30) * 0.5, -np.arange(25) * 1.0
    extra = [
        (50715, 10, 30, tuple(v for c in columns for v in (int(c * 2), 2))),
        (50716, 10, 25, tuple(v for r in rows for v in (int(r), 1))),
    ]
    raw = read_raw(dng(tmp_path / "a.dng", pixels, black=(64,), extra_tags=extra))
    black = 64 + columns[None] + rows[:, None]
    np.testing.assert_allclose(raw.mosaic, (pixels - black) / (WHITE - black.max()), atol=1e-6)


def test_linearization_table_is_applied_once(tmp_path):
    pixels = np.arange(64 * 64, dtype=np.uint16).reshape(64, 64) % 256
    table = tuple(int(v) for v in (np.arange(256) ** 2) // 64)
    raw = read_raw(dng(tmp_path / "a.dng", pixels, black=(0,), extra_tags=[(50712, 3, 256, table)]))
    np.testing.assert_allclose(raw.mosaic * WHITE, np.array(table)[pixels], atol=1e-3)


def test_opcodes_and_shading_after_a_crop(tmp_path):
    gains = np.linspace(1, 2, 12).reshape(3, 4, 1)
    maps = [GainMap(gains, (0, 0, 52, 70), spacing=(0.5, 1 / 3))]
    after = [WarpRectilinear(np.ones((1, 6)), (0.5, 0.5)), FixVignetteRadial(np.arange(5.0), (0.5, 0.5))]
    whole = read_raw(dng(tmp_path / "a.dng", gain_map=maps, opcodes_3=after))
    np.testing.assert_allclose(whole.gain_map[0].gains, gains, rtol=1e-6)
    np.testing.assert_array_equal(whole.vignette.coefficients, np.arange(5.0))
    assert whole.warp.coefficients.shape == (1, 6)
    cropped = read_raw(dng(tmp_path / "b.dng", gain_map=maps, opcodes_3=after, crop=(3, 5, 40, 51)))
    np.testing.assert_array_equal(cropped.shading, whole.shading[3:43, 5:56])
    np.testing.assert_array_equal(cropped.mosaic, read_raw(dng(tmp_path / "c.dng")).mosaic[3:43, 5:56])


def test_vignetting_is_shading(tmp_path):
    """1 in the optical centre, 1 + k0 + ... + k4 in the farthest corner, beside gain maps."""
    terms = np.array([0.4, -0.1, 0.05, 0.02, -0.01])
    after = [FixVignetteRadial(terms, (0.25, 0.5))]
    raw = read_raw(dng(tmp_path / "a.dng", mosaic(41, 61), opcodes_3=after))
    assert raw.shading[20, 15] == 1
    np.testing.assert_allclose(raw.shading[[0, -1], -1], 1 + terms.sum(), rtol=1e-6)
    radius = np.hypot(20 - 7, 15 - 9) / np.hypot(20, 45)
    want = 1 + sum(k * radius ** (2 * i + 2) for i, k in enumerate(terms))
    np.testing.assert_allclose(raw.shading[7, 9], want, rtol=1e-6)
    doubled = [GainMap(np.full((1, 1, 1), 2.0), (0, 0, 41, 61))]
    both = read_raw(dng(tmp_path / "b.dng", mosaic(41, 61), gain_map=doubled, opcodes_3=after))
    np.testing.assert_allclose(both.shading, 2 * raw.shading, rtol=1e-6)


def test_missing_colour_matrix_is_none(tmp_path):
    raw = read_raw(dng(tmp_path / "a.dng", color_matrix=None))
    assert raw.calibration is None and raw.camera_to_srgb is None and raw.xyz_to_camera is None
    singular = read_raw(dng(tmp_path / "b.dng", color_matrix=np.ones((3, 3))))
    assert singular.camera_to_srgb is None


def test_white_xy_in_place_of_neutral(tmp_path):
    neutral = read_raw(dng(tmp_path / "a.dng")).calibration
    path = dng(tmp_path / "b.dng", extra_tags=[(50729, 5, 2, (3127, 10000, 3290, 10000))])
    data = path.read_bytes().replace(struct.pack("<HHL", 50728, 5, 3), struct.pack("<HHL", 50732, 5, 3))
    path.write_bytes(data)
    raw = read_raw(path)
    seen = neutral.at(np.array([0.3127, 0.329]))[0] @ [0.3127 / 0.329, 1, 0.3583 / 0.329]
    np.testing.assert_allclose(raw.white_balance, seen[1] / seen, rtol=1e-6)


def test_preview_first_then_raw_in_a_sub_directory(tmp_path):
    pixels = mosaic()
    picture = np.full((52, 70, 3), 90, np.uint8)
    data = encode_jpeg(picture, 95, "4:2:0")
    path = dng(tmp_path / "a.dng", pixels, preview=data, iso=250)
    raw = read_raw(path)
    np.testing.assert_allclose(raw.mosaic, normalised(pixels), atol=1e-6)
    assert raw.iso == 250 and raw.calibration is not None
    embedded = embedded_jpeg(path)
    assert embedded is not None and embedded[:2] == b"\xff\xd8"
    small = dng(tmp_path / "b.dng", pixels, preview=encode_jpeg(picture[::2, ::2]))
    assert embedded_jpeg(small) is None
    assert embedded_jpeg(dng(tmp_path / "c.dng", pixels)) is None


# --- mosaics without a header ---


def described(tmp_path, array, text='[raw]\ncfa = "GRBG"\nblack = 16\nwhite = 256\n'):
    (tmp_path / "dataset.toml").write_text(text)
    np.save(tmp_path / "a.raw.npy", array)
    return tmp_path / "a.raw.npy"


def test_npy(tmp_path):
    values = np.arange(7 * 9, dtype=np.uint16).reshape(1, 1, 7, 9)
    raw = read_raw(described(tmp_path, values))
    np.testing.assert_allclose(raw.mosaic, (values[0, 0] - 16.0) / 240, rtol=1e-6)
    assert raw.cfa == "GRBG" and not raw.white_balanced and raw.camera_to_srgb is None
    text = '[raw]\ncfa = "BGGR"\nblack = [0, 0.1, 0.2, 0.3]\nwhite = 1.0\nwhite_balanced = true\n'
    raw = read_raw(described(tmp_path, np.full((4, 6), 0.5, np.float32), text))
    np.testing.assert_allclose(raw.mosaic[:2, :2], np.array([[0.5, 0.4], [0.3, 0.2]]) / 0.7, rtol=1e-6)
    assert raw.white_balanced


def test_what_dataset_toml_states_of_one_stem_is_read(tmp_path):
    text = '[raw]\ncfa = "GRBG"\nwhite = 200\n[a.raw]\nwhite = 100\n[b.raw]\nblack = 8\n'
    raw = read_raw(described(tmp_path, np.full((4, 6), 50, np.uint16), text))
    np.testing.assert_array_equal(raw.mosaic, np.float32(0.5))
    raw = read_raw(dng(tmp_path / "b.dng", np.full((64, 64), 104, np.uint16), black=(0,)))
    np.testing.assert_array_equal(raw.mosaic, np.float32(0.5))
    assert raw.cfa == "GRBG"


@pytest.mark.parametrize(
    ("array", "text", "words"),
    [
        (np.full((4, 4), np.nan, np.float32), '[raw]\ncfa = "RGGB"', "NaN"),
        (np.zeros((4, 4, 3), np.float32), '[raw]\ncfa = "RGGB"', "(4, 4, 3)"),
        (np.zeros((4, 4), complex), '[raw]\ncfa = "RGGB"', "complex"),
        (np.array([{}]), '[raw]\ncfa = "RGGB"', "damaged"),
        (np.zeros((4, 4)), 'camera = "x"', "cfa"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGBG"', "RGBG"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGGB"\nblak = 3', "blak"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGGB"\nblack = [1, 2]', "black"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGGB"\nblack = 4\nwhite = 4', "white level of 4"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGGB"\nwhite_balance = [1, 0, 1]', "white_balance"),
        (np.zeros((4, 4)), '[raw]\ncfa = "RGGB"\nwhite_balanced = 1', "white_balanced"),
        (np.zeros((4, 4)), '[raw\ncfa = "RGGB"', "line 1"),
        (np.zeros((4, 4)), "raw = 3", "raw = 3, expected a table"),
    ],
)
def test_bad_npy(tmp_path, array, text, words):
    path = described(tmp_path, array, text)
    with pytest.raises(InputError) as caught:
        read_raw(path)
    assert words in str(caught.value) and str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


def test_npy_without_description_or_cut_short(tmp_path):
    path = described(tmp_path, np.zeros((40, 40)))
    path.write_bytes(path.read_bytes()[:-5])
    refused(path, "truncated")
    (tmp_path / "dataset.toml").unlink()
    refused(path, "dataset.toml")


def test_raw_without_a_header_needs_a_description(tmp_path):
    """LibRaw knows such a file by its size alone, and guesses CFA and white level."""
    path = tmp_path / "a.raw"
    pixels = (np.arange(1920 * 1080) % 4096).astype("<u2").reshape(1080, 1920)
    path.write_bytes(pixels.tobytes())
    refused(path, "dataset.toml")
    (tmp_path / "dataset.toml").write_text('[raw]\ncfa = "BGGR"\nblack = 200\nwhite = 4095\n')
    raw = read_raw(path)
    np.testing.assert_allclose(raw.mosaic, (pixels - 200.0) / 3895, atol=1e-6)
    assert raw.cfa == "BGGR" and raw.camera_to_srgb is None
    np.testing.assert_array_equal(raw.white_balance, 1)


# --- bad files ---


def test_no_file_folder_empty_unreadable(tmp_path):
    refused(tmp_path / "none.dng", "no such file")
    refused(tmp_path, "is a folder")
    (tmp_path / "zero.dng").touch()
    refused(tmp_path / "zero.dng", "0 bytes")
    (tmp_path / "text.dng").write_text("hello " * 100)
    refused(tmp_path / "text.dng", "not a DNG")
    (tmp_path / "noise.nef").write_bytes(np.random.default_rng(0).bytes(5000))
    refused(tmp_path / "noise.nef", "LibRaw")


def test_other_formats_named_dng(tmp_path):
    Image.new("RGB", (32, 32)).save(tmp_path / "a.jpg")
    refused((tmp_path / "a.jpg").rename(tmp_path / "a.dng"), "is a JPEG file")
    Image.new("RGB", (32, 32)).save(tmp_path / "b.png")
    refused((tmp_path / "b.png").rename(tmp_path / "b.dng"), "is a PNG file")
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((32, 32, 3), np.uint8), photometric="rgb")
    refused((tmp_path / "c.tif").rename(tmp_path / "c.dng"), "no RAW pixels")


def _patched(path, code: int, value: bytes):
    """The file with the four value bytes of one tag replaced."""
    data = bytearray(path.read_bytes())
    count = struct.unpack_from("<H", data, struct.unpack_from("<L", data, 4)[0])[0]
    start = struct.unpack_from("<L", data, 4)[0] + 2
    for at in range(start, start + 12 * count, 12):
        if struct.unpack_from("<H", data, at)[0] == code:
            data[at + 8 : at + 8 + len(value)] = value
            path.write_bytes(bytes(data))
            return path
    raise AssertionError(f"no tag {code}")


def test_not_a_bayer_mosaic(tmp_path):
    cfa = [(33421, 3, 2, (6, 6)), (33422, 1, 36, bytes([1, 0, 2, 1, 2, 0] * 6))]
    refused(dng(tmp_path / "six.dng", extra_tags=cfa), "not Bayer or X-Trans (6x6 cell)")
    cfa = [(33421, 3, 2, (4, 4)), (33422, 1, 16, bytes([0, 0, 1, 1] * 2 + [1, 1, 2, 0] * 2))]
    refused(dng(tmp_path / "odd.dng", extra_tags=cfa), "not Bayer or X-Trans (4x4 cell)")
    refused(dng(tmp_path / "cyan.dng", extra_tags=[(50710, 1, 3, b"\3\4\5")]), "red, green and blue")
    refused(_patched(dng(tmp_path / "mono.dng"), 262, struct.pack("<H", 34892)), "monochrome")
    tags = [(50706, 1, 4, b"\1\4\0\0", True)]
    linear = {"photometric": 34892, "extratags": tags, "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "linear.dng", np.zeros((40, 30, 3), np.uint16), **linear)
    refused(tmp_path / "linear.dng", "linear (already demosaicked)")
    tags += [(33421, 3, 2, (2, 2), True), (33422, 1, 4, b"\0\1\1\2", True)]
    tifffile.imwrite(
        tmp_path / "float.dng", np.zeros((40, 30), np.float32), photometric=32803, extratags=tags
    )
    refused(tmp_path / "float.dng", "floating-point")
    refused(_patched(dng(tmp_path / "jxl.dng"), 259, struct.pack("<H", 52546)), "JPEG XL")


def test_absurd_numbers(tmp_path):
    for name, code, value in (("w.dng", 256, 4_000_000_000), ("h.dng", 257, 60_000), ("z.dng", 256, 0)):
        refused(_patched(dng(tmp_path / name), code, struct.pack("<L", value)), "damaged")
    refused(dng(tmp_path / "area.dng", active_area=(0, 0, 52, 71)), "ActiveArea")
    refused(dng(tmp_path / "crop.dng", crop=(51, 0, 10, 10)), "DefaultCrop")
    refused(dng(tmp_path / "white.dng", white=64), "white level of 64")
    refused(dng(tmp_path / "black.dng", extra_tags=[(50713, 3, 2, (3, 3))]), "BlackLevel")
    bad = [(51009, 7, 24, b"\0\0\0\1" + b"\0\0\0\x09" + b"\xff" * 16)]
    refused(dng(tmp_path / "opcodes.dng", extra_tags=bad), "damaged")


@given(st.floats(0.0, 1.0))
def test_truncated_dng(share):
    with tempfile.TemporaryDirectory() as folder:
        path = dng(Path(folder) / "a.dng")
        data = path.read_bytes()
        path.write_bytes(data[: int(share * (len(data) - 1))])
        with pytest.raises(InputError) as caught:
            read_raw(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@given(st.integers(0, 900), st.integers(0, 255))
def test_flipped_bytes_never_crash(at, value):
    with tempfile.TemporaryDirectory() as folder:
        path = dng(
            Path(folder) / "a.dng", gain_map=[GainMap(np.ones((2, 2, 1)), (0, 0, 52, 70), spacing=(1, 1))]
        )
        data = bytearray(path.read_bytes())
        data[at] = value
        path.write_bytes(bytes(data))
        try:
            assert np.isfinite(read_raw(path).mosaic).all()
        except InputError as error:
            assert "\n" not in str(error)


# --- orientation ---


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orient_as_pillow_does(tmp_path, orientation, rng):
    pixels = rng.integers(0, 255, (5, 8, 3), np.uint8)
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    with Image.open(tmp_path / "a.png") as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(orient(pixels, orientation), expected)
    np.testing.assert_array_equal(unorient(orient(pixels, orientation), orientation), pixels)
    assert INVERSE[INVERSE[orientation]] == orientation


def test_orient_refuses_others():
    with pytest.raises(ValueError, match="orientation 9"):
        orient(np.zeros((2, 3)), 9)
