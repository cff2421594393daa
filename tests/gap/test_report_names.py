"""What axes, statistics and parameters are called on the page of a diagnosis."""

import re

import numpy as np
import pytest

from jaxisp.gap import EFFECTS
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.report.axes import ACROSS, PIXELS, STATISTICS, statistic, statistic_words
from jaxisp.gap.report.parameters import MEMBERS, parameters_of
from jaxisp.gap.report.plots import heat, heat_picture
from jaxisp.gap.report.words import words
from jaxisp.gap.simulator.model import plain_camera
from jaxisp.params import specs
from jaxisp.pipeline import signature
from jaxisp.stages import STAGES
from tests.gap.page import CAUSE, PICTURES, REPORT, STATISTIC, Balance, changed, shown


def test_statistics_have_names():
    known = statistic_words()
    assert set(feature_names()) <= set(known) and len(set(known.values())) == len(known)
    assert {name.split()[1] for name in feature_names()} <= set(STATISTICS) == set(PIXELS)
    assert statistic("intensity", "logvar Cb2") == "Cb noise at luma 60"
    assert statistic("intensity", "code dark04") == "RAW values in 44 even levels, in the dark"
    assert statistic("row", "something else") == "something else"


@pytest.mark.parametrize("chain", [plain_camera("RGGB")[0], Camera(None, gamma=2.0).chain()[0]])
def test_nodes_of_the_bases_have_names(chain):
    for name in chain.init().keys() - STAGES.keys() - EFFECTS.keys():
        if not name.startswith("use_"):
            assert words(name) != name.replace("_", " "), name
    text = shown(changed(base=REPORT["base"] | {"stages": ["to_raw", "file"], "fitted": {"mixing": {}}}))
    assert "<dd>white balance undone, the file's compression</dd>" in text.replace("&#39;", "'")
    assert "<dd>from the sensor's primaries</dd>" in text.replace("&#39;", "'")


def test_abbreviations_stay_in_capitals():
    alike = {"effect": "row_noise", "closed": 0.1, "status": "not_identifiable"}
    causes = [CAUSE | {"effect": "jpeg_quantization"}, CAUSE | {"effect": "prnu"}]
    text = shown(changed(causes=causes, ranking=[alike | {"reason": "looks the same as prnu"}]))
    assert "looks the same as PRNU" in text
    assert "<h3>JPEG quantization</h3>" in text and "<h3>PRNU</h3>" in text


def test_statistics_that_differ_most_are_drawn_about_a_middle():
    text = shown(changed(kind="clean+noisy", where=[STATISTIC]), {"name": "x"})
    Balance(text)
    assert "<svg" not in text
    assert "share of coarse Cb DCT coefficients near 0" in text and "step of luma into column 2 of 8" in text
    assert "traces of JPEG compression" in text and "2 more within ±0.5" in text
    assert "comb Cb0" not in text and "harmless or chance" not in text
    assert "&lt;b&gt;own&lt;/b&gt;" in text
    bars = re.findall(r"left:([\d.]+)%;width:([\d.]+)%", text.split("<h2>Where")[1].split("<h2>Which")[0])
    assert bars[:3] == [("0.0", "50.0"), ("50", "25.0"), ("50", "12.12")] and len(bars) == 6


def test_the_axes_of_pixels_say_what_they_run_over():
    text = shown(changed(where=[REPORT["where"][0] | {"channel": "Cb", "unit": "mean, steps"}]))
    assert "from the middle (0) to the corners (1)" in text
    assert ">distance from the middle [of that to a corner]<" in text and ">Cb, mean [8-bit steps]<" in text


def test_every_axis_that_is_plotted_has_a_name():
    assert set(ACROSS) >= set(PIXELS) - {"fixed_pattern"}


def test_the_heat_map_shows_where_the_difference_is():
    residual = np.zeros((24, 44, 3))
    residual[8:16, 16:24] = 3, 0, 4  # luma and Cr
    found = heat(residual)
    assert found.shape == (3, 5) and found[1, 2] == 5 and np.count_nonzero(found) == 1
    assert heat(residual[:4, :4]).shape == (1, 1)
    picture = heat_picture(found, 5.0)
    assert picture.shape == (24, 40, 3) and picture[8:16, 16:24].min() > 0.6 and picture[0, 0].max() < 0.05
    text = shown(REPORT, PICTURES | {"residual_before": residual})
    Balance(text)
    where = text.split("<h2>Where")[1].split("<h3>Along")[0]
    assert where.count("<img") == 3 and "linear-gradient" in where and "4.3 and more [8-bit steps]" in where
    assert "Along the axes" not in shown(REPORT, {"name": "x"})


@pytest.mark.parametrize("effect", [name for name, e in EFFECTS.items() if any(m.index for m in e.moves)])
def test_members_of_families_have_names(effect):
    declared = specs(signature(next(EFFECTS[effect].node.stages()).fn).params)
    for field in {m.field for m in EFFECTS[effect].moves if m.index}:
        assert len(set(MEMBERS[effect, field])) == np.size(declared[field].default)


def test_parameters_are_named_and_none_is_zero():
    shares = {f"shares[{i}]": v for i, v in enumerate((0.65, 0.0, -0.2, 0.01, 0.3))}
    line = "shares: Gaussian (1 px) 0.65, median 3x3 -0.2, bilateral (2 px, 0.05 of white) 0.3"
    assert parameters_of({"effect": "chroma_denoising", "params": shares}) == [line]
    assert line in shown(changed(causes=[CAUSE | {"effect": "chroma_denoising", "params": shares}]))
    matrix = {f"matrix[{i}][{j}]": float(i == j) for i in range(3) for j in range(3)} | {"matrix[0][1]": -0.4}
    assert parameters_of({"effect": "color_matrix", "params": matrix}) == ["matrix: red from green -0.4"]
    gains = {"gains[0]": 1.12, "gains[2]": 0.9}
    assert parameters_of({"effect": "white_balance", "params": gains}) == ["gains: red 1.12, blue 0.9"]
    table = {f"hue[{i}]": 0.1 * i for i in range(10)}
    assert parameters_of({"effect": "color_lut", "params": table})[0].endswith("202° 0.9 rad; 3 smaller")
    assert parameters_of(CAUSE) == ["a2 -0.412 EV (coefficient of r**2; negative darkens the corners)"]
    own = {"effect": "of a user's", "params": {"amounts[1]": 0.5, "form": "round"}}
    assert parameters_of(own) == ["amounts: [1] 0.5", "form round"]
