"""The denoiser experiments: what is computed once stays, tables are added to those that are there."""

import json

import numpy as np
import pytest
from scipy import ndimage

from experiments.denoisers import (
    ablations,
    demosaicking,
    general,
    noise_models,
    noise_spectra,
    raw_input,
    report,
    sanity,
    study,
)
from experiments.denoisers.ceilings import in_camera_sharpness, in_camera_tone
from experiments.denoisers.pairs import as_pair
from experiments.denoisers.training import FITTED, SCALES, Place, configuration
from jaxisp.io import read_image, write_png
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path, tmp_path / "work", (str(tmp_path),))


@pytest.fixture
def pairs(rng):
    clean = smooth_image((40, 44, 3), 1, 0.2, 0.8)
    noise = 0.05 * rng.standard_normal((2, *clean.shape), np.float32)
    return [as_pair(name, np.clip(clean + n, 0, 1), clean) for name, n in zip("ab", noise)]


@pytest.mark.parametrize("module", [ablations, demosaicking, noise_models, raw_input, sanity])
def test_tables_are_of_recipes_that_there_are(module):
    assert module.TABLE.name == module.__name__.rpartition(".")[2]
    assert set(module.TABLE.recipes) <= {*RECIPES, FITTED}


def test_runs_of_a_scale_differ_in_the_recipe_alone(place):
    for scale in SCALES:
        a, b = (vars(configuration(place, scale, name, 3)) for name in ("awgn", "phone"))
        assert {k for k in a if a[k] != b[k]} == {"recipe"}


def test_figures_are_computed_once_and_tables_stand_side_by_side(place, pairs, monkeypatch, tmp_path):
    calls = []

    def trained(place, scale, recipe, seed, **changes):
        def denoise(image):
            calls.append(recipe)
            return np.clip(image + 0.01 * (seed + 1), 0, 1)

        return f"{recipe}-{seed}", denoise

    monkeypatch.setattr(study, "evaluation_set", lambda place, name: pairs)
    monkeypatch.setattr(study, "trained", trained)
    table = study.Table("ablations", "Ablations", ("awgn", "phone"), ("iphone8",))
    arguments = (place, "cpu", table.recipes, (0, 1), {})
    rows = study.measure(table, *arguments)
    assert len(calls) == 8 and study.measure(table, *arguments) == rows and len(calls) == 8
    assert [(r["denoiser"], r["seed"]) for r in rows] == [
        ("awgn", 0),
        ("phone", 0),
        ("awgn", 1),
        ("phone", 1),
    ]
    assert rows[0]["mean"]["change"] == pytest.approx(40, abs=0.01)  # 0.01 is 40 dB down
    assert rows[2]["mean"]["change"] == pytest.approx(40 - 20 * np.log10(2), abs=0.01)

    result = {
        "title": "T", "command": "c", "scale": "cpu", "settings": {"steps": 7}, "rows": rows,
        "machine": {"processor": "p", "cores": 2},
    }  # fmt: skip
    for name in ("one", "two"):
        for some in (rows[:2], rows[2:]):  # a seed at a time
            study.save(tmp_path / "out", name, {**result, "title": name, "rows": some})
    assert set(json.loads((tmp_path / "out" / "denoisers.json").read_text())) == {"one", "two"}
    page = (tmp_path / "out" / "denoisers.md").read_text()
    psnr = [r["mean"]["psnr"] for r in rows if r["denoiser"] == "awgn"]
    assert f"| {np.mean(psnr):.2f} +- {np.std(psnr, ddof=1):.2f} |" in page
    assert "## one" in page and "## two" in page and "steps 7" in page
    assert page == report.document(json.loads((tmp_path / "out" / "denoisers.json").read_text()))


def test_the_ceiling_has_the_tone_of_the_noisy_picture(rng):
    clean = smooth_image((40, 44, 3), 1, 0.2, 0.8)
    noisy = clean**0.7 + 0.03 * rng.standard_normal(clean.shape)
    pair = as_pair("a", np.float32(noisy), clean)
    np.testing.assert_allclose(in_camera_tone(pair), clean**0.7, atol=0.03)
    mean = study.ceiling(in_camera_tone, [pair])["mean"]
    assert mean["psnr"] > mean["psnr_in"] + 3


def test_the_other_ceiling_is_as_sharp_as_the_noisy_picture(rng):
    clean = rng.uniform(0.2, 0.8, (96, 96, 3))
    soft = ndimage.uniform_filter(clean, (3, 3, 1), mode="mirror")
    pair = as_pair("a", np.float32(soft + 0.03 * rng.standard_normal(clean.shape)), clean)
    sharp, softened = (f(pair)[4:-4, 4:-4] - soft[4:-4, 4:-4] for f in (in_camera_tone, in_camera_sharpness))
    assert np.std(softened) < 0.01 < 0.5 * np.std(sharp)


def test_spectra_of_noise_that_is_known(rng):
    """White luma, no chroma noise but waves of 16 px in Cb: each figure has its closed form."""
    y, x = np.mgrid[:256, :256]
    ramp = np.stack([0.3 + 0.001 * x + 0.0005 * y] * 3, axis=-1)  # a plane, which is taken off
    luma, wave = 0.02 * rng.standard_normal(x.shape), 0.01 * np.sin(2 * np.pi * x / 16)
    rgb_of_cb = np.linalg.inv(noise_spectra.BT601)[:, 1]
    noise = luma[..., None] + wave[..., None] * rgb_of_cb
    tiles = [
        255 * noise[i : i + 32, j : j + 32] @ noise_spectra.BT601.T
        for i in range(0, 256, 32)
        for j in range(0, 256, 32)
    ]
    found = noise_spectra.figures(tiles)
    assert found["std"] == pytest.approx(255 * 0.02, rel=0.02)
    assert found["lag1"] == pytest.approx(0, abs=0.02) and found["lag2"] == pytest.approx(0, abs=0.02)
    assert found["chroma"] == pytest.approx(
        0.25 * 0.01**2 / 0.02**2, rel=0.02
    )  # half of a square, and of two planes one
    assert found["wide"] > 0.8 and found["wide_luma"] == pytest.approx(np.pi / 12**2, rel=0.2)

    pair = as_pair("a", np.float32(ramp + noise), np.float32(ramp))
    flat = noise_spectra.figures(noise_spectra.flat_noise(pair))
    assert flat["std"] == pytest.approx(found["std"], rel=0.05)


def test_clean_pictures_are_as_a_lens_makes_them_and_as_one_made_smaller(rng, tmp_path, monkeypatch):
    folder = tmp_path / "clean" / "photos"
    folder.mkdir(parents=True)
    write_png(folder / "noise.png", rng.uniform(size=(600, 600, 3)))
    monkeypatch.setattr(general, "DRAWN", {"text": 1})
    general.clean(tmp_path, [], tmp_path / "made")
    soft, sharp = (read_image(tmp_path / "made" / f"{begins}noise_000.png") for begins in general.SOFT)
    assert soft.shape == sharp.shape == (300, 300, 3)

    def fine(picture):
        return np.square(picture[:, 1:] - picture[:, :-1]).mean()

    assert fine(sharp) > 3 * fine(soft)
    assert {path.name.split("_")[0] for path in (tmp_path / "made").iterdir()} >= {*general.DRAWN, "sharp"}
