"""What a fit demosaicks once and keeps: mixes, and the form that is soon compiled."""

import numpy as np
import pytest

from jaxisp.fit import model
from jaxisp.fit.tiles import prepare, with_source
from tests.fit.conftest import example


@pytest.fixture(scope="module")
def shot(folder):
    return prepare(example(folder))


@pytest.mark.parametrize("once", (True, False))
def test_a_mix_is_the_weighted_mean_of_two_demosaickers(shot, once):
    def source(*args, **given):
        design = model.Design(*args, **given)
        return np.asarray(with_source(shot.chunks[0], shot.cfa, design, once=once).source)

    one, other = source("demosaic_bilinear"), source("demosaic_ahd_libraw")
    mixed = source("demosaic_bilinear", mixed=("demosaic_ahd_libraw", 0.35))
    np.testing.assert_allclose(mixed, 0.65 * one + 0.35 * other, atol=1e-4)
    assert np.abs(other - one).max() > 0.01


@pytest.mark.optimised  # one of the two programs is never optimised
@pytest.mark.parametrize(
    "design",
    [
        model.Design("demosaic_rcd"),
        model.Design("demosaic_lmmse"),
        model.Design("demosaic_lmmse", passes=1, mixed=("demosaic_rcd", 0.35)),
    ],
)
def test_the_program_that_is_soon_compiled_demosaicks_alike(shot, design):
    quick, slow = (with_source(shot.chunks[0], shot.cfa, design, once=once).source for once in (True, False))
    np.testing.assert_allclose(quick, slow, atol=1e-4)
    assert np.asarray(slow).std() > 0.01
