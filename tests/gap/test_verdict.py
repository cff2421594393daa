"""How many of the causes found account for the gap, and in which order they are told: by the search itself,
on evidence that is linear in a few numbers."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from jaxisp.gap.case import Gap
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.search.verdict import by_closure, searched, terms_of
from tests.gap import toy


def quiet(done, total, text):
    pass


def found_of(evidence, start, **more):
    case = toy.case(evidence, start, **more)
    return searched(case, case.gap(), quiet)


FIRST, SECOND = "chroma_denoising", "vignetting"


@pytest.mark.parametrize(("holding", "far"), [(2, (50, 25, 20)), (1, (50, 25, 28)), (0, (50, 40, 38))])
def test_as_many_causes_are_kept_as_account_for_the_gap(holding, far):
    """Edges are elsewhere: where they stay so, a cause only looks like one; a last step that spoils them
    takes none of those before it along."""

    def distance(on):
        return far[len(on)] if FIRST in on or not on else far[0]

    evidence, start = toy.apart({FIRST: 0.7, SECOND: 0.29, "prnu": 0.0}, distance=distance)
    found = found_of(evidence, start)
    assert [t.effect for t, _ in found.causes] == [FIRST, SECOND][:holding]
    on = {c.node for c, v in zip(start.model.coordinates, found.point.z) if abs(v) > 0.1}
    assert on == {FIRST, SECOND} & {t.effect for t, _ in found.causes}
    assert (found.before.distance, found.after.distance) == (50, far[holding])
    assert (found.refused is None) == (holding > 0)
    if found.refused is not None:  # what all of them would close
        assert [t.effect for t, _ in found.refused.causes] == [FIRST, SECOND]
        assert found.refused.after.distance == far[2] and found.refused.point.error < start.error / 5


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


@pytest.mark.parametrize(("kind", "least"), [("raw+jpeg", 4.0), ("clean+noisy", 0.0)])
def test_what_is_harmless_is_no_smaller_where_a_file_is_not_compressed(kind, least):
    """A floor of rounding alone is no measure of it; that of a compressed file is."""

    def gap(before, floor):
        evidence = SimpleNamespace(units=lambda point: np.full((4, 1), before), split=toy.SPLIT)
        point = SimpleNamespace(model=SimpleNamespace(effects=()))
        return toy.case(evidence, point, kind, floors=np.full(4, floor)).gap()

    small, large = gap(0.45, 0.1), gap(15.0, 10.0)
    assert (small.before, small.floor, small.unit) == (pytest.approx(0.45), 0.1, max(0.1, least))
    assert small.exceeds(0.1) == (least == 0)
    assert large.unit == 10 and large.exceeds(0.5) and not large.exceeds(0.51)


def test_causes_are_measured_in_the_order_they_are_told_in():
    """The files show the small one, which so comes first; it is told second, with what it closes beside the
    large one, not with what both have in common."""
    evidence = toy.line(
        {"double_compression": (0.2, 0.98, 0), "prnu": (1, 0, 0)}, np.sqrt(10) * np.array([0.9, 0.435, 0])
    )
    start = evidence.at(toy.model(["double_compression", "prnu"]), np.zeros(3))
    found = found_of(evidence, start, seen=("double_compression",))
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
    found = found_of(evidence, start, seen=("double_compression",))
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
