"""Which of the effects found are named, and in which order they are told: by the search itself, on evidence
that is linear in a few numbers."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from jaxisp.gap.case import Floor, Gap
from jaxisp.gap.search.stepwise import search
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.search.verdict import by_closure, named, searched, terms_of
from tests.gap import toy


def quiet(done, total, text):
    pass


def found_of(evidence, start, named=None, **more):
    case = toy.case(evidence, start, **more)
    if named is not None:
        case = dataclasses.replace(case, criteria=dataclasses.replace(case.criteria, named=named))
    return searched(case, case.gap(), quiet)


FIRST, SECOND = "chroma_denoising", "vignetting"


@pytest.mark.parametrize("share", [0.9, 0.35])
def test_an_effect_is_named_however_much_stays_unexplained(share):
    """A camera has more that is not modelled: what the effect closes is told, and the rest."""
    evidence, start = toy.apart({FIRST: share, "prnu": 0.0}, gap=30.0)
    found = found_of(evidence, start)
    ((cause, _),) = found.causes
    assert cause.effect == FIRST and cause.closed == pytest.approx(share, abs=0.02)
    assert cause.after == pytest.approx(1 + 30 * (1 - share), rel=0.02)
    assert found.probabilities[FIRST] >= 0.3 > found.probabilities.get("prnu", 0.0)
    assert found.refused is None


def test_what_imitates_an_effect_out_of_the_library_is_less_probable():
    """Rows pulse: grain takes up most of what they do to frequencies, and leaves the rows. The same grain is
    more probable where it is all there is."""
    imitated = {"film_grain": (1, 0, 0), "vignetting": (0, 0, 1)}
    likely = []
    for rows in (0.0, 3.2):
        evidence = toy.line(imitated, np.array([4.0, rows, 0.0]), axes=("frequency", "row", "radius"))
        start = evidence.at(toy.model(list(imitated)), np.zeros(3))
        found = found_of(evidence, start)
        likely.append(found.probabilities["film_grain"])
    assert likely[1] < likely[0]


def test_what_is_not_probable_is_not_named_and_is_told():
    evidence, start = toy.apart({FIRST: 0.9}, gap=30.0)
    case = toy.case(evidence, start)
    case = dataclasses.replace(case, criteria=dataclasses.replace(case.criteria, named=1.0))
    found = searched(case, case.gap(), quiet)
    assert found.causes == [] and found.point is start and found.after is found.before
    assert [t.effect for t in found.nearest] == [FIRST] and found.refused.point.error < start.error / 5


def test_a_cause_that_is_dropped_takes_none_of_those_after_it_along():
    """What comes after an improbable one is measured without it."""
    evidence, start = toy.apart({FIRST: 0.5, SECOND: 0.4}, gap=30.0)
    case = toy.case(evidence, start)
    gap = case.gap()
    terms = terms_of(case, gap)
    searched_for = search(evidence, start, case.offered, terms, quiet)
    assert [t.effect for t, _ in searched_for.causes] == [FIRST, SECOND]
    kept, at = named(case, searched_for, {FIRST: 0.2, SECOND: 0.9}, terms)
    assert [t.effect for t, _ in kept] == [SECOND]
    assert kept[0][0].before == pytest.approx(gap.before)
    assert kept[0][0].closed == pytest.approx(0.4, abs=0.02)
    on = {c.node for c, v in zip(start.model.coordinates, at.z) if abs(v) > 0.1}
    assert on == {SECOND}


def test_the_floor_is_that_of_the_end():
    """A picture with the effect is softer, and its file loses less: what is closed is a share of more."""
    evidence, start = toy.apart({FIRST: 0.6, "prnu": 0.0}, gap=30.0)

    def floor_at(point):
        at = 1.0 if point is start else 0.4
        return Floor(np.full(4, at), (at / 2, 2 * at))

    found = found_of(evidence, start, floor_at=floor_at)
    ((cause, _),) = found.causes
    assert (found.gap.floor, found.gap.floor_ci) == (0.4, (0.2, 0.8))
    share = cause.gain / (found.gap.before - 0.4)
    assert cause.closed == pytest.approx(share) and cause.closed < 0.6 < cause.gain / 30.0 + 1e-3
    assert cause.low < cause.closed < cause.high or cause.low == pytest.approx(cause.closed)
    assert found.trials[FIRST].closed == pytest.approx(share, rel=1e-3)
    assert found_of(*toy.apart({FIRST: 1.0}, gap=0.5)).gap is None


def test_a_gap_within_the_floor_has_no_cause():
    """Though an effect would close all of it."""
    evidence, start = toy.apart({FIRST: 1.0}, gap=0.5)
    found = found_of(evidence, start)
    assert found.causes == [] and found.point is start and found.predicted[FIRST] == pytest.approx(0.5, 0.01)


@pytest.mark.parametrize("there", [True, False])
def test_what_the_file_does_anyway_must_close_more_than_half_a_floor(there):
    evidence, start = toy.apart({"prnu": 0.5, "double_compression": 0.1}, gap=5.0)
    references = dict.fromkeys(start.model.indices(["double_compression"]), 0.0) if there else {}
    case = toy.case(dataclasses.replace(evidence, references=references), start, "raw+jpeg")
    bars = terms_of(case, Gap(6.0, 1.0)).bars
    assert bars == ({"double_compression": pytest.approx(0.5 / 5.0)} if there else {})


@pytest.mark.parametrize(("kind", "least"), [("raw+jpeg", 4.0), ("clean+noisy", 1.0)])
def test_what_is_harmless_is_no_smaller_where_a_file_is_not_compressed(kind, least):
    """A floor of rounding alone is no measure of it; that of a compressed file is."""

    def gap(before, floor):
        evidence = SimpleNamespace(units=lambda point: np.full((4, 1), before), split=toy.SPLIT)
        point = SimpleNamespace(model=SimpleNamespace(effects=()))
        return toy.case(evidence, point, kind, floors=np.full(4, floor)).gap()

    small, large = gap(0.45, 0.1), gap(15.0, 10.0)
    assert (small.before, small.floor, small.unit) == (pytest.approx(0.45), 0.1, max(0.1, least))
    assert small.exceeds(0.1) == (least == 1.0)
    assert large.unit == 10 and large.exceeds(0.5) and not large.exceeds(0.51)


def test_causes_are_measured_in_the_order_they_are_told_in():
    """The files show the small one, which so comes first; it is told second, with what it closes beside the
    large one, not with what both have in common."""
    evidence = toy.line(
        {"double_compression": (0.2, 0.98, 0), "prnu": (1, 0, 0)}, np.sqrt(10) * np.array([0.9, 0.435, 0])
    )
    start = evidence.at(toy.model(["double_compression", "prnu"]), np.zeros(3))
    found = found_of(evidence, start, named=0.0, seen=("double_compression",))
    (large, _), (small, _) = found.causes
    assert (large.effect, small.effect) == ("prnu", "double_compression")
    assert large.closed == pytest.approx(0.81, abs=0.01) and small.closed == pytest.approx(0.19, abs=0.01)
    assert large.after == pytest.approx(small.before) and small.after == pytest.approx(1.0, abs=0.02)


def test_what_would_close_next_to_nothing_in_the_order_told_stays_as_it_was_found():
    """Beside the large one the other closes a fiftieth: they are told as they were found, the larger
    first."""
    angle = np.arcsin(np.sqrt(0.03))
    evidence = toy.line(
        {"double_compression": (0.45, 0.893, 0), "prnu": (1, 0, 0)},
        np.sqrt(10) * np.array([np.cos(angle), np.sin(angle), 0]),
    )
    start = evidence.at(toy.model(["double_compression", "prnu"]), np.zeros(3))
    found = found_of(evidence, start, named=0.0, seen=("double_compression",))
    (large, _), (small, _) = found.causes
    assert (large.effect, large.closed) == ("prnu", pytest.approx(0.64, abs=0.02))
    assert (small.effect, small.closed) == ("double_compression", pytest.approx(0.36, abs=0.02))


def trial(effect, before, after):
    closed = (before - after) / 10
    return Trial(effect, np.zeros(1), before, after, closed, closed - 0.05, closed + 0.05, Bars(0.05))


def test_causes_come_by_what_they_close():
    small, large = trial("s", 11.0, 8.0), trial("l", 8.0, 3.0)  # 0.3, then 0.5
    assert by_closure([(small, ["a"])]) == [(small, ["a"])]
    (first, alike), (second, _) = by_closure([(small, ["a"]), (large, ["b"])])
    assert (first.before, first.after, alike) == (11.0, 6.0, ["b"]) and first.closed == large.closed
    assert (second.before, second.after) == (6.0, 3.0)
    assert by_closure([]) == []
