"""Colours that TIFF and EXIF tags state by numbers, against colour-science."""

import io

import colour
import numpy as np
import pytest
import tifffile
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from jaxisp.io import read_image, read_jpeg
from jaxisp.io.jpeg import decode_jpeg
from tests.io.test_color_space import PIXELS, by_colour, near, refused

SPACES = {name: colour.RGB_COLOURSPACES[name] for name in ("Adobe RGB (1998)", "Display P3", "ProPhoto RGB")}
SRGB = colour.RGB_COLOURSPACES["sRGB"]
GAMMA, WHITE, PRIMARIES, TRANSFER, RANGE, LEVELS, COLOR_SPACE = 0xA500, 318, 319, 301, 342, 532, 0xA001
FLAT = np.full((16, 16, 3), (120, 160, 90), np.uint8)
CURVE = np.linspace(0, 1, 256) ** 1.8
TABLE = tuple(np.rint(CURVE * 65535).astype(int).tolist())


def rational(values) -> tuple[IFDRational, ...]:
    return tuple(IFDRational(round(float(v) * 10000), 10000) for v in np.ravel(values))


def exif_with(main, inner) -> Image.Exif:
    exif = Image.Exif()
    exif.update({271: "a camera", **main})
    exif.get_ifd(0x8769).update(inner)
    return exif


def jpeg(path, main, inner):
    Image.fromarray(FLAT).save(path, quality=100, subsampling=0, exif=exif_with(main, inner))
    return path


@pytest.mark.parametrize("name", SPACES)
def test_primaries_and_gamma_of_exif(tmp_path, name):
    """Without DCF's R03, which would name the space."""
    space = SPACES[name]
    main = {PRIMARIES: rational(space.primaries), WHITE: rational(space.whitepoint)}
    inner = {GAMMA: IFDRational(22, 10), COLOR_SPACE: 65535}
    path = jpeg(tmp_path / "a.jpg", main, inner)
    near(read_image(path), by_colour(FLAT / 255, name, lambda x: x**2.2), 2 / 255)
    assert read_jpeg(path).converted
    inner[COLOR_SPACE] = 1  # sRGB by its name, which goes before numbers
    assert not read_jpeg(jpeg(tmp_path / "b.jpg", main, inner)).converted
    del inner[GAMMA], inner[COLOR_SPACE]
    refused(jpeg(tmp_path / "c.jpg", main, inner), "no tone curve")
    Image.fromarray(FLAT).save(tmp_path / "a.png", exif=exif_with(main, {GAMMA: IFDRational(22, 10)}))
    near(read_image(tmp_path / "a.png"), by_colour(FLAT / 255, name, lambda x: x**2.2))


def test_a_curve_alone_has_srgbs_primaries(tmp_path):
    for main, inner, curve in (
        ({}, {GAMMA: IFDRational(1, 1)}, lambda x: x),
        ({}, {GAMMA: IFDRational(22, 10)}, lambda x: x**2.2),
        ({TRANSFER: TABLE}, {}, lambda x: x**1.8),
        ({TRANSFER: 3 * TABLE}, {}, lambda x: x**1.8),
        ({PRIMARIES: rational(SRGB.primaries), WHITE: rational(SRGB.whitepoint), TRANSFER: TABLE}, {},
         lambda x: x**1.8),
    ):  # fmt: skip
        path = jpeg(tmp_path / "a.jpg", main, inner)
        near(read_image(path), by_colour(FLAT / 255, "sRGB", curve), 2 / 255)


@pytest.mark.parametrize(
    ("main", "inner"),
    [
        ({PRIMARIES: rational(SRGB.primaries)}, {}),
        ({WHITE: rational(SRGB.whitepoint)}, {}),
        ({WHITE: rational((0.313, 0.329)), PRIMARIES: rational(SRGB.primaries)}, {COLOR_SPACE: 65535}),
        ({}, {COLOR_SPACE: 65535}),
        ({LEVELS: rational((0, 255) * 3)}, {}),
        ({LEVELS: rational((0, 255, 128, 255, 128, 255))}, {}),
        ({LEVELS: rational((16, 235) * 3), PRIMARIES: rational((0.7, 0.3) * 3)}, {COLOR_SPACE: 1}),
    ],
)
def test_srgb_by_its_numbers(tmp_path, main, inner):
    assert not read_jpeg(jpeg(tmp_path / "a.jpg", main, inner)).converted


ADOBE = rational(SPACES["Adobe RGB (1998)"].primaries)


@pytest.mark.parametrize(
    ("main", "inner", "words"),
    [
        ({PRIMARIES: ADOBE}, {}, "no tone curve"),
        ({WHITE: rational((0.3457, 0.3585))}, {}, "no tone curve"),
        ({WHITE: rational((0.3457, 0.3585))}, {GAMMA: IFDRational(22, 10)}, "no primaries"),
        ({PRIMARIES: ADOBE[:5]}, {GAMMA: IFDRational(22, 10)}, "damaged PrimaryChromaticities"),
        (
            {PRIMARIES: (IFDRational(0, 0),) * 6},
            {GAMMA: IFDRational(22, 10)},
            "damaged PrimaryChromaticities",
        ),
        ({PRIMARIES: ADOBE[:2] * 3}, {GAMMA: IFDRational(22, 10)}, "lie on a line"),
        ({PRIMARIES: ADOBE, WHITE: rational((0, 0))}, {GAMMA: IFDRational(22, 10)}, "no light has"),
        ({PRIMARIES: ADOBE}, {GAMMA: IFDRational(0, 10)}, "Gamma of 0"),
        ({PRIMARIES: ADOBE}, {GAMMA: IFDRational(1, 0)}, "damaged Gamma"),
        ({TRANSFER: TABLE[:100]}, {}, "TransferFunction (tag 301) of 100 values"),
        ({TRANSFER: TABLE[::-1]}, {}, "does not rise"),
        ({TRANSFER: TABLE, RANGE: (0, 235) * 3}, {}, "TransferRange"),
        ({LEVELS: rational((16, 235) * 3)}, {}, "ReferenceBlackWhite"),
    ],
)
def test_what_is_stated_and_not_computed_is_refused(tmp_path, main, inner, words):
    refused(jpeg(tmp_path / "a.jpg", main, inner), words)


def tiff(path, array, *tags):
    full = [(*tag, True) for tag in tags]
    tifffile.imwrite(path, array, photometric="rgb", metadata=None, extratags=full)
    return path


def chromaticities(code: int, values):
    numbers = [n for v in np.ravel(values) for n in (round(float(v) * 10000), 10000)]
    return code, 5, len(numbers) // 2, tuple(numbers)


@pytest.mark.parametrize("tables", [1, 3])
@pytest.mark.parametrize("name", SPACES)
def test_a_tiff_by_its_transfer_function(tmp_path, name, tables):
    """TIFF 6.0, section 20: linear light of each code, at 8 and at 16 bits; one table or three."""
    space = SPACES[name]
    own = [chromaticities(PRIMARIES, space.primaries), chromaticities(WHITE, space.whitepoint)]
    want = by_colour(PIXELS / 255, name, lambda x: x**1.8)
    table = (TRANSFER, 3, 256 * tables, TABLE * tables)
    near(read_image(tiff(tmp_path / "a.tif", PIXELS, *own, table)), want)
    long = np.rint(np.linspace(0, 1, 65536) ** 1.8 * 65535).astype(np.uint16)
    table = (TRANSFER, 3, 65536 * tables, tuple(np.tile(long, tables).tolist()))
    near(read_image(tiff(tmp_path / "b.tif", PIXELS.astype(np.uint16) * 257, *own, table)), want)
    refused(tiff(tmp_path / "c.tif", PIXELS / np.float32(255), *own, table), "pixels that are floats")
    refused(tiff(tmp_path / "d.tif", PIXELS, *own, table), "expected 256 or 768")
    refused(tiff(tmp_path / "e.tif", PIXELS, *own), "no tone curve")
    light = PIXELS / np.float32(255)
    matrix = np.asarray(colour.matrix_RGB_to_RGB(name, "sRGB", "Bradford"))
    got = read_image(tiff(tmp_path / "f.tif", light, *own), linear=True)
    np.testing.assert_allclose(got, light @ matrix.T, atol=2e-3)


def test_curves_of_a_tiff_that_differ_by_channel(tmp_path):
    curves = [np.linspace(0, 1, 256) ** g for g in (1.0, 1.8, 2.6)]
    values = tuple(np.rint(np.concatenate(curves) * 65535).astype(int).tolist())
    got = read_image(tiff(tmp_path / "a.tif", PIXELS, (TRANSFER, 3, 768, values)))
    light = np.stack([curve[PIXELS[..., i]] for i, curve in enumerate(curves)], -1)
    near(got, colour.models.eotf_inverse_sRGB(light))


def test_a_white_and_a_table_alone(tmp_path):
    d50 = chromaticities(WHITE, (0.3457, 0.3585))
    refused(tiff(tmp_path / "a.tif", PIXELS, d50), "no tone curve")
    refused(tiff(tmp_path / "b.tif", PIXELS, d50, (TRANSFER, 3, 256, TABLE)), "no primaries")
    d65 = chromaticities(WHITE, (0.3127, 0.3290))
    np.testing.assert_array_equal(read_image(tiff(tmp_path / "c.tif", PIXELS, d65)), PIXELS / np.float32(255))


def test_a_damaged_part_of_exif_leaves_the_rest():
    """A directory of EXIF that cannot be read takes neither orientation nor primaries with it."""
    out = io.BytesIO()
    exif = exif_with({274: 6, PRIMARIES: ADOBE}, {GAMMA: IFDRational(22, 10)})
    Image.fromarray(FLAT).save(out, "JPEG", exif=exif)
    data = out.getvalue()
    at = (
        data.index(b"\x69\x87\x04\x00\x01\x00\x00\x00")
        if b"II*" in data[:40]
        else data.index(b"\x87\x69\x00\x04")
    )
    broken = data[: at + 8] + b"\xff\xff\xff\x7f" + data[at + 12 :]
    assert decode_jpeg(broken, "a.jpg", to_srgb=False).orientation == 6
