"""A picture in a larger frame, against NumPy's borders of the picture alone."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxisp.arrays.extents import Extent, clamped, mirrored

FRAME = (19, 23)
PROGRAMS = {"reflect": jax.jit(mirrored), "edge": jax.jit(clamped)}
sides = st.tuples(*(st.integers(2, n) for n in FRAME))


@pytest.mark.parametrize("mode", PROGRAMS)
@given(size=sides, seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_borders_are_those_of_the_picture(mode, size, seed):
    image = np.random.default_rng(seed).standard_normal(FRAME).astype(np.float32)
    picture = image[: size[0], : size[1]]
    want = np.pad(picture, [(0, n - s) for n, s in zip(FRAME, size)], mode=mode)
    np.testing.assert_array_equal(PROGRAMS[mode](image, Extent(*map(np.int32, size))), want)


def test_one_row_is_repeated():
    image = np.random.default_rng(0).standard_normal((4, 5, 3)).astype(np.float32)
    got = mirrored(image, Extent(np.int32(1), np.int32(5)))
    np.testing.assert_array_equal(got, np.repeat(image[:1], 4, 0))
