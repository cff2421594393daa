"""`jaxisp diagnose` around the diagnosis itself: what is handed over, told and left behind."""

import json

import pytest

import jaxisp.gap
import jaxisp.io.files as files
from jaxisp.cli import main
from jaxisp.gap import Diagnosis
from tests.gap.page import PICTURES, REPORT


@pytest.fixture
def found(monkeypatch):
    """What was asked for; the answer is there at once."""
    asked = {}

    def diagnose(dataset, camera, **options):
        asked.update(options)
        return Diagnosis(REPORT, PICTURES)

    monkeypatch.setattr(jaxisp.gap, "diagnose", diagnose)
    return asked


def test_blanks_between_names_do_not_count(found, tmp_path):
    call = ["diagnose", "set", "-o", str(tmp_path), "--exclude", "vignetting, prnu,"]
    assert main(call) == 0 and found["exclude"] == ["vignetting", "prnu"]


@pytest.mark.parametrize("form", [["--json"], []])
def test_a_disk_that_fills_at_the_end_does_not_cost_the_answer(found, tmp_path, capsys, monkeypatch, form):
    def no_space(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", no_space)
    assert main(["diagnose", "set", "-o", str(tmp_path / "out"), *form]) == 2
    out, err = capsys.readouterr()
    assert json.loads(out) == REPORT if form else out.startswith("verdict: effect; gap 17.6 -> 4.2")
    assert "no space left" in err and not (tmp_path / "out").exists()


def test_what_is_printed_is_json_where_a_number_is_none(found, tmp_path, capsys, monkeypatch):
    unknown = REPORT | {"gap": REPORT["gap"] | {"ci": [float("nan"), 5.0]}}
    monkeypatch.setattr(jaxisp.gap, "diagnose", lambda *a, **k: Diagnosis(unknown, PICTURES))
    assert main(["diagnose", "set", "-o", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gap"]["ci"] == [None, 5.0]


def test_a_stopped_diagnosis_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(jaxisp.gap, "diagnose", stopped)
    assert main(["diagnose", "set", "-o", str(tmp_path / "new" / "out"), "--json"]) == 130
    assert capsys.readouterr() == ("", "jaxisp: interrupted; files already written are complete\n")
    assert list(tmp_path.iterdir()) == []


def test_unusable_input_leaves_no_folder(tmp_path, capsys):
    (tmp_path / "there").mkdir()
    for out in ("there", "new/out"):
        assert main(["diagnose", str(tmp_path / "missing"), "-o", str(tmp_path / out)]) == 2
        assert "missing: no such folder" in capsys.readouterr().err
    assert [p.name for p in tmp_path.rglob("*")] == ["there"]
