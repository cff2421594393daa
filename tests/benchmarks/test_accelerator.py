"""The measure of whole batches runs anywhere, prints its results as JSON alone, and keeps them."""

import json

import jax
import numpy as np
import pytest

from benchmarks import accelerator
from benchmarks.case import Case, Peer


def run(monkeypatch, *options):
    monkeypatch.setattr("sys.argv", ["accelerator", *options])
    accelerator.main()


def test_what_is_printed_is_kept(tmp_path, monkeypatch, capsys):
    jax.clear_caches()  # or the first call may compile nothing
    out = tmp_path / "new" / "results.json"
    options = "--recipes", "awgn", "--batches", "2", "--no-frame", "--seconds", "0", "--json"
    run(monkeypatch, *options, "--out", str(out))
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(out.read_text())
    forward, gradient = printed["rows"]
    assert (forward["what"], gradient["what"], forward["images"]) == ("awgn", "awgn, gradient", 2)
    for row in printed["rows"]:
        assert row["rounds"] == accelerator.LEAST_ROUNDS and row["first_call_s"] > row["ms"] / 1e3 > 0
        least, most = (row["ms"] / (row["floor_ms"] + by) for by in (5e-5, -5e-5))  # it is rounded
        assert least - 0.1 <= row["times_floor"] <= most + 0.1


def test_stages_and_their_kernels(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    stages = "--recipes", "--no-frame", "--stages", "2", "--only", "JPEG", "--kernels"
    files = "--out", str(tmp_path / "results.json"), "--report", str(page)
    run(monkeypatch, *stages, *files, "--seconds", "0", "--json")
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["what"], row["images"]) == ("JPEG 4:2:0", 2)
    assert row["kernels_ms"] == pytest.approx(sum(k["ms"] for k in row["kernels"]), abs=1e-3)
    (line,) = (line for line in page.read_text().splitlines() if "JPEG" in line)
    assert line.startswith(f"| JPEG 4:2:0 | 2 | {row['ms']:.3f} (") and line.count("|") == 12
    assert all(k["ms"] >= 0 and k["times"] > 0 for k in row["kernels"]) and len(row["kernels"]) > 5


def test_a_peer_that_fails_is_told_in_a_line():
    def numbers():
        return np.arange(4.0)

    def fails():
        raise ValueError("no such card\nand more")

    def apart(ours, theirs):
        return f"{np.abs(ours - theirs).max():.1f} apart"

    how = accelerator.How(0.0, False)
    case = Case("a stage", "batch", numbers)
    entry = accelerator.against(case, Peer("kornia", numbers, agrees=apart), 2.0, how)
    assert entry["outputs"] == "0.0 apart" and entry["ratio"] == pytest.approx(entry["ms"] / 2, abs=0.01)
    entry = accelerator.against(case, Peer("kornia", fails), 2.0, how)
    assert entry["error"] == "ValueError: no such card" and "ms" not in entry
    row = {"what": "a stage", "images": 4, "first_call_s": 1.0} | accelerator.timed(numbers, 0.0)
    told = accelerator.line(row | {"times_floor": 3.0, "peers": [entry]})
    assert "kornia: ValueError: no such card" in told


def test_an_unknown_recipe_is_one_line(monkeypatch, capsys):
    with pytest.raises(SystemExit):
        run(monkeypatch, "--recipes", "phon")
    assert "no recipe phon; there are" in capsys.readouterr().err
