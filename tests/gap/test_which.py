"""What counts as not told apart from the effect that is named."""

import dataclasses
import types
from typing import ClassVar

import numpy as np
import pytest

from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.refit import Trial
from jaxisp.gap.search.screening import best, foretold, hidden, like_the_nearest, lookalikes, of_form


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


def test_what_takes_pixels_farther_away_is_neither_accepted_nor_named_beside_another():
    winner, warp = trial("chroma_denoising", 0.6, 0.5, 0.7), trial("geometric_distortion", 0.65, 0.6, 0.7)
    assert best([winner, warp]) is warp and lookalikes(warp, [winner, warp]) == ["chroma_denoising"]
    moved = dataclasses.replace(warp, farther=0.3)
    assert best([winner, moved]) is winner and best([moved]) is None
    assert lookalikes(winner, [winner, moved]) == []


def test_a_share_that_few_scenes_leave_open_is_not_accepted():
    wide = trial("row_noise", 0.8, 0.3, 1.2)
    assert best([wide]) is wide and best([dataclasses.replace(wide, surely=-0.1)]) is None


def test_of_two_that_close_about_as_much_the_nearer_is_named_alone():
    winner, warp = trial("geometric_distortion", 0.71, 0.6, 0.8), trial("chroma_denoising", 0.73, 0.6, 0.8)
    near = dataclasses.replace(winner, farther=-0.3)
    assert best([winner, warp]) is warp and best([near, warp]) is near
    assert lookalikes(near, [near, warp]) == [] and lookalikes(warp, [near, warp]) == [near.effect]
    grain = trial("film_grain", 0.73, 0.6, 0.8)  # adds noise, which moves no mean
    assert best([near, grain]) is grain and lookalikes(near, [near, grain]) == ["film_grain"]
    assert best([dataclasses.replace(near, closed=0.5, farther=-0.15), warp]) is warp


def test_what_brings_pixels_nearer_by_far_comes_first_where_it_could_lead():
    """Denoising closes more statistics of a lens that parts the colours, and leaves them where they are."""
    denoising, lens = (
        trial("luma_denoising", 0.6, 0.5, 0.7),
        trial("lateral_chromatic_aberration", 0.4, 0.3, 0.5),
    )
    near = dataclasses.replace(lens, farther=-0.27)
    assert best([denoising, lens]) is denoising and best([denoising, near]) is near
    assert best([dataclasses.replace(denoising, farther=-0.1), near]) is not near
    assert best([denoising, dataclasses.replace(near, closed=0.2)]) is denoising
    assert best([dataclasses.replace(denoising, effect="film_grain"), near]).effect == "film_grain"


def test_a_small_share_of_a_large_gap_is_accepted_where_pixels_show_the_effect():
    blur = dataclasses.replace(trial("motion_blur", 0.08, 0.07, 0.09), least=0.12, plainly=0.02)
    assert not blur.accepted  # too little of what is left, and pixels say nothing
    assert dataclasses.replace(blur, farther=-0.25).accepted
    assert dataclasses.replace(blur, farther=-0.1, cleared=0.6).accepted
    assert not dataclasses.replace(blur, farther=-0.1, cleared=0.4).accepted
    assert not dataclasses.replace(blur, farther=-0.25, low=0.04).accepted  # never less than 5 % of the gap
    assert not dataclasses.replace(blur, farther=-0.25, plainly=0.08).accepted
    assert not dataclasses.replace(blur, farther=-0.25, plainly=np.inf).accepted


def test_what_closes_most_of_the_rest_need_be_sure_of_that_alone():
    """Scenes differ in what the first of two causes makes, which says nothing of the second."""
    rows = dataclasses.replace(trial("row_noise", 0.15, 0.08, 0.21), surely=0.04, least=0.06)
    assert not rows.accepted
    assert dataclasses.replace(rows, rest=0.2).accepted
    assert not dataclasses.replace(rows, rest=0.3).accepted  # half of what is left may be another's form
    assert not dataclasses.replace(rows, rest=0.2, surely=0.009).accepted
    assert not dataclasses.replace(rows, rest=0.2, low=0.05).accepted


def test_what_is_nearer_by_far_leads_what_causes_before_left():
    smooth, blur = trial("chroma_denoising", 0.09, 0.07, 0.11), trial("motion_blur", 0.06, 0.055, 0.1)
    near = dataclasses.replace(blur, farther=-0.3)
    assert best([smooth, near]) is smooth and best([smooth, near], remaining=0.16) is near


def test_what_is_easily_taken_for_a_cause_must_close_more_than_its_form_may_cost():
    causes = [trial("chroma_denoising", 0.9, 0.8, 1.0), trial("vignetting", 0.05, 0.04, 0.06)]
    assert of_form("chroma_subsampling", causes) == pytest.approx(0.18)
    assert of_form("sharpening", causes) == of_form("chroma_subsampling", []) == 0.0


def test_what_the_nearest_may_have_been_taken_for_is_tried_too():
    others = ["jpeg_quantization", "prnu", "chroma_subsampling"]
    near, far = trial("chroma_denoising", 0.6, 0.5, 0.7), trial("prnu", 0.2, 0.1, 0.3)
    assert like_the_nearest([far, near], others) == ["jpeg_quantization", "chroma_subsampling"]
    assert like_the_nearest([far, dataclasses.replace(near, closed=0.2)], others) == []  # it could not lead


def test_a_wide_interval_tells_nothing_apart():
    winner = trial("vignetting", 0.9, 0.2, 1.6)
    assert lookalikes(winner, [winner, trial("prnu", 0.3, 0, 1)], 0.02) == ["prnu"]


def test_what_the_files_show_comes_first_where_it_is_accepted():
    near, shown = trial("motion_blur", 0.7, 0.6, 0.8), trial("double_compression", 0.5, 0.4, 0.6)
    assert best([near, shown]) is near
    assert best([near, shown], ["double_compression"]) is shown
    assert best([near, trial("double_compression", 0.05, 0.0, 0.1)], ["double_compression"]) is near
    assert best([near, trial("double_compression", 0.2, 0.15, 0.25)], ["double_compression"]) is near


class Curved:
    """Two pairs whose one statistic an effect moves by z + z^2 / 2, and a usual place and range for z."""

    REAL, PROBE = np.array([1.5, 1.6]), 0.1
    references: ClassVar = {}

    class model:
        base_indices: ClassVar = []
        base: ClassVar = []
        ranges = np.array([[0.0], [3.0]])
        precisions, usual = np.zeros(1), np.zeros(1)

        @staticmethod
        def indices(names):
            return [0]

    def __init__(self, bend=0.5):
        self.z, self.bend = np.zeros(1), bend

    def moved(self, z):
        return z + self.bend * z**2

    def errors(self, z):
        return (self.REAL - self.moved(z[0])) ** 2

    def normal(self, which):
        slope = self.moved(self.PROBE) / self.PROBE
        return np.full((2, 1, 1), slope**2), slope * self.REAL[:, None]


def test_a_step_is_measured_where_it_ends_not_promised_by_a_line():
    """The line goes to 1.43, where the curve is at 2.45: half of it, at 0.97, is nearest of what is tried."""
    whole = float(Curved.REAL[1] ** 2)
    step = Curved.REAL[0] / 1.05 / (1 + 1e-3)
    curved = Curved()
    expected = whole - float(curved.errors(np.array([step / 2]))[1])
    assert foretold(curved, "prnu", Split((0,), (1,))) == pytest.approx(expected, rel=1e-3)
    assert foretold(Curved(0.0), "prnu", Split((0,), (1,))) == pytest.approx(whole - 0.1**2, rel=1e-2)


def test_a_step_that_helps_nowhere_promises_nothing():
    """Both ways along it statistics move away."""
    curved = Curved(0.0)
    curved.moved = lambda z: -abs(z)
    curved.normal = lambda which: (np.ones((2, 1, 1)), Curved.REAL[:, None])
    assert foretold(curved, "prnu", Split((0,), (1,))) == 0.0


class Linear:
    """Columns (N, P) of a base's number, and of one each of three effects; `sharpening` may move by 2."""

    NAMES = ("saturation", "sharpening", "double_compression")

    def __init__(self, *columns):
        self.columns, self.z = dict(enumerate(columns)), np.zeros(4)
        grids = [(), (), (), (-1.0,)]
        self.model = types.SimpleNamespace(
            base=[0], base_indices=[0], ranges=np.array([[-1.0, -2, 0, -1], [1, 1, 2, 0]]),
            indices=lambda names: [1 + self.NAMES.index(name) for name in names],
            coordinates=[types.SimpleNamespace(move=types.SimpleNamespace(grid=grid)) for grid in grids],
        )  # fmt: skip

    def normal(self, which):
        stacked = np.stack([self.columns[i] for i in which], 1)
        return np.einsum("nkp,nlp->nkl", stacked, stacked) / stacked.shape[-1], None


def test_pairs_cannot_show_what_hardly_changes_them_beyond_what_the_base_imitates():
    base, own = np.array([[1.0, 1, 0, 0]]), np.array([[0.0, 0, 2, 0]])
    # half of the range, one, makes a mean square of one in the first, of none beyond the base in the second
    problem = Linear(base, own, 3 * base + 0.01 * own, 0 * base)
    assert hidden(problem, Linear.NAMES, 0.9) == ["sharpening"]
    assert hidden(problem, Linear.NAMES, 1.1) == ["saturation", "sharpening"]
    assert hidden(problem, Linear.NAMES, 0.00001) == []
