"""The measure of whole batches runs anywhere, prints its results as JSON alone, and keeps them."""

import json

import jax
import pytest

from benchmarks import accelerator


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


def test_an_unknown_recipe_is_one_line(monkeypatch, capsys):
    with pytest.raises(SystemExit):
        run(monkeypatch, "--recipes", "phon")
    assert "no recipe phon; there are" in capsys.readouterr().err
