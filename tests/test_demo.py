"""`jaxisp demo`, in a short version, through the command line."""

import functools
import json

import pytest
from PIL import Image

import jaxisp.demo
from jaxisp.cli import main
from jaxisp.fit import fit_dataset
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.io import open_dataset
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.samples import PHONES
from jaxisp.train import TrainConfig


@pytest.mark.parametrize(
    ("named", "right", "words"),
    [
        ([{"sharpening"}], True, "It also has luma denoising"),
        ([{"sharpening"}, {"luma_denoising", "film_grain"}], True, "all that is named."),
        ([{"sharpening"}, {"film_grain"}], False, "no film grain"),
        ([], False, "names none"),
    ],
)
def test_a_verdict_is_held_to_how_the_phone_was_made(named, right, words):
    found, text = jaxisp.demo.judged(named, {"sharpening", "luma_denoising"})
    assert found == right and words in text
    assert jaxisp.demo.lacking(PHONES["c"]) - jaxisp.demo.lacking(PHONES["a"]) == {"vignetting"}


@pytest.mark.optimised
@pytest.mark.slow
def test_demo(tmp_path, capsys, monkeypatch):
    whole = jaxisp.demo.run_demo
    monkeypatch.setattr(jaxisp.demo, "run_demo", lambda *a, **k: whole(*a, **k, steps=3, training=2))
    monkeypatch.setattr(jaxisp.demo, "SIZE", 160)
    plain = functools.partial(fit_dataset, demosaic="demosaic_malvar", median="none")
    monkeypatch.setattr(jaxisp.demo, "fit_dataset", plain)
    light = "phone-ahd"  # compiles in a quarter of the time
    monkeypatch.setattr(jaxisp.demo, "RECIPES", RECIPES | {"phone": RECIPES[light]})
    monkeypatch.setattr(jaxisp.demo, "TrainConfig", lambda **k: TrainConfig(**k | {"recipe": light}))
    few = sorted(set(EFFECTS) - {"chroma_denoising", "luma_denoising", "sharpening", "film_grain"})
    monkeypatch.setattr(jaxisp.demo, "diagnose", functools.partial(diagnose, exclude=few))
    assert main(["demo", "--out", str(tmp_path / "d"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    text = (tmp_path / "d" / "report.html").read_text()
    for heading in (
        "stage by stage",
        "degraded patches",
        "before and after",
        "fitted camera on a RAW",
        "A denoiser trained",
        "What a plain camera lacks",
    ):
        assert heading in text
    assert 'href="diagnosis/report.html"' in text and ("Right: " in text or "Wrong: " in text)
    assert len(result["fit"]["pairs"]) == 4 and result["degrade"]["images"] == 4
    assert result["train"]["step"] == 2 and result["diagnose"]["verdict"] in ("effect", "none", "unknown")
    assert (tmp_path / "d" / "diagnosis" / "report.html").stat().st_size > 1000
    assert open_dataset(tmp_path / "d" / "degraded").kind == "clean+noisy"
    assert Recipe.load(tmp_path / "d" / "camera.toml").name == "fitted"
    assert Image.open(tmp_path / "d" / "developed-fitted.png").size == (160, 160)
