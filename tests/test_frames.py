"""Frames that pictures of many sizes share."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxisp.arrays.extents import has_room
from jaxisp.frames import MOST_FRAMES, Frames, shared_frames
from jaxisp.pipeline import Chain, Gate, Shuffle, Stage, run, stage
from jaxisp.testing import smooth_image

sides = st.integers(1, 700)


@given(
    counts=st.dictionaries(st.tuples(sides, sides), st.integers(1, 9), min_size=1, max_size=60),
    margin=st.integers(0, 31),
)
@settings(max_examples=60, deadline=None)
def test_every_picture_has_a_frame_with_room(counts, margin):
    frames = shared_frames(counts, margin)
    assert len(frames.sizes) <= MOST_FRAMES
    if len(counts) <= MOST_FRAMES:
        assert frames == Frames()
        return
    for size in counts:
        frame = frames.of(size)
        assert (frame is None) == (min(size) < 5)
        assert frame is None or has_room(size, frame, margin)


def test_a_side_that_all_have_is_that_of_the_frame():
    frames = shared_frames({(640, 300 + k): 1 for k in range(200)}, 12)
    assert len(frames.sizes) == 8 and {height for height, _ in frames.sizes} == {640}
    assert max(width for _, width in frames.sizes) == 499 + 12


def test_sizes_of_many_pictures_have_frames_that_they_fill():
    counts = {(32 + k, 40): 1 for k in range(30)} | {(480, 640): 1000, (640, 480): 500}
    frames = shared_frames(counts, 2)
    assert frames.exact >= {(480, 640), (640, 480)} and frames.of((480, 640)) == (480, 640)
    assert frames.of((478, 638)) is None  # what fills its frame is alone in it


def test_pictures_too_large_or_too_small_go_alone():
    assert shared_frames({(3000 + k, 4000): 1 for k in range(9)} | {(4, 9): 1}, 2) == Frames()


@pytest.mark.parametrize("count", [200, 1000])
def test_frames_are_little_larger_than_the_pictures(count):
    """Sizes as in experiments.abuse.sizes, whose sides differ by a factor of three."""
    rng = np.random.default_rng(0)
    counts = Counter((int(h), int(w)) for h, w in rng.integers(32, 97, (count, 2)))
    frames = shared_frames(counts, 1)
    own, all_ = (sum(n * np.prod(of(s)) for s, n in counts.items()) for of in (tuple, frames.of))
    assert all_ < 1.45 * own


class Old(Stage):
    """As a node of a user's own was before there were frames."""

    def apply(self, params, image, key):
        return 1 - super().apply(params, image, key)


def test_a_node_of_ones_own_that_knows_no_frames_runs_alone():
    image = smooth_image((12, 14, 3))
    own = Shuffle((Gate(Old(stage("rounding").fn, "rounding")),), "order")
    chain = Chain((own, stage("clip")), "own")
    np.testing.assert_allclose(run(chain, chain.init(), image), 1 - image, atol=0.51 / 255)
