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
from jaxisp.gap.report.page import few_pairs, html, sentence, unexplained, write_report
from tests.gap.page import CAUSE, GREY, PICTURES, REPORT, Balance, changed, shown


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
    near = {"effects": ["sharpening", "prnu"], "closed": 0.8, "axes": ["edge", "lag"]}
    left = {"share": 1.0, "axes": ["edge"], "description": "100 % of the gap is left, on edge"}
    unknown = {"verdict": "unknown", "causes": []}
    start = "There is a gap, and no effect of the library explains it."
    assert sentence(changed(**unknown, unexplained=left)) == start

    def told(near):
        said = sentence(changed(**unknown, unexplained=left | {"nearest": near}))
        return said.replace("\N{NO-BREAK SPACE}", " ").removeprefix(f"{start} ")

    first = "Refused: sharpening and PRNU, which would close"
    assert told(near) == f"{first} 80 % and leave edge and noise correlation."
    less = near | {"closed": 0.53, "axes": []}
    assert told(less) == f"{first} 53 %; vignetting alone closes 81 %."
    assert told(less | {"effects": ["vignetting"]}) == "Refused: vignetting, which would close 53 %."
    assert "Refused: sharpening" in shown(changed(**unknown, unexplained=left | {"nearest": near}))


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


def test_the_command_says_what_is_left_and_warns(capsys):
    _warn(REPORT)
    _print(REPORT)
    out, err = capsys.readouterr()
    assert out.startswith("verdict: effect; gap 17.6 -> 4.2, floor 1; 19 % of the gap stays unexplained\n")
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
    near = {"effects": ["double_compression"], "closed": 0.53, "axes": []}
    left = REPORT["unexplained"] | {"nearest": near, "next_measurement": "a flat field"}
    ranking = REPORT["ranking"][1:]
    _print(changed(verdict="unknown", causes=[], ranking=ranking, unexplained=left))
    assert capsys.readouterr().out.splitlines() == [
        "verdict: unknown; gap 17.6 -> 4.2, floor 1",
        "There is a gap, and no effect of the library explains it. "
        "Refused: double compression, which would close 53 %.",
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
    with pytest.raises(InputError, match="cannot be written"):
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
