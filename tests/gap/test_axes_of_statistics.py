"""What stands in one place of all pictures is told from what it does to other statistics."""

import functools

import numpy as np
import pytest

from jaxisp.gap.axes.statistics import in_one_place, located, reattributed
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.features.tolerances import axis_of, present, weights

SIDE, SCENES = 96, [f"scene{k}" for k in range(6)]


@functools.cache
def axes():
    """(F,) the axis of each statistic; naming them traces all of them."""
    return np.array([axis_of(name) for name in feature_names()])


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
    size = 20 * np.isin(axes(), ("tail", "row")) + 5.0 * (axes() == "fixed_pattern") + 1.0
    difference, weight = size * np.sqrt(weights()), weights()
    without = np.where(axes() == "tail", 0.5, 0.2) * difference
    rows = located(difference, weight, difference[None], ["one"])
    share = {row["axis"]: row["share"] for row in rows}
    assert "frame" not in share, "no scene has several"
    assert np.concatenate([row["weights"] for row in rows]).mean() == pytest.approx(1)
    found = reattributed(rows, difference, without, weight, (difference[None], without[None]), ["one"])
    now = {row["axis"]: row["share"] for row in found}
    before, after = ((own**2 - weight)[axes() == "tail"].sum() for own in (difference, without))
    kept = after / before
    assert now["tail"] == pytest.approx(kept * share["tail"])
    assert now["fixed_pattern"] == pytest.approx(share["fixed_pattern"] + (1 - kept) * share["tail"])
    p_value = {row["axis"]: row["p_value"] for row in found}
    assert p_value["fixed_pattern"] == min(
        row["p_value"] for row in rows if row["axis"] in ("tail", "fixed_pattern")
    )
    assert now["row"] == share["row"] and sum(now.values()) == pytest.approx(sum(share.values()))
    assert [row["share"] for row in found] == sorted(now.values(), reverse=True)


def by_scene(sizes, axis="row"):
    """(N, F) differences in units, as large as these on one axis, and 1.5 on all others."""
    return np.where(axis == axes(), np.reshape(sizes, (-1, 1)), 1.5) * np.sqrt(weights())


def spread_of(apart, names, axis="row"):
    row = next(r for r in located(apart.mean(0), weights(), apart, names) if r["axis"] == axis)
    assert 0 <= row["ci"][0] <= row["share"] <= row["ci"][1] <= 1
    return row["ci"][1] - row["ci"][0]


def test_interval_is_of_the_scenes():
    names = ["a", "b", "c", "d"]
    assert spread_of(by_scene([3, 3, 3, 3]), names) == pytest.approx(0, abs=1e-9)
    like, unlike = spread_of(by_scene([3.2, 2.8, 3.1, 2.9]), names), spread_of(by_scene([12, 0, 0, 0]), names)
    assert 0 < like < 0.15 < 0.4 < unlike
    frames = [12, 12, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    assert spread_of(by_scene(frames), [*"aaabbbcccddd"]) == pytest.approx(unlike)
    assert spread_of(by_scene(frames), [*"abcdefghijkl"]) < 0.8 * unlike
    for apart, scenes in ((by_scene([3]), ["a"]), (by_scene([3, 2]), ["a", "a"])):
        assert all(row["ci"] is None for row in located(apart.mean(0), weights(), apart, scenes))


def test_chance_of_scenes_is_not_an_axis(rng):
    """Where all that scenes differ in is chance, as large as the units say, no axis has the whole for sure,
    nor more in draws than in all."""
    counted = present(weights())
    apart = by_scene([4] * 8) + np.sqrt(8 * weights()) * counted * rng.normal(size=(8, len(axes())))
    for row in located(apart.mean(0), weights(), apart, [*"abcdefgh"]):
        low, high = row["ci"]
        assert high - low < 0.35 and low <= row["share"] <= high


def test_interval_moves_with_what_is_credited():
    sizes, names = [6, 3, 6, 3], ["a", "b", "c", "d"]
    apart = by_scene(sizes, "tail")
    without = np.where(axes() == "tail", 0, apart)
    args = apart.mean(0), without.mean(0), weights()
    rows = located(args[0], weights(), apart, names)
    before = {row["axis"]: row for row in rows}
    after = {row["axis"]: row for row in reattributed(rows, *args, (apart, without), names)}
    assert after["tail"]["share"] == pytest.approx(0, abs=1e-9)
    assert after["tail"]["ci"] == pytest.approx([0, 0], abs=1e-9)
    low, high = after["fixed_pattern"]["ci"]
    assert low < after["fixed_pattern"]["share"] < high
    assert low > before["fixed_pattern"]["ci"][1] and after["row"]["ci"] == before["row"]["ci"]
    one = reattributed(rows, *args, (apart, without), 4 * ["a"])
    assert all(row["ci"] is None for row in one)
