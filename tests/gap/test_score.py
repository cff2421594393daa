"""The score: what its data must be, and what the signs of an effect are in closed form."""

import dataclasses
import math

import numpy as np
import pytest

from experiments.score.fit import SIDES, area, brier, calibration, fitted
from experiments.score.misses import NO_GAP, SCREENED, row_of, row_of_nothing
from jaxisp.gap.case import Gap
from jaxisp.gap.search import score
from jaxisp.gap.search.signs import Signs, left_signs, signs
from jaxisp.gap.search.states import Shown
from jaxisp.gap.search.trial import Bars, Trial


@pytest.mark.parametrize("question", SIDES)
def test_every_weight_has_the_side_that_its_sign_means(question):
    row = score.table()[question]
    assert set(row["signs"]) <= set(SIDES[question])
    if question == score.EFFECT:
        assert set(row["signs"]) <= set(Signs._fields)
    for name, (_, deviation, weight) in row["signs"].items():
        assert weight * SIDES[question][name] >= 0 and deviation > 0


def test_a_probability_is_a_logistic_regression():
    row = {"intercept": -1.0, "signs": {"size": [2.0, 0.5, 3.0], "closed": [0.0, 1.0, -2.0]}}
    p = score.logistic(row, {"size": 2.5, "closed": 0.25, "form": 7.0})
    assert p == pytest.approx(1 / (1 + math.exp(1.0 - 3.0 + 0.5)))
    assert 0 < score.logistic(row, {"size": -1e6, "closed": 0.0}) < 1e-12


def test_a_fit_finds_the_weights_that_made_the_answers(monkeypatch):
    """Of 4000 rows drawn from a known logistic; a sign without a meaning, or of the other side, has none."""
    rng = np.random.default_rng(1)
    names = ["size", "closed", "surely", "lead"]
    monkeypatch.setitem(SIDES, "x", dict.fromkeys(names, 1))
    values = rng.normal(size=(4000, len(names)))
    true = np.array([1.5, 0.7, 0.0, -0.3])
    answers = rng.uniform(size=4000) < 1 / (1 + np.exp(0.5 - values @ true))
    rows = [({}, "x", bool(a), dict(zip(names, v))) for a, v in zip(answers, values)]
    found = fitted(rows, "x")
    weights = {name: weight / deviation for name, (_, deviation, weight) in found["signs"].items()}
    assert weights[names[0]] == pytest.approx(1.5, abs=0.2) and weights[names[1]] == pytest.approx(
        0.7, abs=0.2
    )
    assert abs(weights.get(names[2], 0.0)) < 0.15 and names[3] not in weights


def test_figures_of_a_score():
    rows = [(0.9, True), (0.8, True), (0.8, False), (0.1, False)]
    assert brier(rows) == pytest.approx((0.01 + 0.04 + 0.64 + 0.01) / 4)
    assert area(rows) == pytest.approx((4 - 0.5) / 4)
    # 0.1 to 0.3: one row of 0; 0.7 to 0.9: two rows of 0.5; 0.9 to 1: one of 1
    assert calibration(rows) == pytest.approx((0.1 + 2 * 0.3 + 0.1) / 4)


TRIAL = Trial(
    "sharpening", np.array([0.5, -0.5]), 11.0, 6.0, 0.5, 0.4, 0.6, Bars(0.05), surely=0.3, learnt=0.6,
    drops=np.array([[4.0, 6.0]]), changes=np.array([[4.0, 6.0]]),
)  # fmt: skip
GAP = Gap(11.0, 1.0)


def state(error, **shares):
    return Shown(error, [{"axis": axis, "share": share, "p_value": 0.0} for axis, share in shares.items()])


def test_signs_of_an_effect():
    others = [TRIAL, dataclasses.replace(TRIAL, effect="prnu", closed=0.1),
              dataclasses.replace(TRIAL, effect="optical_blur", closed=0.4)]  # fmt: skip
    was, now = state(10.0, edge=0.5, row=0.2, hue=0.1), state(6.0, edge=0.25, row=0.5, hue=0.0)
    found = signs("raw+jpeg", GAP, TRIAL, others, TRIAL.z, 0.7, (was, now), 0.3)
    assert found.size == pytest.approx(math.log2(1 + 4)) and found.gap == pytest.approx(math.log2(11))
    assert (found.closed, found.sure, found.surely) == pytest.approx((0.5, 0.8, 0.6))
    assert (found.lead, found.lead_alike, found.ahead) == pytest.approx((0.8, 0.2, 0.2))
    assert (found.form, found.even) == pytest.approx((1.0, 1.0))
    assert (found.learnt, found.halves, found.left, found.later) == pytest.approx((0.5 / 0.6, 0.7, 0.3, 0.0))
    assert found.contrary == 0.5 and found.own_share == pytest.approx(5 / 8)
    assert found.own_fell == pytest.approx(1 - 1.5 / 5) and found.other_fell == pytest.approx(1 - 3 / 3)
    assert found.place_left == pytest.approx(3 / 5) and found.worse == pytest.approx(1 / 5)


def test_a_change_that_only_partly_hits_the_gap_has_another_form():
    apart = dataclasses.replace(TRIAL, drops=np.array([[8.0, -2.0]]), changes=np.array([[6.0, 6.0]]))
    found = signs("raw+jpeg", GAP, apart, [apart], apart.z, 0.0, (state(10.0), state(5.0)), 0.0)
    assert found.form == pytest.approx(0.5) and found.even < 0.6
    assert found.own_fell == found.other_fell == 0.0  # no axis has a part of the gap


def test_signs_of_what_is_left():
    found = left_signs(GAP, 4.0, 0.9, null_drop=2.0)
    assert found == pytest.approx(
        {"excess": math.log2(1 + 10 / 2), "left": math.log2(4), "share_left": 0.3, "likeliest": 0.9}
    )
    assert left_signs(GAP, 0.5, 0.0, 2.0)["left"] == 0.0


def test_a_gap_of_half_of_what_harmless_mismatches_have_is_as_good_as_none():
    small, none, more = (left_signs(Gap(before, 1.0), 1.0, 0.0, 2.0) for before in (2.0, 0.5, 2.2))
    assert small["excess"] == none["excess"] < more["excess"]


def test_a_case_without_a_gap_is_told_from_one_that_was_not_refitted():
    """Where nothing is refitted there are no effects to rank."""
    case = {"name": "a", "truth": ["vignetting"], "kind": "raw+jpeg", "signs": {}, "found": []}
    gap = {"before": 3.0, "floor": 2.0}
    assert row_of(case | {"gap": gap, "closed": {}}) == ["a", "vignetting", "1.5", "", "", "", NO_GAP]
    other = row_of(case | {"gap": gap, "closed": {"sharpening": 0.2}})
    assert other[-2:] == ["sharpening 0.20", SCREENED]
    assert row_of_nothing(case | {"gap": gap, "closed": {}}) == ["a", "3.0", "2.0", "", ""]
