"""Effects are added one after the other, and taken back where others make up for them: the search itself, on
evidence that is linear in a few numbers."""

import dataclasses

import numpy as np
import pytest

from jaxisp.gap.search.screening import screen
from jaxisp.gap.search.stepwise import _again, search
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.simulator.model import Variant
from tests.gap import toy


def quiet(done, total, text):
    pass


def searched(closes, beside=("prnu",), **more):
    """What is accepted of effects that close these shares of a gap of 10."""
    evidence, start = toy.apart(closes | dict.fromkeys(beside, 0.0))
    found = search(evidence, start, list(start.model.effects), toy.terms(evidence, start, **more), quiet)
    for trial, _ in found.causes:
        assert trial.closed == pytest.approx(closes[trial.effect], abs=0.01)
    return [t.effect for t, _ in found.causes]


def test_a_second_effect_is_measured_by_what_the_first_leaves():
    closes = {"chroma_denoising": 0.8, "vignetting": 0.15}
    assert searched(closes) == list(closes)
    assert searched(closes, criteria={"least_of_rest": 0.6}) == list(closes)  # of 0.2
    assert searched(closes, criteria={"least_of_rest": 0.78}) == ["chroma_denoising"]
    assert searched(closes, enough=0.25) == ["chroma_denoising"]


@pytest.mark.parametrize(("second", "found"), [("sharpening", 1), ("vignetting", 2)])
def test_a_lookalike_of_a_cause_is_asked_for_more_than_its_form_may_cost(second, found):
    closes = {"luma_denoising": 0.8, second: 0.15}
    assert searched(closes) == list(closes)[:found]


def test_an_effect_that_imitates_others_has_a_bar_of_its_own():
    closes = {"saturation": 0.8, "double_compression": 0.17}
    assert searched(closes) == list(closes)
    assert searched(closes, bars={"double_compression": 0.3}) == ["saturation"]


def test_nothing_to_try_finds_nothing():
    evidence, start = toy.apart({"vignetting": 0.5})
    found = search(evidence, start, [], toy.terms(evidence, start), quiet)
    assert found.causes == [] and found.trials == found.predicted == found.smallest == {}


def test_all_that_is_tried_may_be_found():
    assert searched({"chroma_denoising": 0.5}, beside=()) == ["chroma_denoising"]


def test_beside_grain_less_can_lead():
    assert searched({"green_imbalance": 0.12}) == []
    assert searched({"green_imbalance": 0.12}, leading=0.1) == ["green_imbalance"]


def test_a_search_changes_nothing_that_it_is_given():
    evidence, start = toy.apart({"chroma_denoising": 0.8, "vignetting": 0.15})
    before = dataclasses.replace(start)
    search(evidence, start, list(start.model.effects), toy.terms(evidence, start), quiet)
    assert (start.model, start.columns) == (before.model, {}) and not start.z.any()


def test_the_two_best_of_a_later_step_are_fitted_anew():
    """What leaves the least on the fitted pairs stays: those that close most, or pixels show; others as they
    were."""
    shares = {"vignetting": 0.1, "chroma_subsampling": 0.3, "sharpening": 0.2, "optical_blur": 0.05}
    evidence, start = toy.apart(shares)
    terms = toy.terms(evidence, start)

    def rough(name, share):
        z = np.zeros(len(start.z))
        z[[0, *start.model.indices([name])]] = 0.5
        bars = Bars(0.05)
        return Trial(name, z, 11.0, 11 - 10 * share, share, share, share, bars, error=99.0)

    trials = [rough(*own) for own in shares.items()]

    def anew(trials):
        found = _again(evidence, start, start.z, trials, terms)
        fitted = [one for one, before in zip(found, trials, strict=True) if one is not before]
        for one in fitted:
            assert one.error < 11 and one.closed == pytest.approx(shares[one.effect], abs=0.02)
        return {one.effect for one in fitted}

    assert anew(trials) == {"chroma_subsampling", "sharpening"}
    near = dataclasses.replace(trials[0], farther=-0.2)
    assert anew([near, *trials[1:]]) == {"chroma_subsampling", "vignetting"}
    assert anew([dataclasses.replace(t, error=0.5) for t in trials]) == set()  # they left less
    assert _again(evidence, start, start.z, [], terms) == []


@pytest.mark.parametrize("rival", [True, False])
def test_what_the_base_imitates_is_looked_for_beside_its_rival(rival):
    """Square roots imitate a chroma filter, and leave something else: at them the filter promises nothing."""
    names, linear = ("chroma_denoising", "vignetting"), Variant({"variant": np.float32(0)}, {})
    evidence = toy.line(
        dict(zip(names, np.eye(3))), (3.0, 0.7, 0.0), beside=(3.0, 0.0, 1.5), rival=linear if rival else None
    )
    roots = dataclasses.replace(toy.model(names), shared={"variant": np.float32(1)})
    start = evidence.at(roots, np.zeros(3))
    assert start.error < evidence.at(roots.chosen(linear), start.z).error
    found = search(evidence, start, names, toy.terms(evidence, start), quiet)
    # beside linear values it takes away 9 of what these leave more, 6.75
    assert found.predicted["chroma_denoising"] == pytest.approx(9 - 6.75 if rival else 0, abs=0.1)
    assert found.predicted["vignetting"] == pytest.approx(0.49, abs=0.01)
    assert ("chroma_denoising" in found.trials) == rival


HALVES = {"saturation": (0.5417, 0.5417, 0.6428), "chroma_subsampling": (1, 0, 0), "vignetting": (0, 1, 0)}
"""The first lies between the others, and beside them: of (1, 1, 0) it closes most alone, together they close
all."""


def of_halves(directions=HALVES, seen=(), distance=None):
    evidence = toy.line(directions, np.sqrt(5) * np.array([1.0, 1.0, 0.0]), distance=distance)
    model = toy.model(list(directions))
    start = evidence.at(model, np.zeros(len(model.coordinates)))
    found = search(evidence, start, list(directions), toy.terms(evidence, start, seen=seen), quiet)
    return [(t.effect, round(t.closed, 2)) for t, _ in found.causes]


def test_what_later_effects_make_up_for_is_taken_back():
    both = {("chroma_subsampling", 0.5), ("vignetting", 0.5)}
    assert set(of_halves()) == both
    assert of_halves(seen=["saturation"])[0][0] == "saturation"  # the files show it


def test_what_pixels_need_stays():
    """Without the first pixels are farther again."""
    names = {name for name, _ in of_halves(distance=lambda on: 10.0 - 3 * ("saturation" in on))}
    assert names == set(HALVES)


def test_what_nothing_else_makes_up_for_stays():
    beside = HALVES | {"saturation": (0.95, 0.312, 0.0)}
    del beside["vignetting"]
    assert [name for name, _ in of_halves(beside)] == ["saturation", "chroma_subsampling"]


def test_a_fitted_scene_that_lies_far_off_does_not_choose_what_is_refitted():
    """All pairs lack sharpening. Of saturation the held-out pairs lack 2, one fitted pair 8 and one none."""
    names = ("saturation", "sharpening")
    evidence = toy.line(dict(zip(names, np.eye(2))), (0.0, 2.0))
    ahead = evidence.design[:, 1] * np.array([0.0, 2.0, 8.0, 2.0])[:, None]
    evidence = dataclasses.replace(evidence, wanted=evidence.wanted + ahead)
    model = toy.model(names)
    start = evidence.at(model, np.zeros(len(model.coordinates)))
    drops, _ = screen(evidence, start, names)
    assert drops == {"saturation": pytest.approx(0, abs=0.1), "sharpening": pytest.approx(4, abs=0.1)}
    terms = toy.terms(evidence, start, criteria={"refitted": 1})
    found = search(evidence, start, names, terms, quiet)
    assert [trial.effect for trial, _ in found.causes] == ["sharpening"]
