"""The page of a diagnosis: what it says, that it is whole, escaped and asks for nothing."""

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from jaxisp.cli.diagnose import _print, _warn
from jaxisp.errors import InputError
from jaxisp.gap.report.page import html, write_report
from jaxisp.gap.report.sentences import few_pairs, next_measurements, sample_of, sentence, unexplained
from tests.gap.page import CAUSE, GREY, PICTURES, REPORT, Balance, changed, shown


def test_files(tmp_path):
    page = write_report(REPORT, PICTURES, tmp_path / "new")
    assert page == tmp_path / "new" / "report.html"
    assert json.loads((tmp_path / "new" / "report.json").read_text()) == REPORT
    assert sorted(p.name for p in page.parent.iterdir()) == ["report.html", "report.json"]
    text = page.read_text()
    assert Balance(text).pictures == 8
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
        "The simulator lacks vignetting (probability 97 %): it closes all of the gap (123 % [93, 156]) on "
        "held-out pairs."
    )


@pytest.mark.parametrize(("least", "verb"), [(0.95, "lacks"), (0.7, "probably lacks"), (0.4, "may lack")])
def test_the_headline_is_as_sure_as_the_score(least, verb):
    cause = CAUSE | {"probability": least}
    assert sentence(changed(causes=[cause])).startswith(f"The simulator {verb} vignetting (probability ")
    both = sentence(changed(causes=[CAUSE, cause]))
    assert both.startswith(f"The simulator {verb} 2 effects, which close ")


def test_what_it_says():
    text = html(REPORT, PICTURES).replace("\N{NO-BREAK SPACE}", " ")
    first = (
        "The simulator lacks vignetting (probability 97 %): it closes 81 % [76, 85] of the gap on held-out"
    )
    assert f"<h1>{first} pairs. 19 % of the gap stays unexplained, on edge.</h1>" in text
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
    "verdict, words", [("none", "No gap beyond the floor"), ("unknown", "no effect of the library is found")]
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
    assert "vignetting or colour shading (81 % [76, 85], probability 97 %); PRNU (10 % [6, 13], prob" in text
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


def test_what_is_likeliest_is_said_where_nothing_is_named():
    left = {"share": 1.0, "axes": ["edge"], "description": "100 % of the gap is left, on edge"}
    unknown = {"verdict": "unknown", "causes": [], "unexplained": left}
    start = "There is a gap, and no effect of the library is found in it."
    assert sentence(changed(**unknown)) == start
    ranking = [
        {"effect": "sharpening", "closed": 0.3, "status": "rejected", "ci": [0.2, 0.4], "probability": 0.41},
        {"effect": "prnu", "closed": 0.1, "status": "rejected", "ci": [0.0, 0.2], "probability": 0.05},
        {"effect": "crosstalk", "closed": -0.1, "status": "rejected", "ci": [-0.2, 0.0], "probability": 0.3},
    ]
    said = sentence(changed(**unknown, ranking=ranking)).replace("\N{NO-BREAK SPACE}", " ")
    assert said == (
        f"{start} Likeliest: sharpening (probability 41 %, closes 30 %); PRNU (probability 5 %, closes 10 %)."
    )
    advised = " ".join(next_measurements(changed(**unknown, ranking=ranking)))
    assert advised.startswith("To tell sharpening from PRNU: ") and "--reference" not in advised
    unknown["unexplained"] = left | {"next_measurement": "a flat field"}
    wanted = changed(**unknown, ranking=ranking)
    advised = " ".join(next_measurements(wanted))
    assert "a set with sharpening switched off, given as --reference" in advised and "--camera" in advised
    wanted["base"] = wanted["base"] | {"given": "camera x"}
    assert "--camera" not in " ".join(next_measurements(wanted))


def test_without_a_gap_the_smallest_that_would_have_shown_is_said():
    power = {"optical_blur": {"parameter": "sigma", "change": 0.2134}}
    text = shown(changed(verdict="none", causes=[], where=[], power=power))
    assert "The smallest that would have shown: optical blur (sigma by 0.213)." in text
    assert "What to measure next" not in text


def test_what_falls_short_is_said():
    left = REPORT["unexplained"] | {"short_of": "the base falls short: its demosaicking shows"}
    said = shown(changed(unexplained=left))
    assert "It shows by edge. The base falls short: its demosaicking shows." in said


def test_what_the_likeliest_effect_changes_is_shown_beside_the_difference():
    changes = np.zeros((24, 44, 3))
    text = shown(REPORT, PICTURES | {"candidate": {"effect": "veiling_glare", "changes": changes}})
    assert "what veiling glare changes, ×32 about grey" in text and Balance(text).pictures == 9


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


@pytest.mark.parametrize(
    ("pairs", "size", "told"),
    [
        ((6, 6), (352, 352), "the middle 352x352 px of 2784x1856 of each pair"),
        ((21, 32), (192, 192), "21 of 32 pairs, the middle 192x192 px of 2784x1856"),
        ((21, 32), (1856, 2784), "21 of 32 pairs"),
        ((6, 6), (1840, 2784), ""),
    ],
)
def test_a_sample_is_said(pairs, size, told):
    sample = {"pairs": pairs[0], "of_pairs": pairs[1], "size_px": list(size), "of_size_px": [1856, 2784]}
    report = changed(pairs=REPORT["pairs"] | {"sample": sample})
    assert sample_of(report) == told and (told in shown(report)) and sample_of(REPORT) == ""


def test_the_command_says_what_is_left_and_warns(capsys):
    _warn(REPORT)
    _print(REPORT)
    out, err = capsys.readouterr()
    left = "19 % of the gap stays unexplained, on edge"
    assert out.startswith(f"verdict: effect; gap 17.6 -> 4.2, floor 1; {left}\n")
    assert err == "jaxisp: only 2 pairs: intervals and the choice are not reliable; give at least four.\n"
    four = {"fit": ["a", "b"], "held_out": ["c", "d"], "left_out": []}
    _warn(changed(pairs=four))
    assert capsys.readouterr().err == ""
    _warn(changed(pairs=four | {"left_out": [{"name": "e", "reason": "of two scenes"}]}))
    assert capsys.readouterr().err == "jaxisp: e: left out: of two scenes\n"
    _warn(changed(pairs=four | {"encoder_not_modelled": [{"name": "a", "reason": "it is odd"}]}))
    assert capsys.readouterr().err == "jaxisp: a: its JPEG encoder is not modelled: it is odd\n"
    _warn(changed(pairs=four | {"raw_notes": [{"name": "a", "notes": ["it is odd", "it is old"]}]}))
    assert capsys.readouterr().err == "jaxisp: a: RAW: it is odd; it is old\n"


def test_the_command_says_what_an_unknown_gap_is_and_what_to_measure(capsys):
    left = REPORT["unexplained"] | {"next_measurement": "a flat field"}
    base = REPORT["base"] | {"given": "a camera"}
    _print(changed(verdict="unknown", causes=[], ranking=REPORT["ranking"][1:], unexplained=left, base=base))
    assert capsys.readouterr().out.splitlines() == [
        "verdict: unknown; gap 17.6 -> 4.2, floor 1",
        "There is a gap, and no effect of the library is found in it.",
        "To see alone what is left: a flat field.",
    ]


def test_the_page_says_what_was_done_to_pairs():
    aside = {"left_out": [{"name": "e", "reason": "far off"}], "failed": [{"file": "f", "reason": "f: lost"}]}
    text = shown(changed(pairs=REPORT["pairs"] | aside))
    assert "a moved (2.0, -1.0 px)" in text and "f: lost; e: far off" in text
    assert "not surely of one scene" in text and "encoder not modelled" not in text
    odd = {"encoder_not_modelled": [{"name": "a", "reason": "its sampling is odd"}]}
    text = shown(changed(pairs=REPORT["pairs"] | odd))
    assert "JPEG encoder not modelled" in text and "a: its sampling is odd" in text
    text = shown(changed(pairs=REPORT["pairs"] | {"raw_notes": [{"name": "a", "notes": ["odd", "old"]}]}))
    assert "about the RAW files" in text and "a: odd; old" in text


def test_what_would_show_the_rest_is_said():
    left = REPORT["unexplained"] | {"next_measurement": "a flat field"}
    text = shown(changed(unexplained=left, verdict="unknown", causes=[]))
    assert "<h2>What to measure next</h2>" in text and "To see alone what is left: a flat field." in text
    alike = CAUSE | {"alternatives": ["color_shading"], "next_measurement": "a lamp"}
    both = shown(changed(unexplained=left, causes=[alike]))
    assert both.index("from colour shading: a lamp.") < both.index("what is left: a flat field.")
    for absent in (REPORT["unexplained"], REPORT["unexplained"] | {"next_measurement": None}):
        assert "What to measure next" not in shown(changed(unexplained=absent))


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written: is a file, expected a folder"):
        write_report(REPORT, PICTURES, tmp_path / "file")


def test_each_picture_stands_where_it_belongs():
    """The camera's first, the simulator's beside it, what is off under that; whatever is absent."""
    columns = re.findall(r'grid-column:(\d)"><img src="[^"]+" alt="[^"]*: ([a-z ,]+)', html(REPORT, PICTURES))
    places = [(text.strip(" ,"), int(column)) for column, text in columns]
    assert places == [
        ("the camera", 1), ("simulator, before", 2), ("simulator, after", 3),
        ("difference before", 2), ("difference after", 3),
    ]  # fmt: skip
    alone = {key: PICTURES[key] for key in ("name", "target", "before")}
    assert re.findall(r'grid-column:(\d)"', html(REPORT, alone)) == ["1", "2"]
