"""Which pairs of two sets were made of the same RAW files, however alignment cut them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from jaxisp.gap.pairs.same_raw import of_same_raws
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded
from jaxisp.io.settings import Settings

SIDE = 112


def pair(seed, value=0.5):
    """A pair whose picture has one value, on a mosaic of noise; a seed is a RAW file."""
    mosaic = np.random.default_rng(seed).uniform(0, 1, (SIDE, SIDE)).astype(np.float32)
    raw = Raw(
        Path(f"{seed}.dng"),
        mosaic,
        "RGGB",
        np.zeros(4),
        1.0,
        np.ones(3),
        (0, 0, SIDE, SIDE),
        (0, 0, SIDE, SIDE),
    )
    picture = np.full((SIDE, SIDE, 3), value, np.float32)
    return Loaded(f"s{seed}", picture, None, raw, None, Settings(), False, None)


def cut(own, top, left, bottom=SIDE, right=SIDE):
    """What alignment makes of a picture that shows less than its RAW."""
    part = (slice(top, bottom), slice(left, right))
    mosaic = own.raw.mosaic[part]
    raw = dataclasses.replace(own.raw, mosaic=mosaic, crop=(top, left, *mosaic.shape))
    return dataclasses.replace(own, raw=raw, picture=own.picture[part])


def test_files_are_told_by_what_they_hold():
    """Names and order do not matter."""
    own = [pair(0, 0.2), pair(1, 0.3), pair(2, 0.4)]
    others = [dataclasses.replace(pair(i, 0.6 + i / 10), name=f"x{i}") for i in (2, 0, 1)]
    kept, found = of_same_raws(own, others)
    assert [p.name for p in kept] == [p.name for p in found] == ["s0", "s1", "s2"]
    assert [float(p.picture.mean()) for p in found] == pytest.approx([0.6, 0.7, 0.8])


def test_pairs_without_a_counterpart_are_left_out_where_two_have_one():
    own = [pair(i) for i in range(4)]
    kept, found = of_same_raws(own, [pair(3), pair(1), pair(9)])
    assert [p.name for p in kept] == ["s1", "s3"] and len(found) == 2
    assert of_same_raws(own, [pair(3), pair(9)]) == ([], [])
    assert of_same_raws(own, []) == ([], [])


def test_a_pair_that_is_alone_and_stands_twice_is_found_twice():
    kept, found = of_same_raws([pair(0)] * 2, [pair(0, 0.7)] * 2)
    assert len(kept) == len(found) == 2


def test_the_same_file_under_two_names_keeps_both():
    own = [pair(0), dataclasses.replace(pair(0, 0.1), name="again")]
    assert [p.name for p in of_same_raws(own, [pair(0, 0.7)])[1]] == ["s0", "again"]


@pytest.mark.parametrize(
    ("own", "other", "start"), [((0, 0), (4, 6), 16), ((4, 4), (0, 0), 4), ((4, 4), (8, 8), 20)]
)
def test_files_that_were_cut_differently_share_an_area(own, other, start):
    """It begins where filters and blocks of the first have their phase."""
    whole = [pair(i) for i in range(2)]
    kept, found = of_same_raws([cut(p, *own) for p in whole], [cut(p, *other, 104, 108) for p in whole])
    for one, two, full in zip(kept, found, whole, strict=True):
        np.testing.assert_array_equal(one.raw.mosaic, full.raw.mosaic[start:104, start:108])
        np.testing.assert_array_equal(two.raw.mosaic, one.raw.mosaic)
        assert one.raw.crop == two.raw.crop == (start, start, 104 - start, 108 - start)
        assert one.raw.cfa == two.raw.cfa == "RGGB" and one.picture.shape == (*one.raw.mosaic.shape, 3)


def test_a_mosaic_that_begins_at_another_place_of_the_pattern_keeps_its_own():
    whole = [pair(i) for i in range(2)]
    odd = [cut(p, 1, 0) for p in whole]
    odd = [dataclasses.replace(p, raw=dataclasses.replace(p.raw, cfa="GBRG")) for p in odd]
    (first, _), (found, _) = of_same_raws(whole, odd)
    assert first.raw.cfa == found.raw.cfa == "RGGB" and first.raw.crop == found.raw.crop


def test_areas_that_are_too_small_do_not_count():
    whole = [pair(i) for i in range(2)]
    assert of_same_raws([cut(p, 0, 0, 80, SIDE) for p in whole], [cut(p, 48, 0) for p in whole]) == ([], [])
