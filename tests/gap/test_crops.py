"""What part of a large set is diagnosed: the middles of the pairs, and of very many pairs some."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxisp.cfa import XTRANS, shifted
from jaxisp.gap.pairs.crops import MOST, SMALLEST, common_crop, common_size, sampled
from jaxisp.gap.pairs.scenes import scene_name
from jaxisp.io.datasets import Loaded
from jaxisp.io.raw import Raw
from jaxisp.io.settings import Settings


def pair(name: str, size: tuple[int, int], cfa: str | None = None) -> Loaded:
    """A pair whose pixels say where they are: without a pattern, clean+noisy."""
    place = np.broadcast_to(np.arange(size[1], dtype=np.float32) + 1e4 * np.arange(size[0])[:, None], size)
    picture = np.broadcast_to(place[..., None], (*size, 3))
    area = (0, 0, *size)
    raw = None if cfa is None else Raw(Path(name), place, cfa, np.zeros(4), 1.0, np.ones(3), area, area)
    return Loaded(name, picture, None, raw, picture if cfa is None else None, Settings(), False, None)


def pixels(loaded: list[Loaded]) -> int:
    return sum(p.picture[..., 0].size for p in loaded)


def test_a_set_that_fits_is_left_as_it_is():
    loaded = [pair(f"s{k}", (256, 256)) for k in range(MOST // 256**2)]
    assert all(one is other for one, other in zip(sampled(loaded, len(loaded)), loaded, strict=True))


@pytest.mark.parametrize("cfa", [None, "GRBG", XTRANS])
def test_the_middles_of_large_pairs_keep_their_place_on_all_grids(cfa):
    loaded = [pair(f"s{k}", (384, 512), cfa) for k in range(8)]
    found = sampled(loaded, len(loaded))
    assert len(found) == 8 and 0.9 * MOST < pixels(found) <= MOST
    for own in found:
        other = own.clean[..., 0] if own.raw is None else own.raw.mosaic
        np.testing.assert_array_equal(own.picture[..., 0], other)
        top, left = divmod(int(own.picture[0, 0, 0]), 10_000)
        assert top % 16 == left % 16 == 0
        assert abs(2 * top + own.picture.shape[0] - 384) < 100 > abs(2 * left + own.picture.shape[1] - 512)
        if cfa:
            assert own.raw.cfa == shifted(cfa, top, left) == cfa
            assert own.raw.crop == (top, left, *own.picture.shape[:2])


def test_of_many_frames_all_scenes_keep_some():
    loaded = [pair(f"s{s}.f{f:02}", (312, 424)) for s in range(8) for f in range(4)]
    found = sampled(loaded, len(loaded))
    names = [p.name for p in found]
    assert names == sorted(names) and pixels(found) <= MOST
    frames = [sum(scene_name(n) == f"s{s}" for n in names) for s in range(8)]
    assert set(frames) == {2, 3} and found[0].picture.shape[:2] == (192, 192)


def test_of_few_scenes_frames_are_spread():
    loaded = [pair(f"s{s}.f{f:02}", (256, 192)) for s in range(3) for f in range(21)]
    names = [p.name for p in sampled(loaded, len(loaded))]
    numbers = [[int(n[-2:]) for n in names if scene_name(n) == f"s{s}"] for s in range(3)]
    assert {len(own) for own in numbers} == {5, 6} and all(own[0] == 0 for own in numbers)
    assert all(3 <= step <= 5 for own in numbers for step in np.diff(own))


@given(st.integers(1, 300), st.integers(1, 300), st.integers(SMALLEST, 900), st.integers(SMALLEST, 900))
def test_two_sets_of_one_size_are_cut_alike(one, other, height, width):
    count = max(one, other)
    sets = [[pair(f"s{k:03}", (height, width)) for k in range(n)] for n in (one, other)]
    found = [sampled(own, count) for own in sets]
    assert common_size(found[0]) == common_size(found[1])
    assert all(pixels(own) <= MOST for own in found)
    assert all(min(common_size(own)) >= min(192, height, width) for own in found)


def test_the_middle_of_a_large_x_trans_frame_begins_a_cell():
    (rows, columns), *_ = common_crop([pair("s0", (1040, 1340), XTRANS)])
    assert (rows.start, columns.start) == (240, 384)
    assert shifted(XTRANS, rows.start, columns.start) == XTRANS
