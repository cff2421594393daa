"""The experiment that asks whether intervals hold on fresh scenes."""

import numpy as np
import pytest

from experiments.fresh_scenes import drop, groups, page, pictures
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.simulator.model import Variant
from tests.gap import toy


def test_fresh_scenes_are_neither_fitted_nor_held_out():
    found = groups(3)
    assert [s.fit for s in found] == [(0, 2, 4)] * 3 and found[0].held_out == (1, 3, 5)
    assert sorted(i for s in found for i in s.held_out) == [1, 3, 5, 6, 7, 8, 9, 10, 11]
    names = sorted(pictures("one", 64, 3))  # as a folder is read
    assert len(names) == 12 and [n[0] for n in names] == ["0"] * 6 + ["1"] * 6


@pytest.mark.parametrize("choice", [None, Variant({"variant": np.float32(1)}, {})])
def test_what_is_closed_is_counted_as_the_diagnosis_does(choice):
    """The demosaicker beside the effect takes away 1 by itself, which is not the effect's."""
    evidence = toy.line({"vignetting": (1, 0)}, (np.sqrt(6.0), 1.0), beside=(0, 1))
    start = evidence.at(toy.model(["vignetting"]), np.zeros(2))
    bars = Bars(0.0)
    trial = Trial("vignetting", np.array([0, np.sqrt(6.0)]), 14, 8, 0.5, 0.4, 0.6, bars, choice)
    assert drop(toy.case(evidence, start), trial) == (pytest.approx(6.0), pytest.approx(7.0))


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
