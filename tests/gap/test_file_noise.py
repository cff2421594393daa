"""What a picture's file did to it, told from what a model misses of the camera."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxisp.gap.pairs.file_noise import file_noise
from jaxisp.gap.pairs.pairs import to_rgb, to_steps
from tests.gap.test_stored_twice import saved


@pytest.fixture(scope="module")
def case():
    """A picture before and after its file, and the header."""
    rng = np.random.default_rng(0)
    texture = 40 * gaussian_filter(rng.standard_normal((132, 128, 3)), (1.2, 1.2, 0))
    true = 128 + texture + 6 * rng.standard_normal((132, 128, 1))
    file = saved(true)
    return np.float32(true / 255)[None], file.image[None], file


def test_beside_a_right_model_all_is_the_files(case):
    true, shown, file = case
    found = file_noise(shown - true, shown, [file])
    left = to_steps(shown - true - found)[:, :128]
    assert np.square(left).mean() < 0.05 * np.square(to_steps(shown - true)).mean()
    np.testing.assert_array_equal(found[:, 128:], 0)  # rows that are no whole block


@pytest.mark.parametrize("missed", [4.0, 40.0])
def test_the_remainder_is_nearer_to_what_the_camera_made(case, missed):
    """Less the file's part it is nearer to the uncompressed picture than the file is: of a Wiener filter the
    mean square is that of noise and of what is missed, multiplied and over their sum."""
    true, shown, file = case
    rng = np.random.default_rng(1)
    model = true + np.float32(missed / 255) * gaussian_filter(rng.standard_normal(true.shape), (0, 1, 1, 0))
    found = file_noise(shown - model, shown, [file])[:, :128]

    def off(picture):
        return float(np.square(to_steps(picture - true[:, :128])).sum(-1).mean())

    by_file, cleaned, by_model = off(shown[:, :128]), off(shown[:, :128] - found), off(model[:, :128])
    assert cleaned < 1.02 * by_file * by_model / (by_file + by_model)


def test_a_picture_that_was_not_compressed_has_next_to_none(case):
    true, _, _ = case
    shown = np.round(255 * true) / np.float32(255)
    found = file_noise(shown - 0.9 * true, shown, [None])
    assert np.square(255 * found).sum(-1).mean() < 3 / 12


def test_steps_are_taken_back(case):
    np.testing.assert_allclose(to_rgb(to_steps(case[0])), case[0], atol=1e-6)
