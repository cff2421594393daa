"""AHD against LibRaw's, on a DNG written here."""

import numpy as np
import pytest
import rawpy
import skimage.data

import jaxisp.stages  # noqa: F401
from jaxisp.color import SRGB_TO_XYZ
from jaxisp.io.dng import write_dng
from tests.stages.test_demosaic import inside, mosaic_of, run

FULL = 65535


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_libraws_variant_is_libraws_ahd(cfa, tmp_path):
    """45 dB and more; what is left are near-ties that LibRaw's 16-bit Lab decides the other way."""
    picture = (skimage.data.astronaut()[20:212, 150:350] / 255.0) ** 2.2
    pixels = np.round(0.9 * FULL * mosaic_of(picture, cfa)).astype(np.uint16)
    # the camera's colours are linear sRGB, which is what ours takes them for
    path = write_dng(
        tmp_path / "a.dng", pixels, cfa=cfa, black=[0], white=FULL, color_matrix=np.linalg.inv(SRGB_TO_XYZ)
    )
    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            user_wb=[1, 1, 1, 1],
        )

    def psnr(**static):
        got = run("demosaic_ahd", np.float32(pixels / FULL), cfa=cfa, **static)
        return -10 * np.log10(np.mean((inside(got, 8) - inside(theirs / FULL, 8)) ** 2))

    assert psnr(variant="libraw", delta=1) > 45
    assert psnr() < 45, "the paper's rule is another algorithm: the option does something"
