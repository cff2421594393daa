"""The page of a diagnosis: what it says, that it is whole, escaped and asks for nothing."""

import base64
import copy
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from jaxisp.cli.diagnose import _print, _warn
from jaxisp.errors import InputError
from jaxisp.gap import EFFECTS, Diagnosis
from jaxisp.gap.report import few_pairs, html, sentence, unexplained, write_report
from jaxisp.gap.report_axes import PIXELS, STATISTICS, statistic, statistic_words
from jaxisp.gap.report_params import MEMBERS, parameters_of
from jaxisp.gap.report_plots import gain_for
from jaxisp.gap.spectra import spreads
from jaxisp.gap.statistics import feature_names
from jaxisp.params import specs
from jaxisp.pipeline import signature

CAUSE = {
    "effect": "vignetting",
    "site": "scene",
    "gap_before": 17.6,
    "gap_after": 4.2,
    "closed": 0.812,
    "ci": [0.76, 0.853],
    "alternatives": [],
    "next_measurement": None,
    "p_value": 1e-9,
    "params": {"a2": -0.41234},
}
REPORT = {
    "schema": 1,
    "kind": "raw+jpeg",
    "base": {"stages": ["demosaicking"], "fitted": {"tone_curve": {}}, "absorbed": {"white_balance": 0.94}},
    "pairs": {
        "fit": ["a"],
        "held_out": ["<script>alert(1)</script>"],
        "aligned": [
            {"name": "a", "shift_px": [2.0, -1.0], "scale": [1.0, 1.0], "done": "moved", "certain": True},
            {"name": "b", "shift_px": [0.0, 0.0], "scale": [1.0, 1.0], "done": "nothing", "certain": False},
        ],
        "left_out": [],
        "failed": [],
    },
    "gap": {
        "metric": "mean square, squared steps",
        "before": 17.6,
        "after": 4.2,
        "floor": 1.0,
        "ci": [3.5, 5.0],
    },
    "verdict": "effect",
    "causes": [CAUSE],
    "ranking": [
        {"effect": "vignetting", "closed": 0.812, "status": "accepted", "ci": [0.7, 0.9]},
        {
            "effect": "color_shading",
            "closed": 0.31,
            "status": "rejected",
            "ci": [0.2, 0.4],
            "possible": False,
        },
        {"effect": "sharpening", "closed": 0.1, "status": "rejected", "predicted": 0.1},
        {"effect": "white_balance", "closed": -0.02, "status": "absorbed"},
    ],
    "where": [
        {"axis": "radius", "share": 0.7, "p_value": 0.005, "bins": [0.1, 0.2], "profile": [0.0, -3.0]},
        {"axis": "cfa_phase", "share": 0.2, "p_value": 0.005, "bins": ["0,0", "<b>"], "profile": [1.0, -1.0]},
        {"axis": "row", "share": 0.1, "p_value": 0.005, "bins": list(range(99)), "profile": [0.5] * 99},
        {"axis": "tail", "share": 0.01, "p_value": 0.6, "bins": [], "profile": []},
    ],
    "unexplained": {"share": 0.19, "axes": ["edge"], "description": "19 % of the gap is left, on edge"},
    "seconds": 61.7,
}
GREY = np.full((40, 60, 3), 0.5)
NOISE = np.random.default_rng(0).normal(size=(2, 32, 32, 3))
PICTURES = {
    "name": "<i>one</i>",
    "target": GREY,
    "before": GREY,
    "after": GREY,
    "residual_before": np.zeros((24, 44, 3)),
    "residual_after": np.zeros((24, 44, 3)),
    **{f"spread_{whose}": spreads(NOISE, np.ones(NOISE.shape[:3])) for whose in ("before", "after", "floor")},
}


class Balance(HTMLParser):
    """Fails where a tag is closed that is not open."""

    VOID = ("meta", "link", "img", "rect", "line", "polyline", "path", "circle")

    def __init__(self, text):
        super().__init__()
        self.open, self.pictures = [], 0
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.pictures += tag == "img"
        assert tag != "script"
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


STATISTIC = {
    "axis": "block_phase",
    "share": 0.6,
    "p_value": 0.001,
    "bins": ["comb Cb0", "logvar columns2", "<b>own</b>", *(f"logvar rows{k}" for k in range(5))],
    "profile": [-16.5, 4.0, 8.25, *[0.5] * 5],
    "unit": "what is harmless or chance",
}


def changed(**more):
    return copy.deepcopy(REPORT) | more


def shown(report, pictures=PICTURES):
    return html(report, pictures).replace("\N{NO-BREAK SPACE}", " ")


def test_files(tmp_path):
    page = write_report(REPORT, PICTURES, tmp_path / "new")
    assert page == tmp_path / "new" / "report.html"
    assert json.loads((tmp_path / "new" / "report.json").read_text()) == REPORT
    assert sorted(p.name for p in page.parent.iterdir()) == ["report.html", "report.json"]
    text = page.read_text()
    assert Balance(text).pictures == 5
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "url(" not in text and "@import" not in text
    assert (
        "<script>alert" not in text
        and "<i>one" not in text
        and "<b>" not in re.sub(r"<b>[A-Za-z, ]+</b>", "", text)
    )
    uris = re.findall(r"base64,([^\"]+)", text)
    difference = Image.open(io.BytesIO(base64.b64decode(uris[3])))
    assert difference.size == (44, 24) and difference.getpixel((0, 0)) == (128, 128, 128)


def test_numbers_of_numpy_become_json(tmp_path):
    report = changed(seconds=np.float32(3.0))
    report["gap"]["ci"] = np.array([np.nan, 5.0])
    write_report(report, {"name": "x"}, tmp_path)
    found = json.loads((tmp_path / "report.json").read_text())
    assert found["gap"]["ci"] == [None, 5.0] and found["seconds"] == 3.0


def test_more_than_the_gap_is_all_of_it():
    report = changed(unexplained={"share": 0.0, "axes": [], "description": ""})
    report["causes"][0] |= {"closed": 1.23, "ci": [0.93, 1.56], "alternatives": []}
    said = sentence(report).replace("\N{NO-BREAK SPACE}", " ")
    assert said == (
        "The simulator lacks vignetting: it closes all of the gap (123 % [93, 156]) on held-out pairs."
    )


def test_what_it_says():
    text = html(REPORT, PICTURES).replace("\N{NO-BREAK SPACE}", " ")
    first = "The simulator lacks vignetting: it closes 81 % [76, 85] of the gap on held-out pairs."
    assert f"<h1>{first} 19 % of the gap stays unexplained.</h1>" in text
    assert "from 17.6 to 4.2; the floor is 1." in text
    told = '<span class="status small">takes pixels farther away</span></span>'
    refused = told + '\n<span class="value">31 % [20, 40]'
    assert refused in text and text.count("takes pixels farther away") == 1
    assert "white balance 94 %" in text and "taken up by the base fit" in text and "62 s" in text
    assert "19 % of the gap is left. It shows by edge." in text
    assert (
        text.count("<svg") == 3 + 4 and "noise tails 1 %" in text
    )  # an axis that is not clear is listed, not drawn


@pytest.mark.parametrize(
    "verdict, words", [("none", "No gap beyond the floor"), ("unknown", "no effect of the library")]
)
def test_without_causes(verdict, words):
    report = changed(verdict=verdict, causes=[], where=[] if verdict == "none" else REPORT["where"])
    page = html(report, {"name": "x", "target": GREY, "before": GREY, "after": None})
    assert words in sentence(report) and words in page
    assert Balance(page).pictures == 2
    assert ">after<" not in page


def test_group_and_next_measurement():
    alike = CAUSE | {"alternatives": ["color_shading"], "next_measurement": "a flat field"}
    second = CAUSE | {"effect": "prnu", "closed": 0.1, "ci": [0.06, 0.13]}
    text = html(changed(causes=[alike, second]), PICTURES).replace("\N{NO-BREAK SPACE}", " ")
    assert "lacks 2 effects, which close 91 %" in text
    assert "vignetting or colour shading (81 % [76, 85]); PRNU (10 % [6, 13])" in text
    assert "To tell vignetting from colour shading: a flat field." in text


def test_what_is_left_is_said_where_it_is_considerable():
    little = changed(unexplained={"share": 0.1, "axes": [], "description": ""})
    assert unexplained(little) == "" and sentence(little).endswith("on held-out pairs.")
    none = changed(verdict="none", causes=[], where=[])  # a share of a gap that is within the floor's range
    assert unexplained(none) == "" and "of the gap is left" not in shown(none)
    names = changed(unexplained={"share": 0.64, "axes": ["block_phase", "edge", "lag"], "description": ""})
    text = shown(names)
    assert "64 % of the gap is left. It shows by 8x8 block phase, edge and noise correlation." in text
    assert "block_phase" not in text


def test_what_was_refused_as_the_cause_is_said():
    near = {"effects": ["sharpening", "prnu"], "closed": 0.53, "axes": ["edge", "lag"]}
    left = {"share": 1.0, "axes": ["edge"], "description": "100 % of the gap is left, on edge"}
    unknown = {"verdict": "unknown", "causes": []}
    start = "There is a gap, and no effect of the library explains it."
    assert sentence(changed(**unknown, unexplained=left)) == start
    told = sentence(changed(**unknown, unexplained=left | {"nearest": near})).replace(
        "\N{NO-BREAK SPACE}", " "
    )
    assert (
        told == f"{start} Nearest: sharpening and PRNU, to close 53 % and leave edge and noise correlation."
    )
    assert "Nearest: sharpening" in shown(changed(**unknown, unexplained=left | {"nearest": near}))


@pytest.mark.parametrize(
    ("kind", "verdict", "pixels", "told"),
    [
        ("clean+noisy", "unknown", 75_264, True),
        ("clean+noisy", "unknown", 460_800, False),
        ("clean+noisy", "effect", 75_264, False),
        ("raw+jpeg", "unknown", 75_264, False),
    ],
)
def test_noise_of_few_pixels_tells_little(kind, verdict, pixels, told):
    pairs = {"fit": ["a", "b"], "held_out": ["c", "d"], "pixels": pixels}
    warning = few_pairs(changed(kind=kind, verdict=verdict, pairs=pairs))
    assert warning.startswith("only 0.08 million pixels in all: ") if told else warning == ""


def test_fewer_than_four_pairs():
    fewer = ["a", "b"], ["c"]
    assert few_pairs(changed(pairs=dict(zip(("fit", "held_out"), fewer)))).startswith("only 3 pairs: ")
    assert few_pairs(changed(pairs={"fit": ["a (1)", "a (2)"], "held_out": ["a (3)", "a (4)"]})) == ""
    alone = changed(pairs={"fit": ["a (even tiles)"], "held_out": ["a (odd tiles)"]})
    assert "Only 1 pair: intervals and the choice are not reliable; give at least four." in shown(alone)
    assert "<dd>1 pair: a (even tiles)</dd>" in shown(alone)
    enough = changed(pairs={"fit": ["a", "b"], "held_out": ["c", "d"]})
    assert 'class="warning"' not in shown(enough) and "2 pairs: a, b" in shown(enough)


def test_the_command_says_what_is_left_and_warns(tmp_path, capsys):
    _warn(REPORT)
    _print(Diagnosis(REPORT, PICTURES), tmp_path / "report.html")
    out, err = capsys.readouterr()
    assert out.startswith("verdict: effect; gap 17.6 -> 4.2, floor 1; 19 % of the gap stays unexplained\n")
    assert err == "jaxisp: only 2 pairs: intervals and the choice are not reliable; give at least four.\n"
    four = {"fit": ["a", "b"], "held_out": ["c", "d"], "left_out": []}
    _warn(changed(pairs=four))
    assert capsys.readouterr().err == ""
    _warn(changed(pairs=four | {"left_out": [{"name": "e", "reason": "of two scenes"}]}))
    assert capsys.readouterr().err == "jaxisp: e: left out: of two scenes\n"


def test_the_page_says_what_was_done_to_pairs():
    aside = {"left_out": [{"name": "e", "reason": "far off"}], "failed": [{"file": "f", "reason": "f: lost"}]}
    text = shown(changed(pairs=REPORT["pairs"] | aside))
    assert "a moved (2.0, -1.0 px)" in text and "f: lost; e: far off" in text
    assert "not surely of one scene" in text


def test_statistics_have_names():
    known = statistic_words()
    assert set(feature_names()) <= set(known) and len(set(known.values())) == len(known)
    assert {name.split()[1] for name in feature_names()} <= set(STATISTICS) == set(PIXELS)
    assert statistic("intensity", "logvar Cb2") == "Cb noise at luma 60"
    assert statistic("intensity", "code dark04") == "RAW values in 44 even levels, in the dark"
    assert statistic("row", "something else") == "something else"


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
    assert "from the middle (0) to the corners (1); up: Cb, mean, steps" in text


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
    assert "predicted 160 %" in text and "predicted -30 %" in text and "predicted 10 %" not in text
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


def test_what_would_show_the_rest_is_said():
    left = REPORT["unexplained"] | {"next_measurement": "a flat field"}
    text = shown(changed(unexplained=left, verdict="unknown", causes=[]))
    assert "<h2>What to measure next</h2>" in text and "To see alone what is left: a flat field." in text
    alike = CAUSE | {"alternatives": ["color_shading"], "next_measurement": "a lamp"}
    both = shown(changed(unexplained=left, causes=[alike]))
    assert both.index("from colour shading: a lamp.") < both.index("what is left: a flat field.")
    for absent in (REPORT["unexplained"], REPORT["unexplained"] | {"next_measurement": None}):
        assert "What to measure next" not in shown(changed(unexplained=absent))


def test_what_a_flexible_model_reaches_is_a_bar():
    found = {"best": 2.2, "explained": 0.93, "how": "a free curve and filter"}
    text = shown(changed(gap=REPORT["gap"] | {"reducible": found}))
    assert re.findall(r'<span class="name">(\w+(?: model)?)</span>', text)[:4] == [
        "before",
        "after",
        "flexible model",
        "floor",
    ]
    widths = [float(w) for w in re.findall(r'class="bar [a-z_ ]+" style="width:([\d.]+)%', text)]
    assert widths[2] / widths[0] == pytest.approx(2.2 / 17.6, abs=1e-3)
    said = "Of what our flexible models could reduce (lowest: a free curve and filter), the named effects are"
    assert f"{said} 93 %." in text
    unnamed = found | {"explained": None}
    for other in (changed(gap=REPORT["gap"] | {"reducible": unnamed}), changed(causes=[], verdict="unknown")):
        other["gap"]["reducible"] = unnamed
        assert "A flexible model (a free curve and filter) gets to 2.2." in shown(other)
    worse = shown(changed(gap=REPORT["gap"] | {"reducible": found | {"best": 4.2, "explained": 1.0}}))
    assert "No flexible model of ours gets lower." in worse and ">flexible model<" not in worse
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


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write_report(REPORT, PICTURES, tmp_path / "file")
