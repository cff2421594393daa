"""A fit that starts from a camera, holds parameters and fits a stage of the user's own."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from jaxisp.camera import develop
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit import fit_examples, model, prior_from_cameras
from jaxisp.fit.sharing import GROUPS
from jaxisp.pipeline import stage
from jaxisp.recipe import Recipe
from jaxisp.recipes import phone
from jaxisp.stages.balance import HueRotation, Saturation
from tests.fit.conftest import example

HELD = ("tone", "colour", "bilateral", "unsharp_mask", "vignetting", "lateral_chromatic_aberration",
        "geometric_distortion", "median", "chroma_subsampling")  # fmt: skip


@pytest.mark.slow
def test_what_is_inserted_is_found_and_what_is_frozen_stays(folder, result):
    """The target is a fitted camera's own rendering with its hues turned by 20 degrees."""
    given, camera = example(folder), result.camera.without("jpeg_tables")
    turned = camera.insert(stage("hue_rotation"), after="zone_curve").override(hue_rotation={"angle": 20.0})
    pair = dataclasses.replace(given, picture=develop(given.raw, turned), jpeg=None)
    found = fit_examples([pair], steps=8, start=camera, freeze=HELD, insert=["hue_rotation"], median="none")
    prior = found.camera.prior
    assert float(prior["hue_rotation"].angle) == pytest.approx(20, abs=0.5)
    assert found.pairs[0].held_out_psnr > 40
    for name in ("saturation", "bilateral", "s_curve"):
        for field, value in vars(camera.prior[name]).items():
            np.testing.assert_allclose(getattr(prior[name], field), value, rtol=2e-4, atol=2e-4)
    assert "hue_rotation" in found.design and found.camera.meta["inserted"] == ["hue_rotation"]
    assert [n.name for n in found.camera.chain.nodes].index("hue_rotation") == (
        [n.name for n in found.camera.chain.nodes].index("zone_curve") + 1
    )
    assert Recipe.from_toml(found.camera.to_toml()) == found.camera
    assert "hue_rotation" not in prior_from_cameras([found.camera]).prior


def test_a_camera_gives_its_choices_and_parameters():
    design = model.Design("demosaic_ahd", passes=2, median="3x3", lens=True)
    camera = Recipe(model.camera("RGGB", design), {"saturation": Saturation(amount=1.3)})
    choices, params = model.of_camera(camera)
    assert choices == {
        "demosaic": "demosaic_ahd", "mixed": None, "passes": 2, "median": "3x3", "lens": True
    }  # fmt: skip
    assert float(params["saturation"].amount) == 1.3 and set(params) <= set(model.start())
    plain, _ = model.of_camera(Recipe(model.camera("RGGB", model.Design()), {}))
    assert plain == {
        "demosaic": model.DEMOSAICKERS[0], "mixed": None, "passes": 0, "median": None, "lens": False
    }  # fmt: skip
    with pytest.raises(InputError, match="no camera from `jaxisp fit`"):
        model.of_camera(phone())


@pytest.mark.parametrize("name", model.DEMOSAICKERS)
def test_a_camera_s_file_keeps_its_demosaicker(name):
    camera = Recipe(model.camera("GRBG", model.Design(name)), {})
    choices, _ = model.of_camera(Recipe.from_toml(camera.to_toml()))
    assert choices["demosaic"] == name and name in model.demosaickers()


@pytest.mark.parametrize(
    ("name", "mixed"), [("demosaic_rcd", "demosaic_ahd_libraw"), ("demosaic_ahd_libraw", "demosaic_malvar")]
)
def test_a_camera_s_file_keeps_the_two_demosaickers_that_it_mixes(name, mixed):
    design = model.Design(name, passes=1, mixed=(mixed, 0.25))
    camera = Recipe(model.camera("GRBG", design), model.shares(design))
    choices, _ = model.of_camera(Recipe.from_toml(camera.to_toml()))
    assert (choices["demosaic"], choices["mixed"]) == (name, (mixed, 0.25))
    assert model.head("GRBG", design).reach is not None  # large frames are rendered in strips


def test_a_start_brings_the_stages_that_were_inserted():
    inserted = (
        *map(model.insertion, ("hue_rotation", "black_level")),
        model.insertion("highlight_rolloff@saturation"),
    )
    whole = model.camera("RGGB", model.Design(inserted=inserted))
    meta = {"inserted": [node.name for node, _ in inserted]}
    camera = Recipe(whole, {"hue_rotation": HueRotation(angle=20.0)}, meta=meta)
    found = model.inserted_in(camera)
    assert model.camera("RGGB", model.Design(inserted=found)) == whole and set(found) == set(inserted)
    _, params = model.of_camera(camera, found)
    assert float(params["hue_rotation"].angle) == 20 and "highlight_rolloff" in params
    with pytest.raises(InputError, match="no RAW"):  # all names are known
        fit_examples([], start=camera, freeze="hue_rotation", per_image="highlight_rolloff.white")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"freeze": "bilatral"}, "is it bilateral"),
        ({"freeze": [3]}, "no fitted parameter is named 3; there are tone, colour, "),
        ({"freeze": "tone", "per_image": ["s_curve"]}, r"at once: s_curve.midpoint, s_curve.strength"),
        ({"start": "phone"}, "'phone' is no camera from `jaxisp fit`"),
        ({"insert": "clip"}, "clip is in the camera already"),
        ({"insert": ["hue_rotation", "hue_rotation"]}, "one stage twice"),
        ({"insert": [3]}, "names of stages, or stages, got 3"),
        ({"insert": stage("median")}, "median reads other pixels.*; there are .*hue_rotation"),
        ({"demosaic": "demosaic_adh"}, "no demosaicker; is it .*demosaic_ahd"),
    ],
    ids=str,
)
def test_wrong_options_are_refused_before_a_fit(options, words):
    with pytest.raises(InputError, match=words):
        fit_examples([], **options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hue_rotatoin", "is it hue_rotation"),
        ("hue_rotation@mosaic", "can follow gamma_compression"),
        ("unsharp_mask", "fitted already|reads other pixels"),
        ("median", "reads other pixels"),
        ("film_grain", "draws noise"),
        ("mosaic", "expected a stage on encoded"),
    ],
)
def test_what_cannot_be_inserted_is_refused_before_a_fit(text, words, folder, tmp_path, capsys):
    with pytest.raises(InputError, match=words):
        model.insertion(text)
    status = main(["fit", str(folder), "-o", str(tmp_path / "camera.toml"), "--insert", text])
    assert status == 2 and not (tmp_path / "camera.toml").exists()
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_help_says_how_files_are_named(capsys):
    with pytest.raises(SystemExit):
        main(["fit", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "NAME.dng" in text and "dataset.toml" in text and "--freeze NAMES" in text


def test_the_page_names_what_can_be_frozen_and_inserted():
    rows = (Path(__file__).parents[2] / "docs" / "fitting.md").read_text().splitlines()
    frozen, inserted = (next(r for r in rows if r.startswith(f"| `--{o}`")) for o in ("freeze", "insert"))
    named = set(re.findall(r"`(\w+)`", inserted.split("|")[2])) - {"highlight_rolloff@saturation"}
    assert named == set(model.insertable())
    hidden = {"denoise_encoding", "denoise_decoding"}  # of the method
    assert set(re.findall(r"`(\w+)`", frozen.split("|")[2])) == {*model.start(), *GROUPS} - hidden
