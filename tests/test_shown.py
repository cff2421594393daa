"""How pipelines, parameters and recipes show themselves."""

import json
import xml.etree.ElementTree as ET

import jax
import numpy as np
import pytest

from jaxisp import stage
from jaxisp.calibrate import Calibrated, Noise
from jaxisp.calibrate.noise import Figure
from jaxisp.catalogue import GROUPS
from jaxisp.cli import main
from jaxisp.fit import FitResult, PairResult
from jaxisp.gap import Diagnosis
from jaxisp.io import open_dataset
from jaxisp.recipes import RECIPES, find_recipe, mix
from jaxisp.samples import PHONES, scene, write_pairs
from jaxisp.stages import STAGES
from jaxisp.stages.noise import ShotReadNoise


@pytest.mark.parametrize("name", [*sorted(RECIPES), "phone-any-phases"])
def test_a_recipe_fits_on_a_screen(name):
    recipe = find_recipe(name)
    for text in (repr(recipe), repr(recipe.chain)):
        lines = text.splitlines()
        assert len(lines) <= 50 and max(map(len, lines)) <= 100
        shown = "\n".join(lines[1:])
        assert [s.name for s in recipe.chain.stages() if s.name not in shown] == []


def test_a_recipe_shows_what_it_draws_and_its_options():
    text = " ".join(repr(RECIPES["phone-any"]()).split())
    assert "shot=LogUniform(0.003, 0.06), read=LogUniform(0.001, 0.03)" in text
    assert "cfa='GRBG'" in text and "use_bilateral (Gate), on=Choice((0, 1))" in text


def test_tables_hold_bounds_and_units():
    for shown in (RECIPES["phone"](), RECIPES["phone"]().chain, stage("vignetting"), ShotReadNoise()):
        page = ET.fromstring(f"<div>{shown._repr_html_()}</div>")
        head, *rows = ([cell.text or "" for cell in row] for row in page.iter("tr"))
        assert {"parameter", "value", "bounds", "unit", "meaning"} <= set(head) and rows
    rows = {row[0]: row for row in rows}
    assert rows["read"][2:4] == ["0 to 0.2", "level"]


def test_a_stage_shows_how_it_is_made():
    made = stage("mosaic", cfa="GRBG", name="second")
    assert repr(made) == "stage('mosaic', name='second', cfa='GRBG')" and eval(repr(made)) == made


def test_parameters_of_a_batch_and_traced_ones_are_short():
    assert (
        repr(ShotReadNoise(shot=0.01, read=np.arange(32.0)))
        == "ShotReadNoise(shot=0.01, read=32 from 0 to 31)"
    )
    seen = []
    jax.jit(lambda x: seen.append(repr(ShotReadNoise(shot=x, read=0.5))))(np.float32(1))
    assert seen == ["ShotReadNoise(shot=traced[], read=0.5)"]


def test_a_mixture_shows_its_shares():
    mixture = mix({"phone": 0.75, "clean": 0.25})
    assert repr(mixture) == "mix({'phone': 0.75, 'clean': 0.25})"
    assert mixture._repr_html_().count("<table>") == 2 and "75 %" in mixture._repr_html_()


def listed(capsys, *arguments):
    assert main(["stages", *arguments]) == 0
    return capsys.readouterr().out


def test_stages_are_listed_by_group_a_line_each(capsys):
    lines = listed(capsys).splitlines()
    assert not any(line.endswith("...") for line in lines)  # what is piped is whole
    stages = [line.split()[0] for line in lines[:-1] if line.startswith("  ")]
    package = {name for name, fn in STAGES.items() if fn.__module__.startswith("jaxisp.")}
    assert package <= set(stages) and len(stages) == len(set(stages))
    heads = [line.partition(":")[0] for line in lines[:-1] if not line.startswith(" ")]
    assert heads == [group for group in GROUPS if group in heads] and len(heads) >= 9


def test_the_listing_is_filtered(capsys):
    out = listed(capsys, "denoise")
    assert "  bilateral " in out and "  median " in out and "shot_read_noise" not in out and "jpeg" not in out
    assert "lateral_chromatic_aberration" in listed(capsys, "chromatic")
    assert "Rec. 709" in listed(capsys, "rec709")
    whole = listed(capsys, "jpeg")  # a stage's own name shows that stage, whatever else has it
    assert "quality" in whole and "jpeg_tables" not in whole
    names = {s["name"] for s in json.loads(listed(capsys, "denoise", "--json"))}
    assert {"bilateral", "median"} <= names and "jpeg" not in names
    assert main(["stages", "bilatreal"]) == 2
    assert "is it bilateral" in capsys.readouterr().err


def test_data_and_results_show_themselves_in_a_few_lines(tmp_path):
    write_pairs(tmp_path, PHONES["a"], {"a": scene("astronaut", 64)})
    dataset = open_dataset(tmp_path)
    loaded = dataset.pairs[0].load()
    pair = PairResult("a", 30.0, 0.9, 29.0, 0.8, (0.0, 0.1), loaded.picture, loaded.picture, loaded.picture)
    fit = FitResult(RECIPES["phone"](), [pair], np.zeros(40), ("tone",), 3.0)
    figures = {"shot": Figure(1e-4, 1e-6), "read": Figure(1e-3, 1e-5)}
    noise = Noise(100.0, figures, 64.0, 1023.0, "RGGB")
    report = {"verdict": "effect", "causes": [{"effect": "sharpening"}], "where": list(range(1000))}
    found = Diagnosis(report | {"gap": {"before": 3.0, "after": 2.0, "floor": 1.0}}, {})
    for own in (dataset, loaded, loaded.raw, loaded.jpeg, fit, pair, noise, Calibrated("A", (noise,)), found):
        lines = repr(own).splitlines()
        assert lines[0].startswith(type(own).__name__)
        assert len(lines) <= 30 and max(map(len, lines)) <= 100
    assert "64x64x3 from 0" in repr(loaded) and "held out 29.00 dB, SSIM 0.800" in repr(fit)
    assert repr(found) == "Diagnosis: effect, sharpening; gap 3, then 2, floor 1"
