"""The fitter on the reference phone, whose code it does not share."""

import dataclasses
import json

import numpy as np
import pytest

from jaxisp.camera import develop
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit import fit_dataset, fit_examples, fitter, model
from jaxisp.fit.align import Alignment
from jaxisp.fit.fitter import Example, prepare
from jaxisp.fit.report import parameter_rows, write_report
from jaxisp.io import open_dataset, orient
from jaxisp.params import to_bounded, to_unbounded
from jaxisp.pipeline import run
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, scene, write_pairs

SIZE = (160, 192)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", SIZE)})
    return folder


@pytest.fixture(scope="module")
def result(folder):
    return fit_dataset(folder, steps=150, demosaic="demosaic_malvar")


def psnr(a, b):
    return -10 * np.log10(np.mean((np.asarray(a) - b) ** 2))


def test_it_finds_most_of_the_look_on_tiles_it_did_not_see(result):
    (pair,) = result.pairs
    before = psnr(pair.start[8:-8, 8:-8], pair.target[8:-8, 8:-8])
    assert pair.held_out_psnr > before + 4
    assert abs(pair.held_out_psnr - pair.psnr) < 3
    assert np.abs(pair.shift).max() < 0.2
    assert result.losses[-10:].mean() < 0.7 * result.losses[:5].mean()


def test_the_camera_file_renders_what_was_measured(folder, result, tmp_path):
    """CAMERA.toml applied by `develop` to the RAW gives the picture whose figures were reported."""
    result.camera.save(tmp_path / "camera.toml")
    pair = open_dataset(folder).pairs[0].load()
    developed = develop(pair.raw, Recipe.load(tmp_path / "camera.toml"))
    rendered = orient(result.pairs[0].render, pair.raw.orientation)
    assert psnr(developed[8:-8, 8:-8], rendered[8:-8, 8:-8]) > 35  # only the sub-pixel shift differs


def test_figures_are_of_disjoint_tiles(folder, result):
    shot = prepare(example(folder), "demosaic_malvar")
    assert not (shot.fitted & shot.held_out).any()
    assert 0.3 < shot.fitted.mean() < 0.5 and 0.3 < shot.held_out.mean() < 0.5
    (pair,) = result.pairs
    inside = np.broadcast_to(shot.held_out[..., None], pair.target.shape)
    assert pair.held_out_psnr == pytest.approx(psnr(pair.render[inside], pair.target[inside]), abs=0.01)
    figures = result.as_dict()
    assert figures["held_out"]["psnr"] == pytest.approx(pair.held_out_psnr)
    assert {"name", "psnr", "ssim", "held_out_psnr", "held_out_ssim", "shift_px"} == set(figures["pairs"][0])


def example(folder) -> Example:
    pair = open_dataset(folder).pairs[0].load()
    return Example("astronaut", pair.raw, pair.picture, pair.jpeg)


def test_a_known_shift_is_found(folder):
    given = example(folder)
    moved = dataclasses.replace(given, picture=np.roll(given.picture, (2, -3), (0, 1)), jpeg=None)
    shot = prepare(moved, "demosaic_bilinear")
    assert shot.alignment.dy == pytest.approx(-2, abs=0.15)
    assert shot.alignment.dx == pytest.approx(3, abs=0.15)


def test_the_fit_moves_towards_its_own_parameters(folder):
    """The target is the model's own rendering with other parameters, so the residual must vanish."""
    given = example(folder)
    shot = prepare(given, "demosaic_bilinear")
    chain = model.tail()
    params = fitter.start(chain, [shot])
    params["saturation"] = type(params["saturation"])(amount=np.float32(1.3))
    params["unsharp_mask"] = dataclasses.replace(params["unsharp_mask"], amount=np.float32(1.0))
    params = to_bounded(to_unbounded(params))
    target = np.clip(np.asarray(run(chain, params, shot.camera_rgb)), 0, 1)
    own = dataclasses.replace(shot, target=target, alignment=Alignment(), jpeg=None)
    fitted, _, losses = fitter.fit_shots([own], steps=150)
    assert losses[-5:].mean() < 0.1 * losses[:3].mean()
    assert fitter.evaluate(fitted, own, Alignment()).held_out_psnr > 45
    assert fitted["saturation"].amount == pytest.approx(1.3, abs=0.1)


def test_another_scene_is_refused_with_its_figure(folder):
    other = example(folder)
    coffee = scene("coffee", SIZE).astype(np.float32) ** (1 / 2.2)
    wrong = dataclasses.replace(other, picture=coffee, jpeg=None)
    with pytest.raises(InputError, match=r"do not show the same scene \(correlation"):
        fit_examples([wrong], steps=1)


def test_one_bad_pair_does_not_stop_the_others(tmp_path, capsys):
    write_pairs(tmp_path, PHONES["a"], {"astronaut": scene("astronaut", SIZE)})
    (tmp_path / "broken.dng").write_bytes((tmp_path / "astronaut.dng").read_bytes()[:3000])
    (tmp_path / "broken.jpg").write_bytes((tmp_path / "astronaut.jpg").read_bytes())
    (tmp_path / "alone.dng").write_bytes((tmp_path / "astronaut.dng").read_bytes())
    out = tmp_path / "out" / "camera.toml"
    call = ["fit", str(tmp_path), "-o", str(out), "--steps", "2", "--demosaic", "demosaic_bilinear", "--json"]
    assert main(call) == 2
    printed, errors = capsys.readouterr()
    assert [p["name"] for p in json.loads(printed)["pairs"]] == ["astronaut"]
    assert Recipe.load(out).name == "fitted"
    lines = errors.strip().splitlines()
    assert len(lines) == 2
    assert all(sum(f"{name}.dng" in line for line in lines) == 1 for name in ("broken", "alone"))


def test_the_report_is_one_file_without_requests(result, tmp_path):
    path = write_report(result, tmp_path / "new folder")
    text = path.read_text()
    assert 'src="data:image/png;base64,' in text and "http" not in text.replace("http-equiv", "")
    assert f"{result.pairs[0].held_out_psnr:.2f}" in text
    rows = parameter_rows(result)
    assert any(stage == "bilateral" for stage, *_ in rows)
