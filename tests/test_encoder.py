"""The encoder that a file's header states, against the pixels that libjpeg decodes from that file."""

import io
import itertools

import colour
import numpy as np
import pytest
from colour.models import normalised_primary_matrix
from PIL import Image, ImageCms
from PIL.TiffImagePlugin import IFDRational

from jaxisp.encoder import encoder_of, no_encoder
from jaxisp.gap.objective.pixels import as_stored
from jaxisp.io.jpeg import decode_jpeg
from jaxisp.pipeline import run
from jaxisp.testing import smooth_image
from tests.io.profiles import (
    COLORANTS,
    GAMMA_1,
    SRGB_CURVE,
    grey_tables,
    parametric,
    power,
    profile,
    sampled,
)

PICTURE = np.rint(smooth_image((40, 56, 3)) * 255).astype(np.uint8)


def coded(picture: np.ndarray = PICTURE, **options):
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", **options)
    return decode_jpeg(out.getvalue(), "a.jpg")


def flat(*steps: int) -> list[list[int]]:
    return [[step] * 64 for step in steps]


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"quality": 80}, "jpeg_tables"),
        ({"qtables": flat(8, 16), "subsampling": "4:2:2"}, "jpeg_tables"),
        ({"qtables": flat(8, 16, 60), "subsampling": "4:2:0"}, "jpeg_file"),
        ({"qtables": flat(8, 400), "subsampling": "4:4:4"}, "jpeg_file"),
        ({"qtables": flat(8, 65535, 300), "subsampling": "4:2:2"}, "jpeg_file"),
        ({"keep_rgb": True, "qtables": flat(5, 20, 60)}, "jpeg_file"),
    ],
)
@pytest.mark.optimised
def test_it_does_to_the_picture_what_the_file_did(options, kind):
    file = coded(**options)
    encoder, params = encoder_of(file)
    assert (encoder.fn.__name__, encoder.name, list(params)) == (kind, "jpeg_tables", ["jpeg_tables"])
    assert no_encoder(file) is None
    assert np.abs(file.pixels.astype(int) - PICTURE).mean() > 1.5, "the file changed the picture"
    stored = as_stored((PICTURE / 255).astype(np.float32), file)
    np.testing.assert_array_equal(np.rint(stored * 255), file.pixels)


CURVES = {"gamma": power(2.2), "sRGB": parametric(*SRGB_CURVE)}
SPACES = ("Display P3", "Adobe RGB (1998)", "ITU-R BT.2020")
CODED = list(itertools.product(CURVES, SPACES, ("4:4:4", "4:2:0")))
# each curve, each space and each sampling with each of the others
PAIRED = {("gamma", name, "4:4:4") for name in SPACES} | {("sRGB", name, "4:2:0") for name in SPACES}
PAIRED |= {("gamma", SPACES[0], "4:2:0"), ("sRGB", SPACES[1], "4:4:4")}


@pytest.mark.parametrize(
    ("curve", "name", "subsampling"),
    [pytest.param(*case, marks=[pytest.mark.slow] * (case not in PAIRED)) for case in CODED],
)
def test_it_works_in_the_files_own_colour_space(name, subsampling, curve):
    """The file is converted by littleCMS, coded by libjpeg, and read back."""
    icc = profile(name, COLORANTS[name], CURVES[curve])
    spaces = ImageCms.createProfile("sRGB"), ImageCms.ImageCmsProfile(io.BytesIO(icc))
    there = ImageCms.buildTransform(*spaces, "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
    own = np.asarray(ImageCms.applyTransform(Image.fromarray(PICTURE), there))
    file = coded(own, quality=88, subsampling=subsampling, icc_profile=icc)
    assert encoder_of(file)[0].fn.__name__ == "jpeg_file" and no_encoder(file) is None
    stored = as_stored((PICTURE / 255).astype(np.float32), file)
    off = np.abs(stored * 255 - file.pixels)
    assert off.mean() < 0.1, off.mean()


@pytest.mark.parametrize("name", ["Display P3", "ProPhoto RGB"])
def test_it_works_in_a_space_that_exif_states_by_numbers(name):
    """The file is converted by the definition of its space."""
    own, srgb = colour.RGB_COLOURSPACES[name], colour.RGB_COLOURSPACES["sRGB"]
    to_xyz = [normalised_primary_matrix(s.primaries, np.round(s.whitepoint, 4)) for s in (srgb, own)]
    whites = [m.sum(1) for m in to_xyz]
    adapted = colour.adaptation.matrix_chromatic_adaptation_VonKries(*whites, "Bradford") @ to_xyz[0]
    light = colour.models.eotf_sRGB(PICTURE / 255) @ np.linalg.solve(to_xyz[1], adapted).T
    exif = Image.Exif()
    for code, values in ((319, own.primaries), (318, own.whitepoint)):
        exif[code] = tuple(IFDRational(round(float(v) * 10000), 10000) for v in np.ravel(values))
    exif.get_ifd(0x8769)[0xA500] = IFDRational(22, 10)
    wide = np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    file = coded(wide, quality=88, subsampling="4:4:4", exif=exif)
    assert file.converted and no_encoder(file) is None
    stored = as_stored((PICTURE / 255).astype(np.float32), file)
    assert np.abs(stored * 255 - file.pixels).mean() < 0.05


@pytest.mark.parametrize("stated", ["profile", "EXIF"])
def test_the_less_likely_way_to_convert_is_found_where_the_original_is_known(stated, rng):
    """A profile that was applied in floats, and Adobe RGB of EXIF that littleCMS made, at high quality."""
    noisy = np.clip(PICTURE + rng.normal(0, 10, PICTURE.shape), 0, 255).astype(np.uint8)
    icc = profile("Adobe RGB (1998)", COLORANTS["Adobe RGB (1998)"], power(563 / 256))
    if stated == "profile":
        space = colour.RGB_COLOURSPACES["Adobe RGB (1998)"], colour.RGB_COLOURSPACES["sRGB"]
        to_xyz = [normalised_primary_matrix(s.primaries, s.whitepoint) for s in space]
        light = colour.models.eotf_sRGB(noisy / 255) @ np.linalg.solve(*to_xyz).T
        own = np.rint(255 * np.clip(light, 0, 1) ** (256 / 563)).astype(np.uint8)
        options = {"icc_profile": icc}
    else:
        spaces = ImageCms.createProfile("sRGB"), ImageCms.ImageCmsProfile(io.BytesIO(icc))
        there = ImageCms.buildTransform(*spaces, "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC)
        own = np.asarray(ImageCms.applyTransform(Image.fromarray(noisy), there))
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA001] = 65535
        exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
        options = {"exif": exif}
    file = coded(own, quality=95, subsampling="4:4:4", **options)
    assert file.converted
    original = (noisy / 255).astype(np.float32)
    blind = np.asarray(run(*encoder_of(file), original))
    off = [np.abs(stored * 255 - file.pixels).mean() for stored in (blind, as_stored(original, file))]
    assert off[1] < 0.5 < off[0], off


@pytest.mark.parametrize("step", [8192, 9000, 16384])
def test_steps_that_encoders_wrap_are_said(step):
    file = coded(qtables=flat(5, step), subsampling="4:4:4")
    assert encoder_of(file) is None and f"another step than {step}" in no_encoder(file)


@pytest.mark.parametrize("names", [b"\x01\x02\x03", b"RGB"])
def test_a_jfif_marker_means_luma_and_chroma(names):
    """Before Adobe's marker and the names of the components, as in libjpeg."""
    out = io.BytesIO()
    Image.fromarray(PICTURE).save(out, "JPEG", quality=80, subsampling="4:4:4")
    data, adobe = out.getvalue(), b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00\x00"
    if names == b"RGB":
        frame, scan = data.index(b"\xff\xc0"), data.index(b"\xff\xda")
        named = bytearray(data)
        for i, name in enumerate(names):
            named[frame + 10 + 3 * i] = named[scan + 5 + 2 * i] = name
        data = bytes(named)
    else:
        after = 4 + int.from_bytes(data[4:6], "big")
        data = data[:after] + adobe + data[after:]
    file = decode_jpeg(data, "a.jpg")
    assert file.color_space == "YCbCr"
    stored = as_stored((PICTURE / 255).astype(np.float32), file)
    assert np.abs(stored * 255 - file.pixels).mean() < 0.6


def test_what_is_not_modelled_is_said():
    icc = profile("grey", COLORANTS["sRGB"], GAMMA_1, connection=b"Lab ", tables=grey_tables())
    file = coded(icc_profile=icc)
    assert file.converted and encoder_of(file) is None and "made of tables" in no_encoder(file)
    np.testing.assert_array_equal(as_stored(np.full((8, 8, 3), 0.5, np.float32), file) * 255, 128)
    dented = profile("dented", COLORANTS["Display P3"], sampled([0, 0.5, 0.4, 1]))
    assert "do not rise" in no_encoder(coded(icc_profile=dented))
    out = io.BytesIO()
    Image.fromarray(PICTURE).save(out, "JPEG", subsampling="4:2:0")
    data = bytearray(out.getvalue())
    at = data.index(b"\xff\xc0") + 11
    data[at] = 0x12  # luma twice as high as chroma alone
    file = decode_jpeg(bytes(data), "a.jpg")
    assert encoder_of(file) is None and "4:4:0" in no_encoder(file)
    assert encoder_of(None) is None
