"""What stands in one place of all pictures is told from what it does to other statistics."""

import numpy as np
import pytest

from jaxisp.gap.noisy_units import axis_of, weights
from jaxisp.gap.noisy_where import credited, in_one_place, located
from jaxisp.gap.statistics import feature_names

SIDE, SCENES = 96, [f"scene{k}" for k in range(6)]
AXIS = np.array([axis_of(name) for name in feature_names()])


@pytest.fixture
def noise(rng):
    return rng.normal(0, 3, (len(SCENES), SIDE, SIDE, 3))


def stamped(noise, size=20.0):
    drawn = noise.copy()
    drawn[:, 70:73, 40:80, 1] -= size
    return drawn


def test_a_stamp_is_found_and_chance_is_not(noise):
    assert not in_one_place(noise, SCENES).any()
    found = in_one_place(stamped(noise), SCENES)
    assert found[70:73, 40:80].all() and found.sum() == 5 * 40 + 2 * 3  # and its neighbours
    assert not found[:, :39].any() and not found[:69].any()


def test_what_one_scene_shows_or_is_smooth_or_is_everywhere_is_no_such_thing(noise, rng):
    edges = noise.copy()
    edges[2, 30:50, 30:50] += 40
    assert not in_one_place(edges, SCENES).any()
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE - 0.5
    assert not in_one_place(noise - 30 * (y**2 + x**2)[..., None], SCENES).any()
    assert not in_one_place(noise + 9 * rng.standard_normal((SIDE, SIDE, 1)), SCENES).any()


def test_scenes_are_counted_not_frames(noise):
    assert not in_one_place(stamped(noise), 3 * ["one", "other"]).any()
    assert in_one_place(stamped(noise), 2 * ["one", "other", "third"]).any()


def test_what_vanishes_with_the_place_is_the_place_s():
    """Tails that are all the stamp's are, rows are not, and what the tails have of their own is not."""
    size = 20 * np.isin(AXIS, ("tail", "row")) + 5.0 * (AXIS == "fixed_pattern") + 1.0
    difference, weight = size * np.sqrt(weights()), weights()
    without = np.where(AXIS == "tail", 0.5, 0.2) * difference
    rows = located(difference, weight)
    share = {row["axis"]: row["share"] for row in rows}
    assert "frame" not in share, "no scene has several"
    assert np.concatenate([row["weights"] for row in rows]).mean() == pytest.approx(1)
    found = credited(rows, difference, without, weight)
    now = {row["axis"]: row["share"] for row in found}
    before, after = ((own**2 - weight)[AXIS == "tail"].sum() for own in (difference, without))
    kept = after / before
    assert now["tail"] == pytest.approx(kept * share["tail"])
    assert now["fixed_pattern"] == pytest.approx(share["fixed_pattern"] + (1 - kept) * share["tail"])
    p_value = {row["axis"]: row["p_value"] for row in found}
    assert p_value["fixed_pattern"] == min(
        row["p_value"] for row in rows if row["axis"] in ("tail", "fixed_pattern")
    )
    assert now["row"] == share["row"] and sum(now.values()) == pytest.approx(sum(share.values()))
    assert [row["share"] for row in found] == sorted(now.values(), reverse=True)
