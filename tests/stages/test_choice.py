"""Chroma sampling against OpenCV's resizing; what it is by default against libjpeg is in test_jpeg."""

import cv2
import numpy as np
import pytest

from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.pipeline import run, stage
from jaxisp.stages.choice import ChromaSubsampling


def subsampled(picture, **shares):
    node = stage("chroma_subsampling")
    return np.asarray(run(node, {node.name: ChromaSubsampling(**shares)}, picture))


def resized(picture, width, height, down, up):
    """Luma as it is, chroma through OpenCV."""
    y, *chroma = (np.asarray(p) for p in rgb_to_ycbcr_planes(*np.moveaxis(picture, -1, 0)))
    small = [cv2.resize(c, (width, height), interpolation=down) for c in chroma]
    back = [cv2.resize(c, picture.shape[1::-1], interpolation=up) for c in small]
    return np.stack([np.asarray(p) for p in ycbcr_to_rgb_planes(y, *back)], -1)


@pytest.mark.parametrize(
    ("sampled", "repeated", "down", "up"),
    [
        (0, 0, cv2.INTER_AREA, cv2.INTER_LINEAR),
        (1, 0, cv2.INTER_NEAREST, cv2.INTER_LINEAR),
        (0, 1, cv2.INTER_AREA, cv2.INTER_NEAREST),
        (1, 1, cv2.INTER_NEAREST, cv2.INTER_NEAREST),
    ],
)
def test_chroma_is_halved_as_opencv_does(sampled, repeated, down, up):
    picture = np.random.default_rng(0).random((24, 36, 3)).astype(np.float32)
    for vertical, height in ((1, 12), (0, 24)):
        out = subsampled(picture, vertical=vertical, sampled=sampled, repeated=repeated)
        np.testing.assert_allclose(out, resized(picture, 18, height, down, up), atol=2e-6)


def test_forms_mix_and_do_nothing_where_nothing_is_halved():
    picture = np.random.default_rng(1).random((9, 13, 3)).astype(np.float32)  # odd sizes
    plain, repeated, half = (subsampled(picture, repeated=s) for s in (0, 1, 0.5))
    np.testing.assert_allclose(half, (plain + repeated) / 2, atol=0.02)  # rows mix what columns have mixed
    whole = subsampled(picture, horizontal=0, vertical=0, sampled=1, repeated=1)
    np.testing.assert_allclose(whole, picture, atol=1e-6)
