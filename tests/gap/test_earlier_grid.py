"""The grid of an earlier compression, in pictures that Pillow compressed."""

import io

import numpy as np
import pytest
from PIL import Image

from jaxisp.gap.pairs.earlier_grid import earlier_grid


def compressed(picture, quality, row=0, column=0):
    """The picture after JPEG on a grid whose blocks begin at (row, column)."""
    padded = np.pad(picture, ((-row % 8, 0), (-column % 8, 0)), mode="edge")
    file = io.BytesIO()
    Image.fromarray(padded).save(file, "jpeg", quality=quality)
    return np.asarray(Image.open(file))[-row % 8 :, -column % 8 :]


@pytest.fixture(scope="module")
def pictures():
    data = pytest.importorskip("skimage.data")
    whole = [getattr(data, name)()[:288, :370].astype(float) for name in ("camera", "moon", "coins")]
    # made smaller: some of these were compressed before they came here
    return [p.reshape(144, 2, 185, 2).mean((1, 3)).astype(np.uint8) for p in whole]


@pytest.mark.parametrize("place", [(3, 1), (7, 4), (0, 5), (1, 0)])
@pytest.mark.parametrize(("first", "last"), [(85, 92), (60, 90)])
def test_the_grid_of_an_earlier_compression_is_found(pictures, place, first, last):
    twice = np.stack([compressed(compressed(p, first, *place), last) for p in pictures])
    assert earlier_grid(twice.astype(float)) == place


@pytest.mark.parametrize("quality", [50, 75, 92])
def test_one_compression_has_no_other_grid(pictures, quality):
    once = np.stack([compressed(p, quality) for p in pictures])
    assert earlier_grid(once.astype(float)) == (0, 0)
    assert earlier_grid(np.stack([compressed(p, 70) for p in once]).astype(float)) == (0, 0)


def test_pictures_that_were_never_compressed_have_none(pictures):
    assert earlier_grid(np.stack(pictures).astype(float)) == (0, 0)
    assert earlier_grid(np.zeros((2, 40, 48))) == (0, 0)
