"""The rows of the ranking."""

import numpy as np

from jaxisp.gap.refit import Trial
from jaxisp.gap.rows import ranking_rows


def test_a_line_promises_the_whole_at_most_and_a_step_what_was_measured():
    tried = Trial("sharpening", np.zeros(1), 11.0, -1.0, 1.2, 1.1, 1.3, 0.05)
    promises = {"sharpening": 11.5, "prnu": 25.0, "vignetting": -1.0}
    rows = ranking_rows([], {"sharpening": tried}, promises, {"tone_curve": 0.0}, 10.0)
    assert {row["effect"]: row.get("predicted") for row in rows} == {
        "sharpening": 1.15, "prnu": 1.0, "vignetting": -0.1, "tone_curve": None,
    }  # fmt: skip
    assert {row["effect"]: row["closed"] for row in rows} == {
        "sharpening": 1.2, "prnu": 1.0, "vignetting": -0.1, "tone_curve": 0.0,
    }  # fmt: skip
    assert [row["status"] for row in rows] == ["rejected"] * 3 + ["absorbed"]
