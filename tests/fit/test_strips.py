"""Large pictures go in strips: the same as whole."""

import numpy as np
import pytest
from PIL import Image

from jaxisp.fit import noise, strips
from jaxisp.fit.align import Alignment
from jaxisp.fit.evaluate import masked_psnr
from jaxisp.fit.lens import Lens
from jaxisp.fit.render import compressed, similarity
from jaxisp.fit.tiles import split
from jaxisp.io import read_jpeg
from jaxisp.metrics import psnr
from jaxisp.testing import smooth_image


@pytest.fixture
def pictures():
    rng = np.random.default_rng(0)
    one = smooth_image((203, 150, 3), 1).astype(np.float32)
    return one, np.clip(one + np.float32(0.02) * rng.standard_normal(one.shape, np.float32), 0, 1)


def in_small_strips(monkeypatch, call):
    whole = call()
    monkeypatch.setattr(strips, "STRIP", 32)
    assert len(strips.strips(203)) == 7
    return whole, call()


def test_statistics_of_noise(pictures, monkeypatch):
    noisy, mask = pictures[1], np.ones((203, 150), bool)
    mask[:40, 20:] = False

    def call():
        found = noise.regions(noisy, mask)
        inside = (slice(192), slice(144))
        return *found, noise.moments(noisy[inside], found.flat, found.edges[inside])

    for whole, parts in zip(*in_small_strips(monkeypatch, call)):
        np.testing.assert_array_equal(whole, parts)


def test_similarity(pictures, monkeypatch):
    """By a program for each height, so to rounding."""
    whole, parts = in_small_strips(monkeypatch, lambda: similarity(*pictures))
    np.testing.assert_allclose(whole, parts, atol=2e-5)


def test_psnr_of_a_mask(pictures, monkeypatch):
    mask = np.random.default_rng(1).uniform(size=(203, 150)) < 0.3
    whole, parts = in_small_strips(monkeypatch, lambda: masked_psnr(*pictures, mask))
    np.testing.assert_allclose([whole, parts], psnr(*pictures, mask=mask), atol=1e-4)
    assert masked_psnr(pictures[0], pictures[0], mask) == 120 and np.isnan(
        masked_psnr(*pictures, mask & False)
    )


def test_which_pixels_are_fitted(pictures, monkeypatch):
    alignment, lens = Alignment(1.5, -2.0, 0.99, 1.01, 1.0), Lens(0.05)
    for whole, parts in zip(
        *in_small_strips(monkeypatch, lambda: split(pictures[1], alignment, (190, 160), lens))
    ):
        np.testing.assert_array_equal(whole, parts)
        assert 0 < whole.sum() < whole.size


def test_the_encoder(pictures, tmp_path, monkeypatch):
    Image.fromarray(np.uint8(255 * pictures[0])).save(tmp_path / "a.jpg", quality=80)
    jpeg = read_jpeg(tmp_path / "a.jpg")
    whole, parts = in_small_strips(monkeypatch, lambda: compressed(pictures[1], jpeg))
    np.testing.assert_array_equal(whole, parts)
