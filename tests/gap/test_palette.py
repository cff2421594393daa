"""Grey scenes say nothing of a colour matrix: a usual one stands in the base, and is not fitted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.withheld.scenes import GREY, scenes
from experiments.withheld.shoot import write
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base.palette import TYPICAL, is_colourless, typical_matrix
from jaxisp.gap.report.record import ABSORBED, NO_COLOURS


def taken(name: str, colours: float = 1.0, noise: float = 0.0) -> np.ndarray:
    """(4, 128, 128, 3) of a set, with this share of its colours."""
    light = np.stack(list(scenes(name, 128, 4).values()))
    light = light.mean(-1, keepdims=True) * (1 - colours) + light * colours
    return light + np.random.default_rng(0).normal(0, noise, light.shape)


SEEN = np.ones((4, 128, 128), bool)


@pytest.mark.parametrize("name", ["one", "two", "three", GREY])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_only_grey_scenes_are_colourless_whatever_their_noise(name, noise):
    assert is_colourless(taken(name, noise=noise), SEEN) == (name == GREY)


def test_a_twentieth_of_usual_colours_is_enough():
    assert not is_colourless(taken("two", 0.05), SEEN) and is_colourless(taken("two", 0.002), SEEN)


def test_one_colour_is_more_than_none():
    tint = np.array([0.2, 0.0, -0.2]) * taken(GREY)[..., ::-1, :]
    assert not is_colourless(taken(GREY) + tint, SEEN)


def test_what_does_not_count_has_no_colour():
    light, mask = taken(GREY), SEEN.copy()
    light[:, :64] = taken("two")[:, :64]
    assert not is_colourless(light, mask)
    mask[:, :64] = False
    assert is_colourless(light, mask) and not is_colourless(light, ~SEEN)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0.2, 4), min_size=3, max_size=3), st.floats(0, 1))
def test_a_typical_matrix_takes_white_to_its_gains(gains, share):
    matrix = typical_matrix(np.array(gains), share)
    np.testing.assert_allclose(matrix @ np.ones(3), gains, rtol=1e-12)
    np.testing.assert_allclose(matrix / np.array(gains)[:, None], np.eye(3) + share * TYPICAL)


def reported(folder: Path, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the diagnosis says of these scenes, and of the colour matrix in its ranking."""
    write(folder, "fig", {}, scenes=name, size=128, count=6)
    report = diagnose(folder, exclude=list(EFFECTS)).report
    return report, next(row for row in report["ranking"] if row["effect"] == "color_matrix")


def test_beside_grey_scenes_the_matrix_is_a_usual_one_and_nothing_is_missing(tmp_path):
    """Fitted, it imitated what compression takes of the noise in their colours: 2.2 floors, "unknown"."""
    report, row = reported(tmp_path, GREY)
    assert row["reason"] == NO_COLOURS and row["status"] == "not_identifiable"
    matrix = np.array(report["base"]["fitted"]["color_matrix"]["matrix"])
    np.testing.assert_allclose(matrix, typical_matrix(matrix.sum(1)), rtol=1e-5)
    assert "color_matrix" not in report["base"]["absorbed"]
    assert np.ptp(matrix.sum(1)) < 0.02 * matrix.sum(1).mean(), "white stays"
    assert report["verdict"] == "none"


@pytest.mark.slow
@pytest.mark.optimised
def test_beside_coloured_scenes_the_matrix_is_fitted(tmp_path):
    report, row = reported(tmp_path, "two")
    assert row["reason"] == ABSORBED and "color_matrix" in report["base"]["absorbed"]
    assert report["verdict"] == "none"
