"""The experiment on real photographs: sets are independent, a run goes on, and the page says the figures."""

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from experiments import real_gap
from experiments.real_gap import SETS, in_own_process, run
from experiments.real_gap_tables import TITLES, markdown
from jaxisp.errors import InputError

FILES = {
    "iphone7": ["dataset.toml", "iphone7.png", "iphone7.raw.npy"],
    "iphone8": ["00.clean.npy", "00.noisy.png", "dataset.toml"],
    "polyu": [f"{word}_a{end}" for word in ("Canon5D2", "SonyA7II") for end in (".clean.jpg", ".jpg")],
    "sidd": ["00.clean.png", "00.noisy.png", "dataset.toml"],
}


def report(name: str, *, downstream: bool = False) -> dict[str, Any]:
    """A report in which each set's figures are its own: iphone7 has a cause, sidd no gap, iphone8 something
    near, and the others nothing."""
    before = 20.0 + list(SETS).index(name)
    found: dict[str, Any] = {
        "kind": SETS[name].kind,
        "base": {"absorbed": {}},
        "pairs": {"fit": ["a", "c"], "held_out": ["b"], "pixels": 9, "failed": [{"file": "/home/x"}]},
        "gap": {"before": before, "after": before, "floor": 1.0, "ci": [1, float("nan")], "statistics": {}},
        "verdict": "unknown",
        "causes": [],
        "ranking": [],
        "where": [
            {"axis": axis, "share": 0.3, "profile": [1]} for axis in ("row", "cfa_phase", "lag", "hue")
        ],
        "unexplained": {"share": 1.0, "axes": ["row"], "next_measurement": None},
        "seconds": 3.0,
    }
    if name == "iphone7":
        cause = {"effect": "chroma_denoising", "alternatives": ["optical_blur"], "closed": 0.58}
        found |= {"verdict": "effect", "causes": [cause | {"ci": [0.47, 0.69]}]}
        found["gap"] |= {"after": 10.1, "reducible": {"best": 9.5, "explained": 0.9, "how": "retrained"}}
        found["unexplained"] |= {"share": 0.28, "next_measurement": "a slanted edge"}
        found["pairs"] |= {"fit": ["a (even tiles)"], "held_out": ["a (odd tiles)"]}
        found["where"][0]["ci"] = [0.2, 0.4]
    if name == "iphone8":
        near = {"effects": ["double_compression"], "closed": 0.5, "axes": ["frequency"]}
        found["unexplained"] |= {"nearest": near}
    if name == "sidd":
        found |= {"verdict": "none", "where": []}
        found["unexplained"] |= {"nearest": {"effects": ["prnu"], "closed": 0.1, "axes": []}}
    if downstream:
        arms = {
            a: {"psnr_mean": m, "psnr_spread": 0.1} for a, m in zip(("without", "with", "real"), (25, 27, 26))
        }
        found["downstream"] = {"arms": arms, "seeds": [0, 1], "input": {"psnr": 24}, "effects": ["row_noise"]}
    if downstream and name == "sony":
        found["downstream"] = {"skipped": "no effect comes near"}
    return found


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for folder, names in FILES.items():
        (tmp_path / "data" / folder).mkdir(parents=True)
        for name in names:
            (tmp_path / "data" / folder / name).write_text(folder)
    return tmp_path / "data"


class Diagnose:
    """Remembers the folders that it was given, and fails where it is told to."""

    def __init__(self) -> None:
        self.seen: dict[str, dict[str, str]] = {}
        self.broken: set[str] = set()

    def __call__(self, folder: Path, downstream: Any = None) -> Any:
        self.seen[folder.name] = {p.name: p.read_text() for p in sorted(folder.iterdir())}
        if folder.name in self.broken:
            raise InputError(f"{folder}/a.jpg: is\nno JPEG")
        return SimpleNamespace(report=report(folder.name, downstream=downstream is not None))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Diagnose:
    found = Diagnose()
    monkeypatch.setattr(real_gap, "diagnose", found)
    return found


def here(call: Any, *arguments: Any) -> Any:
    return call(*arguments)


def test_folders_hold_the_files_of_one_camera(data: Path, fake: Diagnose, tmp_path: Path) -> None:
    assert run(data, tmp_path / "new" / "gap.json", apart=here) == []
    assert list(fake.seen) == list(SETS) == list(TITLES)
    for name in ("iphone7", "iphone8", "sidd"):
        assert list(fake.seen[name]) == FILES[name]
    for name, word in (("canon", "Canon5D2"), ("sony", "SonyA7II")):
        toml = fake.seen[name].pop("dataset.toml")
        assert toml == 'clean_encoding = "srgb"\n'
        assert list(fake.seen[name]) == [f"{word}_a.clean.jpg", f"{word}_a.jpg"]


def test_a_broken_set_stops_no_other_and_is_tried_again(
    data: Path, fake: Diagnose, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "gap.json"
    fake.broken = {"iphone8"}
    (data / "sidd").rename(data / "elsewhere")
    assert run(data, out, apart=here) == ["iphone8", "sidd"]
    found = json.loads(out.read_text())
    assert (
        list(found) == list(SETS)
        and str(tmp_path) not in out.read_text() + out.with_suffix(".md").read_text()
    )
    assert found["iphone8"] == {"failed": "InputError: a.jpg: is no JPEG"}
    assert found["canon"]["gap"] == {"before": 22.0, "after": 22.0, "floor": 1.0, "ci": [1, None]}
    said = capsys.readouterr().out.splitlines()
    assert "iphone8: failed: InputError: a.jpg: is no JPEG" in said and len(said) == 5
    assert "**SIDD** failed: InputError: sidd/*: no such files in DATA" in out.with_suffix(".md").read_text()

    fake.broken, fake.seen = set(), {}
    (data / "elsewhere").rename(data / "sidd")
    assert run(data, out, ["iphone8"], apart=here) == [] and list(fake.seen) == ["iphone8"]
    assert run(data, out, apart=here) == [] and list(fake.seen) == ["iphone8", "sidd"]
    assert "failed" not in out.read_text()


def test_denoisers_are_added_and_what_was_found_is_not_lost(
    data: Path, fake: Diagnose, tmp_path: Path
) -> None:
    out = tmp_path / "gap.json"
    run(data, out, apart=here)
    before, fake.broken, fake.seen = json.loads(out.read_text()), {"canon"}, {}
    assert run(data, out, downstream=True, apart=here) == ["canon"]
    found = json.loads(out.read_text())
    assert "iphone7" not in fake.seen and found["canon"] == before["canon"]
    assert [name for name, record in found.items() if "downstream" in record] == ["iphone8", "sony", "sidd"]


def test_the_page_says_the_figures(data: Path, fake: Diagnose, tmp_path: Path) -> None:
    out = tmp_path / "gap.json"
    run(data, out, downstream=True, apart=here)
    text = out.with_suffix(".md").read_text()
    row, *_ = [line for line in text.splitlines() if line.startswith("| iPhone 7 |")]
    assert row.startswith(
        "| iPhone 7 | raw+jpeg: one, half of its tiles held out | 20 | 10.1 [1, unknown] | 1 | row 0.30 "
        "[0.20, 0.40], colour filter phase 0.30, noise correlation 0.30 | chroma denoising 0.58 [0.47, 0.69] "
        "| chroma denoising: optical blur | 28%, row | "
    )
    assert "| clean+noisy: 3, 1 held out | 21 [1, unknown] | 11 | 1 | " in text
    assert (
        "| unknown; refused: double compression 0.50 |  | 100%, row; with what was refused 50%, frequency |"
        in text
    )
    axes = "on these axes: row, colour filter phase and noise correlation"
    for said in (
        f"A gap of 20, 10.1 after adding chroma denoising (or optical blur), floor 1 (13.0 dB above it "
        f"before, 10.0 dB left), {axes}. Of the most "
        "that any model of ours reduces (lowest: retrained), the named effects are 90\N{NO-BREAK SPACE}%. "
        "What could tell more: a slanted edge.\n",
        f"A gap of 21, 11 after adding double compression, which does not account for it, floor 1 "
        f"(13.2 dB above it before, 10.4 dB left), {axes}.\n",
        f"A gap of 23, floor 1 (13.6 dB above it before), {axes}; no effect comes near it.\n",
        "A gap of 24, floor 1 (13.8 dB above it before); so near the floor that nothing is missing.\n",
        "| 25.00 dB (0.10) without, 27.00 dB (0.10) with row noise, 26.00 dB (0.10) on real pairs; noisy "
        "pictures 24.00 dB |",
        "| none: no effect comes near |",
    ):
        assert said in text
    assert markdown(json.loads(out.read_text())) == text


def test_a_process_that_is_killed_is_a_set_that_failed(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "gap.json"
    assert in_own_process(json.loads, '{"a": 1}') == {"a": 1}

    def killed(call: Any, *arguments: Any) -> Any:
        return in_own_process(os._exit, 9)

    assert run(data, out, ["sidd"], apart=killed) == ["sidd"]
    assert "killed" in json.loads(out.read_text())["sidd"]["failed"]
