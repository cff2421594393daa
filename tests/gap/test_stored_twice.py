"""What two JPEG files leave between them where the change from the one to the other is known."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from jaxisp.gap.pairs.pairs import INNER, to_steps
from jaxisp.gap.pairs.stored_twice import stored_twice
from jaxisp.io.jpeg import decode_jpeg


def saved(picture, quality=88, sampling=0):
    """A picture (H, W, 3) in steps as Pillow stores it."""
    data = io.BytesIO()
    Image.fromarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8)).save(
        data, "jpeg", quality=quality, subsampling=sampling
    )
    return decode_jpeg(data.getvalue(), "a")


@pytest.mark.parametrize("sampling", [0, 2])
@pytest.mark.parametrize("strength", [0.5, 2.0, 6.0, 20.0])
def test_it_has_the_energy_that_a_known_change_leaves(strength, sampling):
    """Both files sample chroma alike, which is no part of what they leave."""
    rng = np.random.default_rng(0)
    texture = 40 * gaussian_filter(
        rng.standard_normal((128, 128, 3)), (1.2, 1.2, 0)
    ) + 6 * rng.standard_normal((128, 128, 1))
    first = 128 + texture + 30 * np.sin(np.arange(128) / 9)[:, None, None]
    change = strength * gaussian_filter(rng.standard_normal((128, 128, 1)), (0.6, 0.6, 0))
    files = saved(first, sampling=sampling), saved(first + change, sampling=sampling)
    shown = [np.asarray(f.image, np.float32)[None] for f in files]
    left = to_steps(shown[1][INNER]) - to_steps(shown[0][INNER]) - change[None][INNER] * [1.0, 0, 0]
    found = stored_twice(*shown, ([files[0]], [files[1]]))
    assert (found**2).sum(-1).mean() == pytest.approx((left**2).sum(-1).mean(), rel=0.3)


def test_the_same_file_twice_leaves_nothing():
    picture = np.random.default_rng(0).uniform(40, 200, (64, 64, 3))
    file = saved(picture)
    shown = np.asarray(file.image, np.float32)[None]
    assert np.abs(stored_twice(shown, shown, ([file], [file]))).max() < 1e-3


def test_without_files_two_roundings_add_up():
    rough = np.random.default_rng(0).uniform(0.2, 0.8, (1, 64, 64, 3)).astype(np.float32)
    twice = stored_twice(rough, rough, ([None], [None]))
    luma = 255 * (np.round(255 * rough) / 255 - rough) @ np.array([0.299, 0.587, 0.114])
    assert np.mean(twice[..., 0] ** 2) == pytest.approx(4 * np.mean(luma**2), rel=0.1)


@pytest.mark.parametrize(("quality", "sampling"), [(50, 0), (50, 2), (80, 0)])
def test_files_of_unlike_quality_leave_all_that_they_differ_in(quality, sampling):
    """Nothing has changed: all of the difference is the coarser file's quantisation."""
    rng = np.random.default_rng(0)
    texture = 40 * gaussian_filter(rng.standard_normal((128, 128, 3)), (1.2, 1.2, 0))
    picture = 128 + texture + 6 * rng.standard_normal((128, 128, 1))
    files = saved(picture, 95, sampling), saved(picture, quality, sampling)
    shown = [np.asarray(f.image, np.float32)[None] for f in files]
    left = to_steps(shown[1][INNER]) - to_steps(shown[0][INNER])
    found = stored_twice(*shown, ([files[0]], [files[1]]))
    shares = (found**2).mean((0, 1, 2)) / (left**2).mean((0, 1, 2))
    assert 0.9 < shares[0] < 1.25
    assert 0.9 < (found**2).sum() / (left**2).sum() < 1.25
