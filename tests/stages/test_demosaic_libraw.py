"""Algorithms against LibRaw's, on a DNG written here."""

import numpy as np
import pytest
import rawpy
import skimage.data

import jaxisp.stages  # noqa: F401
from jaxisp.color import SRGB_TO_XYZ
from jaxisp.io.dng import write_dng
from tests.stages.test_demosaic import inside, mosaic_of, run

FULL = 65535


def developed(cfa, algorithm, path):
    """A mosaic of 16 bits, and LibRaw's picture of it, linear, in camera colours."""
    picture = (skimage.data.astronaut()[20:212, 150:350] / 255.0) ** 2.2
    pixels = np.round(0.9 * FULL * mosaic_of(picture, cfa)).astype(np.uint16)
    # the camera's colours are linear sRGB, which is what ours takes them for
    write_dng(path, pixels, cfa=cfa, black=[0], white=FULL, color_matrix=np.linalg.inv(SRGB_TO_XYZ))
    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(
            demosaic_algorithm=algorithm,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            user_wb=[1, 1, 1, 1],
        )
    return pixels, theirs / FULL


def psnr(name, pixels, theirs, border=8, **static):
    got = np.clip(run(name, np.float32(pixels / FULL), **static), 0, 1)
    return -10 * np.log10(np.mean((inside(got, border) - inside(theirs, border)) ** 2))


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_libraws_variant_is_libraws_ahd(cfa, tmp_path):
    """45 dB and more; what is left are near-ties that LibRaw's 16-bit Lab decides the other way."""
    pair = developed(cfa, rawpy.DemosaicAlgorithm.AHD, tmp_path / "a.dng")
    assert psnr("demosaic_ahd", *pair, cfa=cfa, variant="libraw", delta=1) > 45
    assert psnr("demosaic_ahd", *pair, cfa=cfa) < 45, (
        "the paper's rule is another algorithm: the option does something"
    )


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
@pytest.mark.parametrize("name", ["PPG", "DCB"])
def test_is_libraws(name, cfa, tmp_path):
    """80 dB and 55: what is left are near-ties that 16-bit rounding decides the other way."""
    pair = developed(cfa, getattr(rawpy.DemosaicAlgorithm, name), tmp_path / "a.dng")
    assert psnr(f"demosaic_{name.lower()}", *pair, border=16, cfa=cfa) > 52
    assert psnr("demosaic_hamilton_adams", *pair, border=16, cfa=cfa) < 45
