from types import SimpleNamespace

import numpy as np
import pytest

from jaxisp.gap.case import Case, Gap
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search import verdict
from jaxisp.gap.search.account import Shown
from jaxisp.gap.search.refit import Trial, Whole
from jaxisp.gap.search.stepwise import Searched
from jaxisp.gap.search.verdict import by_closure, gap_at, searched


def trial(effect, z, before, after, choice=None):
    closed = (before - after) / 10
    return Trial(effect, np.array([z]), before, after, closed, closed - 0.05, closed + 0.05, 0.05, choice)


class Model:
    effects = ("prnu", "double_compression")

    def __init__(self, *choices):
        self.choices = choices

    def indices(self, names):
        return [self.effects.index(name) for name in names]

    def chosen(self, choice):
        return Model(*self.choices, choice)


class Problem:
    def __init__(self):
        self.model, self.z, self.references = Model(), np.zeros(1), {}

    def move_to(self, z):
        self.z = z


STEPS = [(trial("first", 1.0, 11.0, 4.0, "other"), ["alike"]), (trial("second", 2.0, 4.0, 2.0), [])]


@pytest.mark.parametrize("holding", [0, 1, 2])
def test_as_many_causes_are_kept_as_account_for_the_gap(monkeypatch, holding):
    """A last step that only looks like a cause takes none of those before it along."""

    def account(kind, names, before, after, gap, left):
        assert (gap, before.error) == (Gap(11.0, 1.0), 0.0)
        assert left == {1.0: 4.0, 2.0: 2.0}[after.error]  # what is left where the problem stands
        assert names == ["first", "second"][: int(after.error)]
        return after.error <= holding

    monkeypatch.setattr(verdict, "search", lambda problem, *rest: Searched(STEPS, {}, {}, []))
    monkeypatch.setattr(verdict, "shown", lambda problem, held: Shown(float(problem.z[0]), []))
    monkeypatch.setattr(verdict, "whole_of", lambda case, size: Whole(size, np.ones((1, 1))))
    monkeypatch.setattr(verdict, "accounted", account)
    problem = Problem()
    case = Case("clean+noisy", problem, Split((0,), (1,)), np.ones(2), {}, [])
    found = searched(case, Gap(11.0, 1.0), lambda *tick: None)
    assert [t.effect for t, _ in found.causes] == ["first", "second"][:holding]
    assert problem.z == holding and problem.model.choices == (("other",) if holding else ())
    assert (found.before.error, found.after.error) == (0, holding)
    assert (found.refused is None) == (holding > 0)  # else what all of them would close
    if found.refused is not None:
        near = found.refused
        assert ([t.effect for t, _ in near.causes], near.after.error) == (["first", "second"], 2.0)
        assert (near.model.choices, near.z) == (("other",), 2.0)


def test_a_gap_within_the_floor_has_no_cause(monkeypatch):
    monkeypatch.setattr(verdict, "search", lambda problem, *rest: Searched(STEPS, {}, {}, []))
    monkeypatch.setattr(verdict, "shown", lambda problem, held: Shown(0.0, []))
    monkeypatch.setattr(verdict, "whole_of", lambda case, size: SimpleNamespace())
    case = Case("clean+noisy", Problem(), Split((0,), (1,)), np.ones(2), {}, [])
    assert searched(case, Gap(1.5, 1.0), lambda *tick: None).causes == []


@pytest.mark.parametrize(("references", "bars"), [({}, {}), ({1: 92.0}, {"double_compression": 0.1})])
def test_what_the_file_does_anyway_must_close_more_than_half_a_floor(monkeypatch, references, bars):
    asked = []
    monkeypatch.setattr(verdict, "search", lambda *given: asked.append(given[4]) or Searched([], {}, {}, []))
    monkeypatch.setattr(verdict, "shown", lambda problem, held: Shown(0.0, []))
    monkeypatch.setattr(verdict, "whole_of", lambda case, size: SimpleNamespace())
    case = Case("raw+jpeg", Problem(), Split((0,), (1,)), np.ones(2), {}, [])
    case.problem.references = references
    searched(case, Gap(60.0, 10.0), lambda *tick: None)
    assert asked[0].bars == bars


@pytest.mark.parametrize(("kind", "least"), [("raw+jpeg", 4.0), ("clean+noisy", 0.0)])
def test_what_is_harmless_is_no_smaller_where_a_file_is_not_compressed(kind, least):
    """A floor of rounding alone is no measure of it; that of a compressed file is."""

    def gap(before, floor):
        problem = SimpleNamespace(z=None, units=lambda z: np.full((2, 1), before))
        return gap_at(Case(kind, problem, Split((0,), (1,)), np.full(2, floor), {}, []))

    small, large = gap(0.45, 0.1), gap(15.0, 10.0)
    assert (small.before, small.floor, small.unit) == (0.45, 0.1, max(0.1, least))
    assert small.exceeds(0.1) == (least == 0)
    assert large.unit == 10 and large.exceeds(0.5) and not large.exceeds(0.51)


FOUND = [(trial("small", 1.0, 11.0, 8.0), ["a"]), (trial("large", 2.0, 8.0, 3.0), ["b"])]  # 0.3, then 0.5


@pytest.mark.parametrize(("gaps", "measured"), [
    ((5.0, 3.1), True), ((5.0, 3.6), False), ((8.0, 3.0), False), ((3.2, 3.1), False),
])  # fmt: skip
def test_causes_are_measured_in_the_order_they_are_told_in(monkeypatch, gaps, measured):
    """The larger first, with what it closes alone; not where it would close less then, leave more than nulls'
    chance, or make up for the other."""
    again = [trial("large", 3.0, 11.0, gaps[0]), trial("small", 4.0, *gaps)]

    def replayed(problem, start, names, end, split, whole, least):
        assert (start, names, end) == ("start", ["large", "small"], [2.0])
        problem.move_to(again[-1].z)
        return again

    monkeypatch.setattr(verdict, "replayed", replayed)
    monkeypatch.setattr(verdict, "shown", lambda problem, held: Shown(float(problem.z[0]), []))
    problem, whole = Problem(), Whole(10.0, np.ones((1, 1)))
    problem.move_to(np.array([2.0]))
    case = Case("clean+noisy", problem, Split((0,), (1,)), np.ones(2), {}, [])
    causes, after = verdict._as_added(case, "start", FOUND, Shown(2.0, []), whole, 0.05)
    (first, alike), (second, _) = causes
    assert (first.effect, alike, second.effect) == ("large", ["b"], "small")
    assert (first.before, first.after) == (11.0, gaps[0] if measured else 6.0)
    assert (second.before, second.after) == (first.after, gaps[1] if measured else 3.0)
    assert problem.z == after.error == (4.0 if measured else 2.0)


def test_what_was_found_in_order_is_not_fitted_again(monkeypatch):
    monkeypatch.setattr(verdict, "replayed", None)
    grain = [FOUND[0], (trial("film_grain", 0.0, 8.0, 3.0), [])]
    for causes in (STEPS, grain, FOUND[:1]):
        case = SimpleNamespace(stored=0.0)
        found, after = verdict._as_added(case, None, causes, "after", None, 0.05)
        assert found == by_closure(causes) and after == "after"


def test_causes_come_by_what_they_close():
    small, large = trial("s", 0.0, 11.0, 8.0), trial("l", 0.0, 8.0, 3.0)  # 0.3, then 0.5
    assert by_closure([(small, ["a"])]) == [(small, ["a"])]
    (first, alike), (second, _) = by_closure([(small, ["a"]), (large, ["b"])])
    assert (first.before, first.after, alike) == (11.0, 6.0, ["b"]) and first.closed == large.closed
    assert (second.before, second.after) == (6.0, 3.0)
    assert by_closure([]) == []
