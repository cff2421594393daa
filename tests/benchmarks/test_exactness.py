"""The table of exactness: how rows are judged and shown."""

import itertools
import json
import math

import numpy as np
import pytest

from benchmarks import exactness, report
from benchmarks.exact import noise
from benchmarks.exact.row import Row, largest


@pytest.mark.parametrize(
    "worst, at_least, passed",
    [
        (0.1, False, True),
        (0.2, False, False),
        (0.2, True, True),
        (0.05, True, False),
        (math.nan, True, False),
    ],
)
def test_rows_are_judged(worst, at_least, passed):
    assert Row("s", "r", "ran", worst, 0.1, at_least=at_least).passed is passed


def test_largest_difference_keeps_nan():
    assert largest(np.float32([0.5, 2]), [0.5, 1]) == 1
    assert math.isnan(largest([0, math.nan], [0, 0]))


def test_a_family_that_breaks_off_fails(monkeypatch):
    monkeypatch.setattr(exactness.importlib, "import_module", lambda name: 1 / 0)
    (row,) = exactness.run("jpeg")
    assert not row.passed and "ZeroDivisionError" in row.ran


def test_noise_has_its_moments_on_four_cfas():
    for row in itertools.islice(noise.rows(), 3):
        assert row.passed and row.unit == "z", row


def test_page(tmp_path):
    bad = Row("bad", "lib 1", "c", 40.0, 45.0, "dB", at_least=True)
    rows = [Row("good", "lib 1", "a|b", 1e-7, 1e-6), bad]
    machine = {"processor": "P", "backend": "cpu", "versions": {"jax": "1"}}
    results, page = tmp_path / "e.json", tmp_path / "e.md"
    results.write_text(json.dumps({"machine": machine, "rows": [exactness.as_json(row) for row in rows]}))
    report.write_exactness(page, results)
    text = page.read_text()
    assert "1 of 2 rows pass" in text
    assert "| good | lib 1 | a\\|b | 1e-07 | <= 1e-06 | pass |" in text
    assert "| bad | lib 1 | c | 40 dB | >= 45 dB | **FAIL** |" in text
