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

from jaxisp.errors import InputError
from jaxisp.gap.report import html, sentence, write_report

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
    "pairs": {"fit": ["a"], "held_out": ["<script>alert(1)</script>"]},
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
        {"effect": "vignetting", "closed": 0.812, "status": "accepted"},
        {"effect": "color_shading", "closed": 0.31, "status": "rejected"},
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
PICTURES = {
    "name": "<i>one</i>",
    "target": GREY,
    "before": GREY,
    "after": GREY,
    "residual_before": np.zeros((24, 44, 3)),
    "residual_after": np.zeros((24, 44, 3)),
    "spectrum_before": np.ones((16, 16)),
}


class Balance(HTMLParser):
    """Fails where a tag is closed that is not open."""

    VOID = ("meta", "link", "img", "rect", "line", "polyline")

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


def changed(**more):
    return copy.deepcopy(REPORT) | more


def test_files(tmp_path):
    page = write_report(REPORT, PICTURES, tmp_path / "new")
    assert page == tmp_path / "new" / "report.html"
    assert json.loads((tmp_path / "new" / "report.json").read_text()) == REPORT
    assert sorted(p.name for p in page.parent.iterdir()) == ["report.html", "report.json"]
    text = page.read_text()
    assert Balance(text).pictures == 6
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "url(" not in text and "@import" not in text
    assert (
        "<script>alert" not in text
        and "<i>one" not in text
        and "<b>" not in re.sub(r"<b>[a-z ]+</b>", "", text)
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


def test_what_it_says():
    text = html(REPORT, PICTURES).replace("\N{NO-BREAK SPACE}", " ")
    assert "The simulator lacks vignetting: it closes 81 % [76, 85] of the gap on held-out pairs." in text
    assert "from 17.6 to 4.2; the floor is 1." in text
    assert "white balance 94 %" in text and "taken up by the base fit" in text and "62 s" in text
    assert "19 % of the gap is left, on edge." in text
    assert text.count("<svg") == 3 and "tail 1 %" in text  # an axis that is not clear is listed, not drawn


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


def test_bars_are_to_scale():
    page = html(REPORT, PICTURES)
    widths = [float(w) for w in re.findall(r'class="bar [a-z_]+" style="width:([\d.]+)%', page)]
    before, after, floor, *ranking = widths
    assert after / before == pytest.approx(4.2 / 17.6, abs=1e-3) and floor / before == pytest.approx(
        1 / 17.6, abs=1e-3
    )
    assert ranking == [81.2, 31, 0]


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write_report(REPORT, PICTURES, tmp_path / "file")
