"""Colour-space conversions against colour-science, and there and back."""

import colour
import numpy as np
import pytest

from jaxisp.pipeline import REGISTRY, Chain, run, stage
from jaxisp.testing import smooth_image

SRGB = colour.RGB_COLOURSPACES["sRGB"]
ROMM = colour.RGB_COLOURSPACES["ProPhoto RGB"]


def image_in(low: float = -0.2, high: float = 1.4) -> np.ndarray:
    return low + (high - low) * smooth_image((9, 13, 3))


def prophoto_to_srgb(rgb: np.ndarray) -> np.ndarray:
    """From colour-science's parts: primaries, white points, Bradford."""
    to_xyz = colour.normalised_primary_matrix(ROMM.primaries, ROMM.whitepoint)
    white = colour.xy_to_XYZ(ROMM.whitepoint), SRGB.matrix_RGB_to_XYZ.sum(axis=1)
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(*white, transform="Bradford")
    return rgb @ (np.linalg.inv(SRGB.matrix_RGB_to_XYZ) @ adapt @ to_xyz).T


def srgb_to_prophoto(rgb: np.ndarray) -> np.ndarray:
    return rgb @ np.linalg.inv(prophoto_to_srgb(np.eye(3)))


REFERENCES = {
    "linear_srgb_to_xyz": lambda x: x @ SRGB.matrix_RGB_to_XYZ.T,
    "xyz_to_linear_srgb": lambda x: np.linalg.solve(SRGB.matrix_RGB_to_XYZ, x[..., None])[..., 0],
    "prophoto_to_linear_srgb": prophoto_to_srgb,
    "linear_srgb_to_prophoto": srgb_to_prophoto,
    "rgb_to_ycbcr": lambda x: colour.RGB_to_YCbCr(x, K=colour.WEIGHTS_YCBCR["ITU-R BT.601"], out_legal=False),
    "ycbcr_to_rgb": lambda x: colour.YCbCr_to_RGB(
        x, K=colour.WEIGHTS_YCBCR["ITU-R BT.601"], in_legal=False, out_legal=False
    ),
}
PAIRS = [
    ("linear_srgb_to_xyz", "xyz_to_linear_srgb"),
    ("linear_srgb_to_prophoto", "prophoto_to_linear_srgb"),
    ("rgb_to_ycbcr", "ycbcr_to_rgb"),
]


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_matches_colour_science(name, x64):
    image = image_in()
    np.testing.assert_allclose(run(stage(name), {}, image), REFERENCES[name](image), atol=1e-9)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_single_precision_matches_colour_science(name):
    image = image_in().astype(np.float32)
    want = REFERENCES[name](image.astype(np.float64))
    np.testing.assert_allclose(run(stage(name), {}, image), want, atol=1e-6)


def test_every_space_has_a_reference():
    names = {n for n, fn in REGISTRY.items() if fn.__module__ == "jaxisp.stages.spaces"}
    assert names == set(REFERENCES)


def test_prophoto_is_near_the_rounded_matrices_in_use():
    """colour-science's own chain of four-digit matrices differs by their rounding."""
    image = smooth_image((9, 13, 3)).astype(np.float32)
    want = colour.RGB_to_RGB(image, ROMM, SRGB, chromatic_adaptation_transform="Bradford")
    np.testing.assert_allclose(run(stage("prophoto_to_linear_srgb"), {}, image), want, atol=1e-3)


@pytest.mark.parametrize(("there", "back"), PAIRS)
def test_there_and_back(there, back):
    image = image_in().astype(np.float32)
    for names in ((there, back), (back, there)):
        chain = Chain(tuple(stage(n) for n in names))
        np.testing.assert_allclose(run(chain, {}, image), image, atol=1e-6)


def test_white_stays_white():
    white = np.ones((1, 2, 3), np.float32)
    for name in ("prophoto_to_linear_srgb", "linear_srgb_to_prophoto"):
        np.testing.assert_allclose(run(stage(name), {}, white), white, atol=1e-6)
    xyz = run(stage("linear_srgb_to_xyz"), {}, white)[0, 0]
    np.testing.assert_allclose(xyz, [0.9505, 1.0, 1.089], atol=1e-6)
    np.testing.assert_allclose(run(stage("rgb_to_ycbcr"), {}, white)[0, 0], [1, 0, 0], atol=1e-6)


def test_primaries_have_the_extreme_chroma():
    """JFIF's scale: blue has Cb 1/2 and red has Cr 1/2."""
    rgb = np.float32([[[1, 0, 0], [0, 0, 1]]])
    red, blue = np.asarray(run(stage("rgb_to_ycbcr"), {}, rgb))[0]
    assert abs(red[2] - 0.5) < 1e-6 and abs(blue[1] - 0.5) < 1e-6


def test_chains_refuse_a_wrong_space():
    with pytest.raises(ValueError, match="XYZ"):
        Chain((stage("linear_srgb_to_xyz"), stage("rgb_to_ycbcr")))
