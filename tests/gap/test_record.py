"""The rows of the ranking."""

import numpy as np
import pytest

from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.report.record import (
    ABSORBED,
    FARTHER,
    HIDDEN,
    IMPROBABLE,
    NO_COLOURS,
    NO_GAP,
    NO_HEADER,
    NO_MORE,
    NOT_SURE,
    STATED,
    ranking_rows,
)
from jaxisp.gap.search.states import Shown
from jaxisp.gap.search.trial import Bars, Trial
from jaxisp.gap.search.verdict import Found

RAW = CRITERIA["raw+jpeg"]


def found(promises, trials=None, causes=(), hidden=()):
    return Found(list(causes), None, trials or {}, promises, Shown(1.0, []), Shown(1.0, []), hidden=hidden)


def test_a_line_promises_the_whole_at_most_and_a_step_what_was_measured():
    tried = Trial("sharpening", np.zeros(1), 11.0, -1.0, 1.2, 1.1, 1.3, Bars(0.05))
    promises = {"sharpening": 11.5, "prnu": 25.0, "vignetting": -1.0}
    rows = ranking_rows(found(promises, {"sharpening": tried}), {"tone_curve": ABSORBED}, 10.0, RAW)
    assert {row["effect"]: row.get("predicted") for row in rows} == {
        "sharpening": 1.15, "prnu": 1.0, "vignetting": -0.1, "tone_curve": None,
    }  # fmt: skip
    assert {row["effect"]: row["closed"] for row in rows} == {
        "sharpening": 1.2, "prnu": 1.0, "vignetting": -0.1, "tone_curve": 0.0,
    }  # fmt: skip
    assert [row["status"] for row in rows] == ["rejected", "rejected", "absorbed", "rejected"]


def test_what_was_not_named_says_why():
    cause = Trial("color_matrix", np.zeros(1), 11.0, 1.0, 1.0, 0.9, 1.1, Bars(0.05))
    promises = dict.fromkeys(("color_matrix", "saturation", "color_lut", "prnu"), 0.5)
    apart = {"tone_curve": ABSORBED, "jpeg_quantization": STATED, "prnu": STATED}
    rows = ranking_rows(
        found(promises, {}, [(cause, ["saturation"])], ["color_lut", "saturation"]), apart, 10.0, RAW
    )
    assert {row["effect"]: (row["status"], row.get("reason")) for row in rows} == {
        "color_matrix": ("accepted", None),
        "saturation": ("not_identifiable", "looks the same as color_matrix"),
        "color_lut": ("not_identifiable", HIDDEN),
        "prnu": ("rejected", None),  # it was tried
        "tone_curve": ("absorbed", ABSORBED),
        "jpeg_quantization": ("absorbed", STATED),
    }


def test_without_colours_nothing_is_said_of_what_changes_them_alone():
    promises = dict.fromkeys(("saturation", "crosstalk", "vignetting"), 0.5)
    rows = ranking_rows(found(promises), {"color_matrix": NO_COLOURS}, 10.0, RAW)
    assert {row["effect"]: (row["status"], row.get("reason")) for row in rows} == {
        "saturation": ("not_identifiable", NO_COLOURS),
        "color_matrix": ("not_identifiable", NO_COLOURS),
        "crosstalk": ("rejected", None),  # it blurs, too
        "vignetting": ("rejected", None),
    }


def test_what_pixels_tell_from_the_cause_says_so():
    """It closes as much of the statistics, and pictures are not as near: no cause, no alternative."""
    near, far = (Trial(name, np.zeros(1), 11.0, 1.0, 1.0, 0.9, 1.1, 0.05, farther=by)
                 for name, by in (("optical_blur", -0.5), ("luma_denoising", 0.0)))  # fmt: skip
    promises = dict.fromkeys(("optical_blur", "luma_denoising"), 0.5)
    apart = {"double_compression": NO_HEADER}
    rows = ranking_rows(found(promises, {"luma_denoising": far}, [(near, [])]), apart, 10.0, RAW)
    assert {row["effect"]: (row["status"], row.get("reason")) for row in rows} == {
        "optical_blur": ("accepted", None),
        "luma_denoising": ("rejected", "takes pixels less near than optical_blur"),
        "double_compression": ("not_identifiable", NO_HEADER),
    }


@pytest.mark.parametrize(
    "changed, said",
    [
        ({}, IMPROBABLE),
        ({"low": 0.09}, NO_MORE),
        ({"surely": 0.02}, NOT_SURE),
        ({"farther": 0.3}, FARTHER),
        ({"low": 0.04}, None),
    ],
)
def test_an_effect_that_is_no_cause_though_its_interval_is_high_says_why(changed, said):
    usual = {"before": 11.0, "after": 5.0, "closed": 0.6, "low": 0.5, "high": 0.7, "bars": Bars(0.1)}
    tried = Trial("sharpening", np.zeros(1), **usual | changed)
    (row,) = ranking_rows(found({"sharpening": 5.0}, {"sharpening": tried}), {}, 10.0, RAW)
    assert row["status"] == "rejected" and row.get("reason") == said
    beside = Trial("prnu", np.zeros(1), 11.0, 2.0, 0.9, 0.8, 1.0, Bars(0.1))
    rows = ranking_rows(found({"sharpening": 5.0}, {"sharpening": tried}, [(beside, [])]), {}, 10.0, RAW)
    told = "closes too little beside prnu" if said == IMPROBABLE else said
    assert rows[0].get("reason") == told


def test_the_likeliest_come_first():
    """Causes keep the order of what they close; without a probability, what would be closed decides."""
    small, large = (
        Trial(name, np.zeros(1), 11.0, 8.0, closed, closed / 2, 2 * closed, Bars(0.05))
        for name, closed in (("sharpening", 0.1), ("prnu", 0.6))
    )
    likely = {"sharpening": 0.6, "prnu": 0.2}
    at = found({"sharpening": 1.0, "prnu": 6.0, "vignetting": 3.0, "crosstalk": 4.0},
               {"sharpening": small, "prnu": large})  # fmt: skip
    at = at._replace(probabilities=likely, signs={name: {"size": 1.0} for name in likely}, accepted=["prnu"])
    rows = ranking_rows(at, {}, 10.0, RAW)
    assert [row["effect"] for row in rows] == ["sharpening", "prnu", "crosstalk", "vignetting"]
    assert [row.get("probability") for row in rows] == [0.6, 0.2, None, None]
    assert [row.get("searched") for row in rows] == [False, True, None, None]


def test_where_there_is_no_gap_nothing_closes_it():
    tried = Trial("sharpening", np.zeros(1), 1.01, 1.0, 1.0, 0.9, 1.1, Bars(0.05))
    at = found({"sharpening": 0.01, "prnu": 0.02}, {"sharpening": tried})
    rows = ranking_rows(at, {}, 0.01, RAW, False)
    assert [(row["closed"], row["status"], row["reason"]) for row in rows] == [(0.0, "rejected", NO_GAP)] * 2
