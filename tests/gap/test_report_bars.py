"""Bars, marks and pictures on the page of a diagnosis: to scale, and with what is said beside them."""

import base64
import copy
import io
import re

import numpy as np
import pytest
from PIL import Image

from jaxisp.gap.report.page import html
from jaxisp.gap.report.plots import gain_for
from tests.gap.page import PICTURES, REPORT, STATISTIC, Balance, changed, shown


@pytest.mark.parametrize("size, gain", [(0, 32), (3.9, 32), (4.1, 16), (20, 4), (100, 1), (250, 1)])
def test_differences_fill_the_range_but_do_not_leave_it(size, gain):
    luma = np.zeros((40, 50, 3))
    luma[..., 0] = size
    luma[0, 0, 0] = 255  # a few pixels may
    assert gain_for([luma, 0 * luma]) == gain
    text = shown(REPORT, PICTURES | {"residual_before": luma, "residual_after": 0 * luma})
    assert f"difference before, ×{gain} about grey" in text and f"difference after, ×{gain} about" in text
    picture = Image.open(io.BytesIO(base64.b64decode(re.findall(r"base64,([^\"]+)", text)[3])))
    assert picture.getpixel((9, 9))[0] == pytest.approx(min(127.5 + gain * size, 255), abs=0.6)


def test_bars_are_to_scale():
    page = html(REPORT, PICTURES)
    widths = [float(w) for w in re.findall(r'class="bar [a-z_]+" style="width:([\d.]+)%', page)]
    before, after, floor, *ranking = widths
    assert after / before == pytest.approx(4.2 / 17.6, abs=1e-3) and floor / before == pytest.approx(
        1 / 17.6, abs=1e-3
    )
    assert ranking == [81.2, 31, 10, 0]


def test_what_was_predicted_stands_beside_what_was_realised():
    ranking = copy.deepcopy(REPORT["ranking"])
    ranking[0] |= {"predicted": 1.6, "ci": [0.7, 0.9]}  # the longest: all bars are a share of it
    ranking[1] |= {"predicted": -0.3}
    text = shown(changed(ranking=ranking))
    Balance(text)
    marks = re.findall(r'class="mark" style="left:([\d.]+)%"', text)
    assert list(map(float, marks)) == [100, 0], "only of what was refitted"
    assert "predicted 160 %" in text and "predicted nothing" in text and "predicted 10 %" not in text
    assert 'style="width:50.75%' in text
    plain = shown(REPORT)
    assert 'class="mark' not in plain and "what was predicted before" not in plain


def test_why_a_candidate_was_not_tried_is_said():
    ranking = copy.deepcopy(REPORT["ranking"])
    ranking[1] |= {"status": "not_identifiable", "reason": "looks the same as <i>chroma_denoising</i>"}
    ranking[3] |= {"reason": "the file's header states it"}
    text = shown(changed(ranking=ranking))
    assert (
        "looks the same as &lt;i&gt;chroma denoising&lt;/i&gt;" in text
        and "the file&#39;s header states it" in text
    )
    assert "taken up by the base fit" not in text and "cannot be told apart" not in text


def test_what_grows_the_gap_is_said_in_words_and_how_the_base_moved():
    ranking = copy.deepcopy(REPORT["ranking"])
    ranking[1] |= {"closed": -2.2, "ci": [-3.0, -1.0]}
    text = shown(changed(ranking=ranking))
    assert '<span class="value">the gap grows' in text and "-220" not in text
    assert "<dt>moved by what was found</dt><dd>tone curve 10 %</dd>" in text


def test_no_axis_is_said_to_stand_out_that_does_not():
    usual = [row | {"p_value": 0.18} for row in REPORT["where"]]
    text = shown(changed(where=usual))
    assert "On no axis is it more than what cameras that lack nothing have." in text
    assert "It shows most by" not in text and "Nothing stands out on any axis." in text
    assert "It shows most by radius." in shown(REPORT)


def test_what_a_flexible_model_reaches_is_a_bar():
    found = {"best": 2.2, "explained": 0.93, "how": "a free curve and filter"}
    text = shown(changed(gap=REPORT["gap"] | {"reducible": found}))
    assert re.findall(r'<span class="name">(\w+(?: of ours)?)</span>', text)[:4] == [
        "before",
        "after",
        "lowest of ours",
        "floor",
    ]
    widths = [float(w) for w in re.findall(r'class="bar [a-z_ ]+" style="width:([\d.]+)%', text)]
    assert widths[2] / widths[0] == pytest.approx(2.2 / 17.6, abs=1e-3)
    said = (
        "Of the most that any model of ours reduces (lowest: a free curve and filter), the named effects are"
    )
    assert f"{said} 93 %." in text
    unnamed = found | {"explained": None}
    for other in (changed(gap=REPORT["gap"] | {"reducible": unnamed}), changed(causes=[], verdict="unknown")):
        other["gap"]["reducible"] = unnamed
        assert "The lowest that any model of ours reaches is 2.2 (a free curve and filter)." in shown(other)
    worse = shown(changed(gap=REPORT["gap"] | {"reducible": found | {"best": 4.2, "explained": 1.0}}))
    assert "No flexible model of ours gets lower." in worse and ">lowest of ours<" not in worse
    for absent in ({}, {"reducible": None}):
        assert "flexible" not in shown(changed(gap=REPORT["gap"] | absent))


@pytest.mark.parametrize("kind", ["raw+jpeg", "clean+noisy"])
def test_the_interval_of_an_axis_is_shown(kind):
    axis = STATISTIC if kind == "clean+noisy" else REPORT["where"][0] | {"share": 0.6}
    text = shown(changed(kind=kind, where=[axis | {"ci": [0.45, 0.72]}]))
    Balance(text)
    assert "60 % [45, 72]" in text
    assert 'style="width:60.0%"></span><span class="range" style="left:45.0%;width:27.0%"' in text
    for absent in ({}, {"ci": None}, {"ci": [None, 0.7]}):
        plain = shown(changed(kind=kind, where=[axis | absent]))
        assert "60 % (p" in plain and 'class="share"' not in plain
