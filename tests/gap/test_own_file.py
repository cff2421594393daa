"""The JPEG that decoded and cut pictures were, told from the pictures."""

import io

import numpy as np
import pytest
from PIL import Image

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.gap.pairs.earlier_grid import own_grid
from jaxisp.gap.pairs.own_file import quantization_of, sampling_of, with_own_file
from jaxisp.io.datasets import Loaded
from jaxisp.io.settings import Settings
from jaxisp.jpeg.tables import quality_tables


@pytest.fixture(scope="module")
def pictures():
    """(4, 200, 208, 3) of 8 bits that were never compressed: made smaller, with a sensor's noise."""
    data = pytest.importorskip("skimage.data")
    rng = np.random.default_rng(0)
    whole = [data.astronaut()[:400, :416], data.coffee()[:400, 100:516], data.chelsea()[:300, :416]]
    small = [w[: len(w) // 2 * 2].reshape(len(w) // 2, 2, 208, 2, 3).mean((1, 3)) for w in whole]
    small = [np.pad(s, ((0, 200 - len(s)), (0, 0), (0, 0)), mode="reflect") for s in small]
    noisy = [s + rng.normal(0, 3, s.shape) for s in small]
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def filed(picture, quality, subsampling=0):
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "jpeg", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file))


def steps_of(pictures):
    return np.stack([np.stack(rgb_to_ycbcr_planes(*np.moveaxis(p.astype(float), -1, 0))) for p in pictures])


def pair(picture):
    return Loaded("a", picture / np.float32(255), None, None, None, Settings(), False, None)


@pytest.mark.parametrize("quality", [70, 85, 92])
@pytest.mark.parametrize("place", [(0, 0), (3, 5), (0, 6)])
def test_the_grid_of_cut_pictures_is_seen(pictures, quality, place):
    cut = [filed(p, quality)[(8 - place[0]) % 8 :, (8 - place[1]) % 8 :] for p in pictures]
    assert own_grid(steps_of(cut)[:, 0]) == place


def test_pictures_that_were_never_compressed_show_none(pictures):
    assert own_grid(steps_of(pictures)[:, 0]) is None
    assert with_own_file([pair(p) for p in pictures])[0].jpeg is None
    noise = np.random.default_rng(1).normal(128, 20, (4, 96, 104))
    assert own_grid(noise) is None


@pytest.mark.parametrize("quality", [70, 85, 92])
def test_its_tables_are_read_off_the_coefficients(pictures, quality):
    found = quantization_of(steps_of([filed(p, quality) for p in pictures])[:, 0])
    luma, chroma = quality_tables(quality)
    assert np.mean(found[0] == luma) > 0.2, "those of which coefficients are left"
    assert (found[0] == luma)[:3, :3].all()
    unlike = [
        t for t in zip(found.ravel(), np.ravel([luma, chroma, chroma])) if abs(t[0] - t[1]) > 0.15 * t[1] + 1
    ]
    assert len(unlike) <= 5, "a few coefficients of which little is left may be taken for another step"


@pytest.mark.parametrize(("index", "name"), [(0, "4:4:4"), (1, "4:2:2"), (2, "4:2:0")])
def test_its_chroma_sampling_shows(pictures, index, name):
    decoded = [filed(p, 90, index) for p in pictures]
    assert sampling_of(steps_of(decoded)[:, 1:].reshape(-1, *decoded[0].shape[:2])) == name
    header = with_own_file([pair(p) for p in decoded])[0].jpeg
    assert header.subsampling == name and header.tables.shape == (3, 8, 8)


def test_a_grid_at_another_place_is_no_file_of_the_picture(pictures):
    assert with_own_file([pair(filed(p, 85)[3:, 5:]) for p in pictures])[0].jpeg is None
