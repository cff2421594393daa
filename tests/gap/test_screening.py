"""What counts as not told apart from the effect that is named."""

import dataclasses

import numpy as np
import pytest

from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.screening import best, hidden, like_the_nearest, lookalikes, of_form, predicted
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.simulator.effects import Move
from jaxisp.gap.simulator.model import Coordinate
from tests.gap import toy

C = CRITERIA["clean+noisy"]


def trial(effect, closed, low, high):
    return Trial(effect, np.zeros(1), 10.0, 10.0 - 9 * closed, closed, low, high, Bars(0.05))


@pytest.mark.parametrize(("apart", "others"), [(np.inf, ["vignetting"]), (0.02, [])])
def test_others_are_told_apart_by_a_fifth_or_by_what_is_harmless(apart, others):
    winner = trial("chroma_denoising", 0.9, 0.88, 0.92)
    assert (
        lookalikes(winner, [winner, trial("vignetting", 0.75, 0, 1), trial("prnu", 0.5, 0, 1)], C, apart)
        == others
    )


@pytest.mark.parametrize("apart", [np.inf, 0.02])
def test_what_is_easily_taken_for_it_is_named_with_it_up_to_a_fifth(apart):
    winner, near = trial("chroma_denoising", 0.9, 0.88, 0.92), trial("chroma_subsampling", 0.75, 0, 1)
    assert lookalikes(winner, [winner, near], C, apart) == ["chroma_subsampling"]
    assert lookalikes(near, [near, trial("chroma_denoising", 0.62, 0, 1)], C, apart) == ["chroma_denoising"]
    assert lookalikes(winner, [winner, trial("chroma_subsampling", 0.7, 0, 1)], C, apart) == []


def test_what_leaves_twice_as_much_is_told_apart():
    winner, other = trial("prnu", 0.985, 0.98, 0.99), trial("column_noise", 0.8, 0.79, 0.81)
    assert lookalikes(winner, [winner, other], C, 0.02) == []


def test_what_takes_pixels_farther_away_is_neither_accepted_nor_named_beside_another():
    winner, warp = trial("chroma_denoising", 0.6, 0.5, 0.7), trial("geometric_distortion", 0.65, 0.6, 0.7)
    assert best([winner, warp], C) is warp and lookalikes(warp, [winner, warp], C) == ["chroma_denoising"]
    moved = dataclasses.replace(warp, farther=0.3)
    assert best([winner, moved], C) is winner and best([moved], C) is None
    assert lookalikes(winner, [winner, moved], C) == []


def test_a_share_that_few_scenes_leave_open_is_not_accepted():
    wide = trial("row_noise", 0.8, 0.3, 1.2)
    assert best([wide], C) is wide and best([dataclasses.replace(wide, surely=-0.1)], C) is None


def test_of_two_that_close_about_as_much_the_nearer_is_named_alone():
    winner, warp = trial("geometric_distortion", 0.71, 0.6, 0.8), trial("chroma_denoising", 0.73, 0.6, 0.8)
    near = dataclasses.replace(winner, farther=-0.3)
    assert best([winner, warp], C) is warp and best([near, warp], C) is near
    assert lookalikes(near, [near, warp], C) == [] and lookalikes(warp, [near, warp], C) == [near.effect]
    grain = trial("film_grain", 0.73, 0.6, 0.8)  # adds noise, which moves no mean
    assert best([near, grain], C) is grain and lookalikes(near, [near, grain], C) == ["film_grain"]
    assert best([dataclasses.replace(near, closed=0.5, farther=-0.15), warp], C) is warp


def test_what_brings_pixels_nearer_by_far_comes_first_where_it_could_lead():
    """Denoising closes more statistics of a lens that parts the colours, and leaves them where they are."""
    denoising, lens = (
        trial("luma_denoising", 0.6, 0.5, 0.7),
        trial("lateral_chromatic_aberration", 0.4, 0.3, 0.5),
    )
    near = dataclasses.replace(lens, farther=-0.27)
    assert best([denoising, lens], C) is denoising and best([denoising, near], C) is near
    assert best([dataclasses.replace(denoising, farther=-0.1), near], C) is not near
    assert best([denoising, dataclasses.replace(near, closed=0.2)], C) is denoising
    assert best([dataclasses.replace(denoising, effect="film_grain"), near], C).effect == "film_grain"


def test_a_small_share_of_a_large_gap_is_accepted_where_pixels_show_the_effect():
    blur = dataclasses.replace(trial("motion_blur", 0.08, 0.07, 0.09), bars=Bars(0.12, 0.02))
    assert not blur.accepted(C)  # too little of what is left, and pixels say nothing
    assert dataclasses.replace(blur, farther=-0.25).accepted(C)
    assert dataclasses.replace(blur, farther=-0.1, cleared=0.6).accepted(C)
    assert not dataclasses.replace(blur, farther=-0.1, cleared=0.4).accepted(C)
    assert not dataclasses.replace(blur, farther=-0.25, low=0.04).accepted(
        C
    )  # never less than 5 % of the gap
    assert not dataclasses.replace(blur, farther=-0.25, bars=Bars(0.12, 0.08)).accepted(C)
    assert not dataclasses.replace(blur, farther=-0.25, bars=Bars(0.12)).accepted(C)


def test_what_closes_most_of_the_rest_need_be_sure_of_that_alone():
    """Scenes differ in what the first of two causes makes, which says nothing of the second."""
    rows = dataclasses.replace(trial("row_noise", 0.15, 0.08, 0.21), surely=0.04, bars=Bars(0.06))
    assert not rows.accepted(C)
    assert dataclasses.replace(rows, bars=Bars(0.06, rest=0.2)).accepted(C)
    assert not dataclasses.replace(rows, bars=Bars(0.06, rest=0.3)).accepted(
        C
    )  # half of what is left may be another's form
    assert not dataclasses.replace(rows, bars=Bars(0.06, rest=0.2), surely=0.009).accepted(C)
    assert not dataclasses.replace(rows, bars=Bars(0.06, rest=0.2), low=0.05).accepted(C)


def test_what_is_nearer_by_far_leads_what_causes_before_left():
    smooth, blur = trial("chroma_denoising", 0.09, 0.07, 0.11), trial("motion_blur", 0.06, 0.055, 0.1)
    near = dataclasses.replace(blur, farther=-0.3)
    assert best([smooth, near], C) is smooth and best([smooth, near], C, remaining=0.16) is near


def test_what_is_easily_taken_for_a_cause_must_close_more_than_its_form_may_cost():
    causes = [trial("chroma_denoising", 0.9, 0.8, 1.0), trial("vignetting", 0.05, 0.04, 0.06)]
    assert of_form("chroma_subsampling", causes, C) == pytest.approx(0.18)
    assert of_form("sharpening", causes, C) == of_form("chroma_subsampling", [], C) == 0.0


def test_what_the_nearest_may_have_been_taken_for_is_tried_too():
    others = ["jpeg_quantization", "prnu", "chroma_subsampling"]
    near, far = trial("chroma_denoising", 0.6, 0.5, 0.7), trial("prnu", 0.2, 0.1, 0.3)
    assert like_the_nearest([far, near], others, C) == ["jpeg_quantization", "chroma_subsampling"]
    assert (
        like_the_nearest([far, dataclasses.replace(near, closed=0.2)], others, C) == []
    )  # it could not lead


def test_a_wide_interval_tells_nothing_apart():
    winner = trial("vignetting", 0.9, 0.2, 1.6)
    assert lookalikes(winner, [winner, trial("prnu", 0.3, 0, 1)], C, 0.02) == ["prnu"]


def test_what_the_files_show_comes_first_where_it_is_accepted():
    near, shown = trial("motion_blur", 0.7, 0.6, 0.8), trial("double_compression", 0.5, 0.4, 0.6)
    assert best([near, shown], C) is near
    assert best([near, shown], C, ["double_compression"]) is shown
    assert best([near, trial("double_compression", 0.05, 0.0, 0.1)], C, ["double_compression"]) is near
    assert best([near, trial("double_compression", 0.2, 0.15, 0.25)], C, ["double_compression"]) is near


class Curved(toy.Line):
    """Two pairs whose one statistic an effect moves by z + bend z^2."""

    REAL, PROBE = np.array([1.5, 1.6]), 0.1

    def __init__(self, moved=lambda z: z + 0.5 * z**2):
        super().__init__(self.REAL[:, None], np.ones((1, 1)), np.zeros(1), Split((0,), (1,)), ("a", "b"))
        object.__setattr__(self, "moved", moved)

    def at(self, model, z):
        left = self.wanted - self.moved(z[0])
        return Point(
            model, z, (left**2).mean(1), (left,), {0: np.array([self.moved(self.PROBE) / self.PROBE])}
        )


def start(*effects):
    """A model without a base's coordinates, whose effects may move from 0 to 3."""
    moves = {name: (Coordinate(name, Move("x", 0.1, 0.0, 3.0)),) for name in effects}
    return dataclasses.replace(toy.model(()), base=(), effects=moves)


def test_a_step_is_measured_where_it_ends_not_promised_by_a_line():
    """The line goes to 1.43, where the curve is at 2.45: half of it, at 0.97, is nearest of what is tried."""
    whole, model = float(Curved.REAL[1] ** 2), start("saturation")
    step = Curved.REAL[0] / 1.05 / (1 + 1e-3)
    curved, straight = Curved(), Curved(lambda z: z)
    expected = whole - float(curved.at(model, np.array([step / 2])).errors[1])
    found = [predicted(own, own.at(model, np.zeros(1)), "saturation") for own in (curved, straight)]
    assert found == [pytest.approx(expected, rel=1e-3), pytest.approx(whole - 0.1**2, rel=1e-2)]


def test_a_step_that_helps_nowhere_promises_nothing():
    """What the probe saw is not what comes: both ways along it statistics move away."""
    curved = Curved(lambda z: z if z == Curved.PROBE else -abs(z))
    assert predicted(curved, curved.at(start("saturation"), np.zeros(1)), "saturation") == 0.0


def test_pairs_cannot_show_what_hardly_changes_them_beyond_what_the_base_imitates():
    names = ("saturation", "sharpening", "double_compression")
    base, own = np.array([1.0, 1, 0, 0]), np.array([0.0, 0, 2, 0])
    # half of the range, one, makes a mean square of one in the first, of none beyond the base in the second
    design = np.stack([base, own, 3 * base + 0.01 * own, 0 * base], 1)
    ranges = {
        "saturation": ((-2, 1), ()),
        "sharpening": ((0, 2), ()),
        "double_compression": ((-1, 0), (-1.0,)),
    }
    effects = {n: (Coordinate(n, Move("x", 0.1, *r, grid=g)),) for n, (r, g) in ranges.items()}
    model = dataclasses.replace(toy.model(()), effects=effects)
    evidence = toy.Line(np.zeros((2, 4)), design, np.zeros(4), Split((0,), (1,)))
    point = evidence.compute(evidence.at(model, np.zeros(4)), range(4))
    assert hidden(evidence, point, names, 0.9) == ["sharpening"]
    assert hidden(evidence, point, names, 1.1) == ["saturation", "sharpening"]
    assert hidden(evidence, point, names, 0.00001) == []
