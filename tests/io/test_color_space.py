"""Colours of files in sRGB, against colour-science and littleCMS, whatever states them and at any depth."""

import io
import struct
import tracemalloc
import zlib

import colour
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

from jaxisp.errors import InputError
from jaxisp.io import read_image, read_jpeg
from jaxisp.io.color_space import ADOBE_RGB
from tests.io.profiles import COLORANTS, GAMMA_1, SRGB_CURVE, grey_tables, parametric, power, profile, sampled

PIXELS = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
LIGHT = np.linspace(0, 1, 1024)
CURVES = {
    "linear": (GAMMA_1, lambda x: x),
    "gamma": (power(2.2), lambda x: x ** (round(2.2 * 256) / 256)),
    "table": (sampled(LIGHT**1.8), lambda x: np.interp(x, LIGHT, np.rint(LIGHT**1.8 * 65535) / 65535)),
    "sRGB": (parametric(*SRGB_CURVE), colour.models.eotf_sRGB),
}


def by_colour(values, space: str, decode, encode=colour.models.eotf_inverse_sRGB) -> np.ndarray:
    """Encoded values in sRGB, white adapted by Bradford, cut to its gamut."""
    matrix = colour.matrix_RGB_to_RGB(space, "sRGB", chromatic_adaptation_transform="Bradford")
    light = np.clip(decode(np.asarray(values, float)) @ np.asarray(matrix).T, 0, 1)
    return encode(light)


def near(got: np.ndarray, want: np.ndarray, most: float = 1 / 255) -> None:
    """Profiles round their numbers, which dark colours at the edge of sRGB's gamut show."""
    assert got.dtype == np.float32
    assert np.abs(got - want).max() < most, np.abs(got - want).max() * 255


def refused(path, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_image(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and words in text, text


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("space", COLORANTS)
def test_profiles_are_judged_by_their_numbers_at_any_depth(tmp_path, space, curve):
    """All are named sRGB, which none is but one."""
    stored, decode = CURVES[curve]
    icc = profile("sRGB", COLORANTS[space], stored)
    want = by_colour(PIXELS / 255, space, decode)
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc)
    near(read_image(tmp_path / "a.png"), want)
    deep, real = PIXELS.astype(np.uint16) * 257, (PIXELS / 255).astype(np.float32)
    for array in (PIXELS, deep, real, real.astype(np.float64)):
        tag = [(34675, 7, len(icc), icc, True)]
        tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb", metadata=None, extratags=tag)
        near(read_image(tmp_path / "a.tif"), want)
    if space == curve == "sRGB":
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), PIXELS.astype(np.float32) / 255)


def test_it_is_what_littlecms_gives(tmp_path):
    icc = profile("P3", COLORANTS["Display P3"], parametric(*SRGB_CURVE))
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc)
    given, wanted = ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB")
    transform = ImageCms.buildTransform(given, wanted, "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
    want = np.asarray(ImageCms.applyTransform(Image.fromarray(PIXELS), transform))
    assert np.abs(np.rint(read_image(tmp_path / "a.png") * 255) - want).max() <= 1


def test_linear_light_is_brought_to_srgbs_primaries(tmp_path):
    """Beyond [0, 1] too; the curve of the profile is not applied to what is said to be linear."""
    light = np.random.default_rng(1).uniform(-0.1, 3, (9, 8, 3)).astype(np.float32)
    icc = profile("any", COLORANTS["ITU-R BT.2020"], power(2.2))
    tag = [(34675, 7, len(icc), icc, True)]
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb", metadata=None, extratags=tag)
    matrix = np.asarray(colour.matrix_RGB_to_RGB("ITU-R BT.2020", "sRGB", "Bradford"))
    np.testing.assert_allclose(read_image(tmp_path / "a.tif", linear=True), light @ matrix.T, atol=2e-3)


def adobe(color_space, index: str | None) -> Image.Exif:
    exif = Image.Exif()
    exif[271] = "a camera"  # or Pillow takes it for empty
    inner = {} if color_space is None else {0xA001: color_space}
    exif.get_ifd(0x8769).update(inner | ({0xA005: {1: index, 2: b"0100"}} if index else {}))
    return exif


@pytest.mark.parametrize(
    ("color_space", "index", "is_adobe"),
    [(65535, "R03", True), (None, "R03", True), (2, None, True), (1, "R98", False), (1, "R03", False),
     (65535, "R98", False), (65535, None, False), (1, None, False)],
)  # fmt: skip
def test_adobe_rgb_by_exif(tmp_path, color_space, index, is_adobe):
    exif = adobe(color_space, index)
    values = np.full((16, 16, 3), (120, 160, 90), np.uint8)
    want = values / 255
    if is_adobe:
        want = by_colour(want, "Adobe RGB (1998)", lambda x: x ** (563 / 256))
    for name in ("a.jpg", "a.png"):
        options = {"quality": 100, "subsampling": 0} if name == "a.jpg" else {}
        Image.fromarray(values).save(tmp_path / name, exif=exif, **options)
        near(read_image(tmp_path / name), want, 2 / 255 if options else 1 / 255)
    assert read_jpeg(tmp_path / "a.jpg").converted == is_adobe
    assert not read_jpeg(tmp_path / "a.jpg", to_srgb=False).converted


def test_a_profile_goes_before_exif(tmp_path):
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(PIXELS).save(tmp_path / "a.jpg", exif=adobe(65535, "R03"), icc_profile=icc)
    assert not read_jpeg(tmp_path / "a.jpg").converted


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">L", len(body)) + kind + body + struct.pack(">L", zlib.crc32(kind + body))


def png(path, *chunks: bytes, after: bytes = b""):
    out = io.BytesIO()
    Image.fromarray(PIXELS).save(out, "PNG")
    data = out.getvalue()
    path.write_bytes(data[:33] + b"".join(chunks) + data[33:-12] + after + data[-12:])
    return path


LINEAR_P3 = profile("sRGB", COLORANTS["Display P3"], GAMMA_1)
ICCP = chunk(b"iCCP", b"any\0\0" + zlib.compress(LINEAR_P3))
SRGB, GAMA, SRGB_GAMA = chunk(b"sRGB", b"\0"), chunk(b"gAMA", struct.pack(">L", 100000 // 3)), chunk(
    b"gAMA", struct.pack(">L", 45455)
)  # fmt: skip
PRIMARIES_2020 = 31270, 32900, 70800, 29200, 17000, 79700, 13100, 4600
CHRM = chunk(b"cHRM", struct.pack(">8L", *PRIMARIES_2020))
SRGB_CHRM = chunk(b"cHRM", struct.pack(">8L", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000))
EXIF = chunk(b"eXIf", adobe(65535, "R03").tobytes().removeprefix(b"Exif\0\0"))


def cicp(*numbers: int) -> bytes:
    return chunk(b"cICP", bytes(numbers))


def bt709(x: np.ndarray) -> np.ndarray:
    return colour.models.oetf_inverse_BT709(x)


@pytest.mark.parametrize(
    ("chunks", "space", "decode"),
    [
        ((cicp(9, 8, 0, 1), ICCP, SRGB, GAMA), "ITU-R BT.2020", lambda x: x),
        ((ICCP, SRGB, GAMA, CHRM), "Display P3", lambda x: x),
        ((GAMA, CHRM, SRGB, EXIF), "sRGB", None),
        ((GAMA, CHRM, EXIF), "ITU-R BT.2020", lambda x: x ** (100000 / 33333)),
        ((GAMA,), "sRGB", lambda x: x ** (100000 / 33333)),
        ((SRGB_GAMA, SRGB_CHRM), "sRGB", None),
        ((SRGB_GAMA,), "sRGB", None),
        ((SRGB_GAMA, CHRM), "ITU-R BT.2020", lambda x: x ** (100000 / 45455)),
        ((SRGB_CHRM,), "sRGB", None),
        ((EXIF,), "Adobe RGB (1998)", lambda x: x ** (563 / 256)),
        ((cicp(12, 13, 0, 1),), "Display P3", colour.models.eotf_sRGB),
        ((cicp(1, 1, 0, 1),), "ITU-R BT.709", bt709),
        ((cicp(9, 14, 0, 1),), "ITU-R BT.2020", bt709),
        ((cicp(11, 4, 0, 1),), "DCI-P3", lambda x: x**2.2),
        ((cicp(1, 13, 0, 1),), "sRGB", None),
        ((), "sRGB", None),
    ],
)  # fmt: skip
def test_what_a_png_states_first(tmp_path, chunks, space, decode):
    got = read_image(png(tmp_path / "a.png", *chunks))
    if decode is None:
        np.testing.assert_array_equal(got, PIXELS.astype(np.float32) / 255)
    else:
        near(got, by_colour(PIXELS / 255, space, decode))


@pytest.mark.parametrize(
    ("chunks", "words"),
    [
        ((cicp(9, 16, 0, 1),), "PQ"),
        ((cicp(9, 18, 0, 1),), "HLG"),
        ((cicp(2, 2, 0, 1),), "primaries 2 and transfer 2"),
        ((cicp(9, 8, 9, 1),), "luma"),
        ((cicp(1, 13, 0, 0),), "narrow range"),
        ((chunk(b"cICP", b"\1"),), "cICP of 1 bytes"),
        ((chunk(b"iCCP", b""),), "damaged"),
        ((chunk(b"iCCP", b"a\0\0nonsense"),), "cannot be unpacked"),
        ((chunk(b"iCCP", b"a\0\0" + zlib.compress(LINEAR_P3)[:-9]),), "cannot be unpacked"),
        ((chunk(b"iCCP", b"a\0\0" + zlib.compress(LINEAR_P3[:90])),), "colour profile"),
        ((CHRM,), "tone curve is not stated"),
        ((chunk(b"gAMA", bytes(4)),), "gAMA of 0"),
        ((GAMA, chunk(b"cHRM", struct.pack(">8L", *[30000] * 8))), "on a line"),
        ((GAMA, chunk(b"cHRM", bytes(32))), "no light has"),
    ],
)
def test_what_a_png_states_and_is_not_computed_is_refused(tmp_path, chunks, words):
    refused(png(tmp_path / "a.png", *chunks), words)


def test_an_empty_profile_after_the_pixels(tmp_path):
    refused(png(tmp_path / "a.png", after=chunk(b"iCCP", b"")), "damaged or truncated PNG")


@pytest.mark.parametrize(
    ("icc", "words"),
    [
        (profile("grey", COLORANTS["sRGB"], GAMMA_1, kind=b"GRAY"), "a profile of GRAY pixels"),
        (profile("lab", COLORANTS["sRGB"], GAMMA_1, connection=b"Lab "), "connection space of Lab"),
        (profile("none", COLORANTS["sRGB"], GAMMA_1, leave_out=b"gTRC"), "no gTRC"),
        (profile("flat", (COLORANTS["sRGB"][0],) * 3, GAMMA_1), "span no space"),
        (profile("odd", COLORANTS["sRGB"], parametric(9, [1.0])), "parametric curve of type 9"),
        (profile("cut", COLORANTS["sRGB"], b"curv" + struct.pack(">II", 0, 900)), "cut short"),
        (profile("falls", COLORANTS["sRGB"], sampled([1, 0])), "does not rise"),
        (profile("none", COLORANTS["sRGB"], power(0)), "does not rise"),
        (profile("steep", COLORANTS["sRGB"], parametric(3, (-900, 9, 9, 0, 0))), "does not rise"),
        (b"no profile", "no ICC profile"),
    ],
)
def test_profiles_that_cannot_be_used(tmp_path, icc, words):
    tag = [(34675, 7, len(icc), icc, True)]
    deep = PIXELS.astype(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", deep, photometric="rgb", metadata=None, extratags=tag)
    refused(tmp_path / "a.tif", words)
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc)
    refused(tmp_path / "a.png", words)


def test_a_profile_of_tables(tmp_path):
    """littleCMS applies it to 8 bits; deeper pictures are refused."""
    icc = profile("grey", COLORANTS["sRGB"], GAMMA_1, connection=b"Lab ", tables=grey_tables())
    Image.fromarray(PIXELS).save(tmp_path / "a.png", icc_profile=icc)
    got = read_image(tmp_path / "a.png")
    lightness = colour.lightness(100 * colour.models.eotf_sRGB(got[..., 1]), method="CIE 1976")
    assert np.ptp(got, axis=-1).max() < 3 / 255
    np.testing.assert_allclose(lightness, PIXELS.sum(-1) / 3 / 2.55, atol=1)
    tag = [(34675, 7, len(icc), icc, True)]
    for array in (PIXELS.astype(np.uint16), PIXELS / np.float32(255)):
        tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb", metadata=None, extratags=tag)
        refused(tmp_path / "a.tif", "made of tables")


def test_colour_tags_of_a_tiff(tmp_path):
    def written(tag):
        tifffile.imwrite(tmp_path / "a.tif", PIXELS, photometric="rgb", metadata=None, extratags=[tag])
        return tmp_path / "a.tif"

    refused(written((34675, 3, 1, 7, True)), "tag 34675 holds no bytes")
    for corners, fine in (((64, 33, 30, 60, 15, 6), True), ((64, 33, 21, 71, 15, 6), False)):
        path = written((319, 5, 6, tuple(v for c in corners for v in (c, 100)), True))
        if fine:
            np.testing.assert_array_equal(read_image(path), PIXELS.astype(np.float32) / 255)
        else:
            refused(path, "primaries or a white other than sRGB's")


def test_a_wide_picture_takes_little_memory_too():
    """Some pixels at a time, not some rows: found by guided inputs, 255 rows of 65,318 pixels."""
    pixels = np.random.default_rng(0).integers(0, 256, (40, 65_500, 3), np.uint8)
    tracemalloc.start()
    whole = ADOBE_RGB.srgb(pixels)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 3.5 * whole.nbytes  # 6.3 in one part
    np.testing.assert_array_equal(whole[:, 100:200], ADOBE_RGB.srgb(pixels[:, 100:200]))
