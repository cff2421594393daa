"""Batches for training loops: the bits that the trainer draws, resumed, on many devices, cut ahead."""

import threading

import jax
import numpy as np
import pytest
from jax.sharding import Mesh

from jaxisp.data import Batches, CleanImages, CleanPatches, DegradedBatches, batches
from jaxisp.io import write_png
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image


@pytest.fixture(scope="module")
def source():
    images = tuple(np.uint16(65535 * smooth_image((40, 31, 3), i)) for i in range(3))
    return CleanPatches(CleanImages(("a", "b", "c"), images), 12, per_image=8, seed=1)


def test_batches_are_those_of_the_source_for_grain(source):
    recipe = RECIPES["amwgn"]()
    wanted = DegradedBatches(source, recipe, batch=8, seed=3)
    with Batches(source, recipe, batch=8, seed=3) as ours:
        for i in range(3):
            noisy, clean = next(ours)
            np.testing.assert_array_equal(clean, wanted[i]["clean"])
            np.testing.assert_array_equal(noisy, wanted[i]["noisy"])
        assert ours.next == 3
        last = [np.asarray(a) for a in next(ours)]
    with Batches(source, recipe, batch=8, seed=3, start=3) as later:
        for a, b in zip(next(later), last):
            np.testing.assert_array_equal(a, b)


@pytest.mark.optimised
def test_bits_are_the_same_on_eight_devices(source):
    recipe, devices = RECIPES["amwgn"](), jax.devices()
    mesh = Mesh(np.asarray(devices), ("batch",))
    with (
        Batches(source, recipe, batch=16, seed=3) as one,
        Batches(source, recipe, batch=16, seed=3, mesh=mesh) as all,
    ):
        for _ in range(2):
            (noisy, clean), (noisy_8, clean_8) = next(one), next(all)
            assert len(noisy_8.sharding.device_set) == len(clean_8.sharding.device_set) == len(devices) == 8
            np.testing.assert_array_equal(clean, clean_8)
            np.testing.assert_array_equal(noisy, noisy_8)


def test_patches_are_cut_ahead_in_a_thread_that_ends():
    cut = []

    class Slow:
        def batch(self, indices):
            cut.append((indices[0], threading.current_thread() is threading.main_thread()))
            return np.zeros((len(indices), 8, 8, 3), np.float32)

    with Batches(Slow(), RECIPES["awgn"](), batch=2, ahead=3) as ours:
        next(ours)
    assert [first for first, _ in cut[:3]] == [0, 2, 4] and not any(main for _, main in cut)
    assert not [t for t in threading.enumerate() if t.name.startswith("jaxisp-batches")]


def test_from_a_folder(tmp_path):
    write_png(tmp_path / "a.png", smooth_image((40, 50, 3)))
    with batches(tmp_path, RECIPES["awgn"](), 16, batch=4, downsample=2) as ours:
        noisy, clean = next(ours)
    assert noisy.shape == clean.shape == (4, 16, 16, 3) and noisy.dtype == np.float32
