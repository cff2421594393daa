"""The journal of a fit: kept where it is whole, begun anew for another fit, left alone where it is none."""

import dataclasses

import numpy as np
import pytest

from jaxisp.fit.journal import Journal, beside, in_the_way
from jaxisp.fit.state import State


def state(rng):
    return State(rng.normal(size=5), (rng.normal(size=3),), (rng.normal(size=2),), done=2)


def equal(one, other):
    return all(np.array_equal(a, b) for a, b in zip(dataclasses.astuple(one), dataclasses.astuple(other)))


def test_what_is_put_is_there_again(tmp_path, rng):
    path, kept = beside(tmp_path / "camera.toml"), state(rng)
    Journal.open(path, "a fit").put("first", kept, False)
    again = Journal.open(path, "a fit")
    found, finished = again.get("first")
    assert again.resumed and equal(found, kept) and not finished
    other = Journal.open(path, "another fit")
    assert not other.resumed and other.get("first") == (None, False)
    other.put("second", kept, True)
    assert not Journal.open(path, "a fit").resumed and Journal.open(path, "another fit").get("second")[1]


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, "notes", '{"print": "a fit", "jobs": {"first": 3}}', "\0"]
)
def test_what_is_no_journal_is_told_and_left_as_it_is(tmp_path, rng, text):
    path = beside(tmp_path / "camera.toml")
    path.write_text(text)
    assert in_the_way(path).startswith(f"{path}: ") and "left as it is" in in_the_way(path)
    journal = Journal.open(path, "a fit")
    journal.put("first", state(rng), False)
    assert not journal.resumed and journal.get("first")[0] is not None and path.read_text() == text


def test_no_bit_of_it_may_change(tmp_path, rng):
    path = beside(tmp_path / "camera.toml")
    Journal.open(path, "a fit").put("first", state(rng), False)
    whole = path.read_bytes()
    for place in rng.choice(8 * len(whole), 200, replace=False):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(data)
        assert in_the_way(path) and not Journal.open(path, "a fit").resumed
