"""Axes are held against cameras that lack nothing."""

import numpy as np
import pytest

from experiments.null_bank import BEYOND, LEAST, bank_of, beyond, left_out
from jaxisp.gap.axes import null_bank
from jaxisp.gap.axes.null_bank import as_large, bank, held_against_nulls
from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.simulator.effects import AXES, CLEAN_NOISY, RAW_JPEG

GAP = Gap(before=12.0, floor=2.0)


def cameras(rng, count, axes=("row", "hue", "edge")):
    """Sizes that are each axis's own, and go together."""
    common = rng.lognormal(0, 0.3, count)
    return [{a: k * c * rng.lognormal(0, 0.5) for k, a in enumerate(axes, 1)} for c in common]


def test_the_bank_that_is_shipped():
    for kind in (RAW_JPEG, CLEAN_NOISY):
        own = bank()[kind]
        assert set(own["usual"]) == set(AXES), "cameras with several frames among them"
        assert all(size >= LEAST for size in own["usual"].values())
        assert len(own["largest"]) >= 100 and own["largest"] == sorted(own["largest"])
        assert as_large(np.inf, own["largest"]) <= CRITERIA[RAW_JPEG].clear < as_large(1.0, own["largest"])


def test_usual_is_a_quantile_and_the_largest_is_over_axes(rng):
    nulls = cameras(rng, 200)
    found = bank_of(nulls)
    for axis, usual in found["usual"].items():
        assert usual == pytest.approx(np.percentile([s[axis] for s in nulls], BEYOND), abs=1e-4)
    assert max(found["largest"]) == pytest.approx(
        max(s[a] / found["usual"][a] for s in nulls for a in s), rel=1e-2
    )
    assert bank_of([{"row": 0.0}] * 3)["usual"] == {"row": LEAST}
    some = [{"row": 0.0}] * 30 + [{"row": 0.0, "frame": 3.0}]
    assert bank_of(some)["usual"]["frame"] == 3.0, "of those that could show it"


def test_one_camera_in_twenty_is_beyond_whatever_axes_there_are(rng):
    nulls, others = cameras(rng, 100), cameras(rng, 2000)
    assert 0.02 < np.mean([bool(beyond(bank_of(nulls), s)) for s in others]) < 0.08
    named, count = left_out({str(k): nulls[k::4] for k in range(4)})
    assert count == 100 and named <= 12
    strange = {"one": nulls, "other": [{a: 10 * s for a, s in own.items()} for own in nulls]}
    assert left_out(strange)[0] > 90, "a body unlike the others"


def test_p_value_is_the_larger_of_two(monkeypatch):
    monkeypatch.setattr(null_bank, "bank", lambda: {RAW_JPEG: {"usual": {"row": 0.5}, "largest": [0.5] * 99}})
    rows = [
        {"axis": "row", "share": 0.2, "p_value": 0.002},
        {"axis": "frame", "share": 0.1, "p_value": 0.003},
    ]
    row, frame = held_against_nulls(rows, RAW_JPEG, 12.0, GAP.unit)
    assert row["size"] == pytest.approx(0.2 * 12 / 2) and row["usual"] == 0.5
    assert row["p_value"] == pytest.approx(0.01)
    assert frame["p_value"] == 0.003 and frame["usual"] is None, "no camera of the bank has it"
    by_chance = held_against_nulls([rows[0] | {"p_value": 0.3}], RAW_JPEG, 12.0, GAP.unit)
    assert by_chance[0]["p_value"] == 0.3
    small = held_against_nulls([rows[0] | {"share": 0.001}], RAW_JPEG, 12.0, GAP.unit)
    assert small[0]["p_value"] == 1.0, "beyond chance, but usual"


def test_statistics_are_in_units_already(monkeypatch):
    monkeypatch.setattr(null_bank, "bank", lambda: {CLEAN_NOISY: {"usual": {"row": 2.0}, "largest": [1.0]}})
    rows = [{"axis": "row", "share": 0.2, "size": 3.0, "p_value": 0.1}]
    assert held_against_nulls(rows, CLEAN_NOISY, 12.0, GAP.unit)[0]["size"] == 3.0
    assert held_against_nulls(rows, CLEAN_NOISY, 12.0, GAP.unit)[0]["p_value"] == 0.5
