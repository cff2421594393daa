"""Effects are added one after the other, and taken back where others make up for them."""

import types

import numpy as np
import pytest

from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search import stepwise
from jaxisp.gap.search.refit import Trial, Whole
from jaxisp.gap.search.stepwise import Terms, search


class Problem:
    model = rival = None

    def __init__(self):
        self.z = np.zeros(1)

    def move_to(self, z):
        self.z = z


def searched(monkeypatch, closes, terms, beside=("prnu",)):
    """What is accepted of effects that close these shares of a gap of 10, (half width of their interval)."""
    asked = []

    def refit(problem, name, split, whole, least, form=None, plainly=np.inf, rest=1.0):
        asked.append(least)
        assert rest == pytest.approx(1 - float(problem.z[0]) / 10)
        share, half = closes[name]
        before = 11.0 - float(problem.z[0])
        return Trial(
            name,
            problem.z + 10 * share,
            before,
            before - 10 * share,
            share,
            share - half,
            share + half,
            least,
        )

    monkeypatch.setattr(stepwise, "screen", lambda problem, names, split: {n: closes[n][0] for n in names})
    monkeypatch.setattr(stepwise, "foretold", lambda problem, name, split: closes[name][0])
    monkeypatch.setattr(stepwise, "refit", refit)
    monkeypatch.setattr(stepwise, "_needed", lambda *a: a[2])
    monkeypatch.setattr(stepwise, "hidden", lambda problem, names, least: [])
    whole = Whole(10.0, np.ones((1, 1)))
    closes = closes | dict.fromkeys(beside, (0.0, 0.0))
    found = search(Problem(), list(closes), Split((0,), (1,)), whole, terms, lambda *tick: None)
    return [t.effect for t, _ in found.causes], asked


def test_a_second_effect_is_measured_by_what_the_first_leaves(monkeypatch):
    closes = {"chroma_denoising": (0.8, 0.05), "vignetting": (0.15, 0.04)}
    terms = Terms(0.05, 3, part=0.15)
    assert searched(monkeypatch, closes, terms)[0] == list(closes)
    names, asked = searched(monkeypatch, closes, terms._replace(part=0.6))  # 0.12 of the gap
    assert names == ["chroma_denoising"] and asked[-1] == pytest.approx(0.12)
    assert searched(monkeypatch, closes, terms._replace(enough=0.25))[0] == ["chroma_denoising"]


def test_a_lookalike_of_a_cause_is_asked_for_more_than_its_form_may_cost(monkeypatch):
    closes = {"luma_denoising": (0.8, 0.05), "sharpening": (0.15, 0.04)}
    names, asked = searched(monkeypatch, closes, Terms(0.05, 3))
    assert names == ["luma_denoising"] and max(asked) == pytest.approx(0.16)


def test_an_effect_that_imitates_others_has_a_bar_of_its_own(monkeypatch):
    closes = {"saturation": (0.8, 0.05), "double_compression": (0.17, 0.08)}
    terms = Terms(0.07, 3, plainly=0.05)
    assert searched(monkeypatch, closes, terms)[0] == list(closes)
    terms = terms._replace(bars={"double_compression": 0.3})
    names, asked = searched(monkeypatch, closes, terms)
    assert names == ["saturation"] and 0.3 in asked and 0.07 in asked


def test_the_two_best_of_a_later_step_are_fitted_anew_from_both_bases(monkeypatch):
    """What leaves the least on the fitted pairs stays, wherever it began; of the others as it was."""
    first, begun = np.array([0.0, 0.0]), []
    model = types.SimpleNamespace(base_indices=[0])
    problem = types.SimpleNamespace(model=model)
    shares = {"vignetting": 0.1, "chroma_subsampling": 0.3, "sharpening": 0.2, "optical_blur": 0.05}

    def trial(name, z, error, closed, farther=0.0):
        return Trial(
            name, np.array(z), 11.0, 11 - 10 * closed, closed, closed, closed, 0.05,
            farther=farther, plainly=0.02, error=error, rest=0.4,
        )  # fmt: skip

    def refit(problem, name, split, whole, least, begin, plainly, rest):
        begun.append((name, *begin))
        assert (least, plainly, rest) == (0.05, 0.02, 0.4)
        better = (name, begin[0]) == ("vignetting", 0.0)
        return trial(name, begin, 2.0 if better else 4.0, shares[name] + 0.1)

    monkeypatch.setattr(stepwise, "refit", refit)
    trials = [trial(name, [0.7, 1.0], 3.0, closed) for name, closed in shares.items()]
    trials[0] = trial("vignetting", [0.7, 1.0], 3.0, 0.1, farther=-0.2)
    found = stepwise._again(problem, first, trials, Split((0,), (1,)), None)
    assert sorted(begun) == [(n, b, 1.0) for n in ("chroma_subsampling", "vignetting") for b in (0.0, 0.7)]
    assert found[0].closed == pytest.approx(0.2) and found[1:] == trials[1:]
    begun.clear()
    stepwise._again(problem, first, trials[1:], Split((0,), (1,)), None)
    assert {name for name, *_ in begun} == {"chroma_subsampling", "sharpening"}
    assert stepwise._again(problem, first, [], Split((0,), (1,)), None) == []


def test_nothing_to_try_finds_nothing(monkeypatch):
    monkeypatch.setattr(stepwise, "screen", lambda problem, names, split: {n: 1.0 for n in names})
    whole = Whole(10.0, np.ones((1, 1)))
    monkeypatch.setattr(stepwise, "hidden", lambda problem, names, least: [])
    found = search(Problem(), [], Split((0,), (1,)), whole, Terms(0.05, 3), lambda *tick: None)
    assert found == ([], {}, {}, [])


def test_all_that_is_tried_may_be_found(monkeypatch):
    closes = {"chroma_denoising": (0.5, 0.05)}
    assert searched(monkeypatch, closes, Terms(0.05, 3), beside=())[0] == ["chroma_denoising"]


def test_beside_grain_less_can_lead(monkeypatch):
    closes = {"green_imbalance": (0.12, 0.04)}
    assert searched(monkeypatch, closes, Terms(0.05, 3))[0] == []
    assert searched(monkeypatch, closes, Terms(0.05, 3, leading=0.1))[0] == ["green_imbalance"]


class Imitating(Problem):
    """A base that leaves 11, and 13 beside its rival."""

    rival = "linear values"
    model = types.SimpleNamespace(base_indices=[])

    def __init__(self):
        super().__init__()
        self.has = "square roots"

    def choose(self, choice):
        self.has = choice

    def take(self, which):
        return self

    def errors(self, z):
        return np.full(2, 13.0 if self.has == self.rival else 11.0)


def test_what_the_base_imitates_is_looked_for_beside_its_rival(monkeypatch):
    """Beside it a chroma filter takes away 9 of 13, which is 7 of 11; where roots imitate it nothing."""
    names = ("chroma_denoising", "vignetting")
    drops = {"square roots": dict(zip(names, (-20.0, 0.5))), "linear values": dict(zip(names, (9.0, 0.4)))}

    def refit(problem, name, split, whole, least, form=None, plainly=np.inf, rest=1.0):
        closed = {"chroma_denoising": 0.7, "vignetting": 0.05}[name]
        return Trial(name, problem.z, 11.0, 11.0 - 10 * closed, closed, closed, closed, least)

    monkeypatch.setattr(stepwise, "screen", lambda problem, names, split: drops[problem.has])
    monkeypatch.setattr(stepwise, "foretold", lambda problem, name, split: drops[problem.has][name] - 0.25)
    monkeypatch.setattr(stepwise, "refit", refit)
    monkeypatch.setattr(stepwise, "fit", lambda *arguments, **options: None)
    problem, whole = Imitating(), Whole(10.0, np.ones((1, 1)))
    terms = Terms(0.05, 3, enough=1.0)
    monkeypatch.setattr(stepwise, "hidden", lambda problem, names, least: [])
    causes, _, promised, _ = search(problem, names, Split((0,), (1,)), whole, terms, lambda *tick: None)
    assert [trial.effect for trial, _ in causes] == ["chroma_denoising"] and problem.has == "square roots"
    assert promised == pytest.approx({"chroma_denoising": 6.75, "vignetting": 0.25})


NAMES = ("chroma_denoising", "chroma_subsampling", "vignetting")


class Fitted:
    """A gap of 10 above a floor of 1; each effect has a coordinate, which is 1 where it is on."""

    def __init__(self, closes):
        self.z, self.closes = np.zeros(len(NAMES)), closes
        moves = {name: [k] for k, name in enumerate(NAMES)}
        self.model = types.SimpleNamespace(
            effects=moves, indices=lambda names: [moves[name][0] for name in names], still=lambda z: z
        )

    def gap(self, z):
        return 11 - 10 * self.closes[tuple(name for name, v in zip(NAMES, z) if v)]

    def move_to(self, z):
        self.z = z.copy()

    def take(self, which):
        return self

    def distances(self, z):
        return None if self.near is None else np.full(2, 10.0 - 3 * z[NAMES.index(self.near)])


def needed(monkeypatch, closes, names, least=0.05, seen=(), near=None):
    """What is left of effects that close these shares together, and where each fit began; `near` brings
    pixels nearer."""
    problem, begun = Fitted(closes), []
    problem.near = near

    def fitted(problem, name, begin, rest):
        assert rest == pytest.approx((problem.gap(problem.z) - 1) / 10), "what the others leave"
        z = problem.z.copy()
        z[NAMES.index(name)] = 1
        begun.append(None if begin is None else begin.tolist())
        before, after = problem.gap(problem.z), problem.gap(z)
        closed = (before - after) / 10
        return Trial(name, z, before, after, closed, closed - 0.01, closed + 0.01, least)

    monkeypatch.setattr(
        stepwise, "refit", lambda problem, name, *a, begin, rest: fitted(problem, name, begin, rest)
    )
    start, trials = (problem.model, problem.z), []
    for name in names:
        trials.append(fitted(problem, name, None, (problem.gap(problem.z) - 1) / 10))
        problem.move_to(trials[-1].z)
    begun.clear()
    whole = Whole(10.0, np.ones((1, 1)))
    found = stepwise._needed(problem, start, trials, Split((0,), (1,)), whole, Terms(least, 3, seen=seen))
    return [(t.effect, round(t.closed, 6)) for t in found], begun


def test_what_a_later_effect_makes_up_for_is_taken_back(monkeypatch):
    first, second, _ = NAMES
    closes = {(): 0.0, (first,): 0.5, (second,): 0.93, (first, second): 0.95}
    found, begun = needed(monkeypatch, closes, [first, second])
    assert found == [(second, 0.93)] and begun == [[0, 1, 0]]  # from where both ended
    assert len(needed(monkeypatch, closes, [first, second], seen=[first])[0]) == 2  # the files show it
    assert len(needed(monkeypatch, closes, [first, second], near=first)[0]) == 2  # pixels do
    assert len(needed(monkeypatch, closes, [first, second], near=second)[0]) == 1


def test_what_nothing_else_makes_up_for_stays(monkeypatch):
    first, second, _ = NAMES
    closes = {(): 0.0, (first,): 0.5, (second,): 0.6, (first, second): 0.95}
    assert needed(monkeypatch, closes, [first, second])[0] == [(first, 0.5), (second, 0.45)]
    assert needed(monkeypatch, closes, [first, second], least=0.4)[0] == [(second, 0.6)]


def test_of_three_two_may_be_left_or_one(monkeypatch):
    first, second, third = NAMES
    closes = {
        (): 0.0, (first,): 0.5, (second,): 0.6, (third,): 0.3,
        (first, second): 0.7, (first, third): 0.8, (second, third): 0.94, NAMES: 0.95,
    }  # fmt: skip
    assert needed(monkeypatch, closes, NAMES)[0] == [(second, 0.6), (third, 0.34)]
    closes[(third,)] = 0.92
    assert needed(monkeypatch, closes, NAMES)[0] == [(third, 0.92)]
