"""The rows of the ranking."""

import numpy as np

from jaxisp.gap.account import Shown
from jaxisp.gap.refit import Trial
from jaxisp.gap.rows import HIDDEN, NO_HEADER, STATED, TAKEN_UP, ranking_rows
from jaxisp.gap.verdict import Found


def found(promises, trials=None, causes=(), hidden=()):
    return Found(list(causes), trials or {}, promises, Shown(1.0, []), Shown(1.0, []), hidden=hidden)


def test_a_line_promises_the_whole_at_most_and_a_step_what_was_measured():
    tried = Trial("sharpening", np.zeros(1), 11.0, -1.0, 1.2, 1.1, 1.3, 0.05)
    promises = {"sharpening": 11.5, "prnu": 25.0, "vignetting": -1.0}
    rows = ranking_rows(found(promises, {"sharpening": tried}), {"tone_curve": TAKEN_UP}, 10.0)
    assert {row["effect"]: row.get("predicted") for row in rows} == {
        "sharpening": 1.15, "prnu": 1.0, "vignetting": -0.1, "tone_curve": None,
    }  # fmt: skip
    assert {row["effect"]: row["closed"] for row in rows} == {
        "sharpening": 1.2, "prnu": 1.0, "vignetting": -0.1, "tone_curve": 0.0,
    }  # fmt: skip
    assert [row["status"] for row in rows] == ["rejected", "rejected", "absorbed", "rejected"]


def test_what_was_not_named_says_why():
    cause = Trial("color_matrix", np.zeros(1), 11.0, 1.0, 1.0, 0.9, 1.1, 0.05)
    promises = dict.fromkeys(("color_matrix", "saturation", "color_lut", "prnu"), 0.5)
    apart = {"tone_curve": TAKEN_UP, "jpeg_quantization": STATED, "prnu": STATED}
    rows = ranking_rows(
        found(promises, {}, [(cause, ["saturation"])], ["color_lut", "saturation"]), apart, 10.0
    )
    assert {row["effect"]: (row["status"], row.get("reason")) for row in rows} == {
        "color_matrix": ("accepted", None),
        "saturation": ("not_identifiable", "looks the same as color_matrix"),
        "color_lut": ("not_identifiable", HIDDEN),
        "prnu": ("rejected", None),  # it was tried
        "tone_curve": ("absorbed", TAKEN_UP),
        "jpeg_quantization": ("absorbed", STATED),
    }


def test_what_pixels_tell_from_the_cause_says_so():
    """It closes as much of the statistics, and pictures are not as near: no cause, no alternative."""
    near, far = (Trial(name, np.zeros(1), 11.0, 1.0, 1.0, 0.9, 1.1, 0.05, farther=by)
                 for name, by in (("optical_blur", -0.5), ("luma_denoising", 0.0)))  # fmt: skip
    promises = dict.fromkeys(("optical_blur", "luma_denoising"), 0.5)
    apart = {"double_compression": NO_HEADER}
    rows = ranking_rows(found(promises, {"luma_denoising": far}, [(near, [])]), apart, 10.0)
    assert {row["effect"]: (row["status"], row.get("reason")) for row in rows} == {
        "optical_blur": ("accepted", None),
        "luma_denoising": ("rejected", "takes pixels less near than optical_blur"),
        "double_compression": ("not_identifiable", NO_HEADER),
    }
