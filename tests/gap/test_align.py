"""The two halves of a pair laid on each other."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, zoom

from jaxisp.errors import InputError
from jaxisp.gap.pairs.align_raw import align_raw
from jaxisp.gap.pairs.read import _load
from jaxisp.io.datasets import Loaded
from jaxisp.io.raw import Raw
from jaxisp.io.settings import Settings

SIZE = (120, 150)


def scene(seed: int) -> np.ndarray:
    picture = gaussian_filter(np.random.default_rng(seed).standard_normal(SIZE), 2)
    return np.clip(0.5 + 0.2 * picture / picture.std(), 0.02, 0.98).astype(np.float32)


def pair(name: str, mosaic: np.ndarray, grey: np.ndarray) -> Loaded:
    area = (0, 0, *SIZE)
    raw = Raw(Path(name), mosaic, "RGGB", np.zeros(4), 1.0, np.ones(3), area, area)
    picture = np.repeat(np.sqrt(grey)[..., None], 3, axis=-1).astype(np.float32)
    return Loaded(name, picture, None, raw, None, Settings(), False, None)


def unlike(found: Loaded) -> float:
    """The largest difference inside between the picture, made linear, and its mosaic."""
    assert found.raw is not None and found.raw.mosaic.shape == found.picture.shape[:2]
    return float(np.abs(found.picture[..., 1] ** 2 - found.raw.mosaic)[12:-12, 12:-12].max())


@pytest.mark.parametrize("top, left, cfa", [(2, 4, "RGGB"), (1, 0, "GBRG"), (3, 5, "BGGR")])
def test_a_picture_that_was_cut_is_laid_where_it_belongs(top, left, cfa):
    whole = scene(0)
    (found,), failed, (row,), _ = align_raw([pair("a", whole, whole[top:-1, left:])])
    assert failed == [] and row["done"] == "cut" and unlike(found) < 1e-6
    assert found.raw.cfa == cfa and found.picture.shape[:2] == (SIZE[0] - top - 1, SIZE[1] - left)


def test_pairs_cut_unlike_each_other_get_one_pattern():
    a, b = scene(0), scene(1)
    found, *_ = align_raw([pair("a", a, a[1:, 2:]), pair("b", b, b[2:, 1:])])
    assert {f.raw.cfa for f in found} == {"GBRG"} and max(map(unlike, found)) < 1e-6


def test_a_picture_of_the_same_size_is_moved():
    whole = scene(0)
    (found,), _, (row,), _ = align_raw([pair("a", whole, np.roll(whole, (-2, 3), (0, 1)))])
    assert unlike(found) < 1e-6 and row["done"] == "moved"
    np.testing.assert_allclose(row["shift_px"], (-2, 3), atol=0.2)


def test_a_picture_of_another_scale_is_resampled():
    whole = scene(0)
    (found,), _, (row,), _ = align_raw([pair("a", whole, np.clip(zoom(whole, 1.05, order=3), 0, 1))])
    assert unlike(found) < 0.05 and row["done"] == "resampled"
    np.testing.assert_allclose(row["scale"], 1.05, atol=0.01)


def test_a_pair_of_two_scenes_is_left_out():
    a, b = scene(0), scene(1)
    found, failed, *_ = align_raw([pair("a", a, a), pair("c", b, b), pair("b", b, scene(2))])
    assert [f.name for f in found] == ["a", "c"]
    assert failed[0][0] == "b" and "do not show one scene" in failed[0][1]
    with pytest.raises(InputError, match="do not show one scene"):
        align_raw([pair("b", b, scene(2)[:-8])])


def test_pictures_that_are_too_small_are_left_out():
    whole = scene(0)
    pairs = [pair("a", whole, whole), pair("b", whole, whole[:40, :70])]
    kept, failed = _load([SimpleNamespace(name=p.name, load=lambda p=p: p) for p in pairs])
    assert [p.name for p in kept] == ["a"]
    assert failed == [("b", "b: 70x40 px are too few to be diagnosed, expected 64 or more a side")]
