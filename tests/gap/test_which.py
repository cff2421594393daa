"""What counts as not told apart from the effect that is named."""

import numpy as np
import pytest

from jaxisp.gap.refit import Trial
from jaxisp.gap.which import best, lookalikes


def trial(effect, closed, low, high):
    return Trial(effect, np.zeros(1), 10.0, 10.0 - 9 * closed, closed, low, high, 0.05)


@pytest.mark.parametrize(("apart", "others"), [(np.inf, ["vignetting"]), (0.02, [])])
def test_others_are_told_apart_by_a_fifth_or_by_what_is_harmless(apart, others):
    winner = trial("chroma_denoising", 0.9, 0.88, 0.92)
    assert (
        lookalikes(winner, [winner, trial("vignetting", 0.75, 0, 1), trial("prnu", 0.5, 0, 1)], apart)
        == others
    )


@pytest.mark.parametrize("apart", [np.inf, 0.02])
def test_what_is_easily_taken_for_it_is_named_with_it_up_to_a_fifth(apart):
    winner, near = trial("chroma_denoising", 0.9, 0.88, 0.92), trial("chroma_subsampling", 0.75, 0, 1)
    assert lookalikes(winner, [winner, near], apart) == ["chroma_subsampling"]
    assert lookalikes(near, [near, trial("chroma_denoising", 0.62, 0, 1)], apart) == ["chroma_denoising"]
    assert lookalikes(winner, [winner, trial("chroma_subsampling", 0.7, 0, 1)], apart) == []


def test_what_leaves_twice_as_much_is_told_apart():
    winner, other = trial("prnu", 0.985, 0.98, 0.99), trial("column_noise", 0.8, 0.79, 0.81)
    assert lookalikes(winner, [winner, other], 0.02) == []


def test_a_wide_interval_tells_nothing_apart():
    winner = trial("vignetting", 0.9, 0.2, 1.6)
    assert lookalikes(winner, [winner, trial("prnu", 0.3, 0, 1)], 0.02) == ["prnu"]


def test_what_the_files_show_comes_first_where_it_is_accepted():
    near, shown = trial("motion_blur", 0.7, 0.6, 0.8), trial("double_compression", 0.5, 0.4, 0.6)
    assert best([near, shown]) is near
    assert best([near, shown], ["double_compression"]) is shown
    assert best([near, trial("double_compression", 0.05, 0.0, 0.1)], ["double_compression"]) is near
    assert best([near, trial("double_compression", 0.2, 0.15, 0.25)], ["double_compression"]) is near
