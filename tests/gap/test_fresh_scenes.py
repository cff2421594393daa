"""The experiment that asks whether intervals hold on fresh scenes."""

import numpy as np
import pytest

from experiments.fresh_scenes import drop, groups, page, pictures
from jaxisp.gap.case import Case
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.refit import Trial


def test_fresh_scenes_are_neither_fitted_nor_held_out():
    found = groups(3)
    assert [s.fit for s in found] == [(0, 2, 4)] * 3 and found[0].held_out == (1, 3, 5)
    assert sorted(i for s in found for i in s.held_out) == [1, 3, 5, 6, 7, 8, 9, 10, 11]
    names = sorted(pictures("one", 64, 3))  # as a folder is read
    assert len(names) == 12 and [n[0] for n in names] == ["0"] * 6 + ["1"] * 6


class Model:
    chosen_too = False

    def chosen(self, choice):
        other = Model()
        other.chosen_too = True
        return other


class Problem:
    """The gap of scene i is 10 + i; the effect takes away 6, the demosaicker beside it 1 alone."""

    def __init__(self):
        self.model, self.z = Model(), np.zeros(1)

    def units(self, z):
        left = 10.0 + np.arange(6)[:, None]
        return left - 6 * (z[0] > 0) - 1.0 * self.model.chosen_too


@pytest.mark.parametrize(("choice", "lost"), [(None, 6.0), ("another demosaicker", 6.0)])
def test_what_is_closed_is_counted_as_the_diagnosis_does(choice, lost):
    case = Case("clean+noisy", Problem(), Split((0, 1, 2), (3, 4, 5)), np.ones(6), {}, [])
    model = case.problem.model
    trial = Trial("vignetting", np.ones(1), 14, 8, 0.5, 0.4, 0.6, 0.0, choice)
    assert drop(case, trial) == (pytest.approx(lost), pytest.approx(13.0))
    assert case.problem.model is model


def test_the_page_counts_what_is_inside():
    record = {"kind": "clean+noisy", "body": "alder", "effect": "vignetting", "strength": 4, "right": True}
    record |= {"closed": 0.8, "ci": [0.7, 0.9]}
    found = {
        "a": record | {"fresh": 0.75, "inside": True},
        "b": record | {"fresh": 0.6, "inside": False},
        "c": {k: v for k, v in record.items() if k not in ("closed", "ci")},  # found beside another
        "d": record | {"right": False},
    }
    text = page(found)
    assert "4 cases, the right effect first in 3." in text and "in 1 of the 2 found at once: 50%" in text
    assert text.count("(outside)") == 1
