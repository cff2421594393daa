"""Recipes for training data out of fitted cameras."""

import dataclasses
import json

import jax
import numpy as np
import pytest

from jaxisp.camera import standard_camera
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit import model, prior_from_cameras
from jaxisp.generate import degrade_files
from jaxisp.io import write_png
from jaxisp.pipeline import Chain, stage
from jaxisp.recipe import Recipe
from jaxisp.samples import scene
from jaxisp.stages.choice import ChromaSubsampling
from tests.fit.test_fitter import psnr

pytestmark = pytest.mark.optimised  # the fit that they start from is the fitter's tests' own


@pytest.mark.slow
def test_a_prior_of_fitted_cameras_degrades_photographs(result, tmp_path, capsys):
    result.camera.save(tmp_path / "camera.toml")
    recipe = prior_from_cameras([tmp_path / "camera.toml", result.camera])
    recipe.save(tmp_path / "prior.toml")
    loaded = Recipe.load(tmp_path / "prior.toml")
    assert loaded == recipe
    several = ["recipe", str(tmp_path / "camera.toml"), str(tmp_path / "camera.toml"), "--json"]
    assert main([*several, "-o", str(tmp_path / "several.toml")]) == 0
    assert json.loads(capsys.readouterr().out)["recipe"] == str(tmp_path / "several.toml")
    joined = Recipe.load(tmp_path / "several.toml")
    assert joined.chain.nodes == recipe.chain.nodes
    assert vars(joined.prior["shot_read_noise"]) == vars(recipe.prior["shot_read_noise"])
    assert main(["recipe", str(tmp_path / "prior.toml"), "-o", str(tmp_path / "none.toml")]) == 2
    assert "is no camera from `jaxisp fit`" in capsys.readouterr().err
    clean = np.float32(scene("coffee", (48, 64))) ** (1 / 2.2)
    write_png(tmp_path / "clean.png", clean)
    assert degrade_files([tmp_path / "clean.png"], tmp_path / "out", loaded, count=2).images == 2
    noisy, _, _ = loaded.degrade(jax.random.key(0), np.stack([clean] * 3))
    noisy = np.asarray(noisy)
    assert np.isfinite(noisy).all() and 15 < psnr(noisy[0], clean) < 45
    assert (noisy[0] != noisy[1]).any()
    stated, noise = result.camera.meta["raw_noise"], recipe.prior["shot_read_noise"]
    assert not stated["measured"][0]
    np.testing.assert_allclose((noise.shot.low, noise.shot.high), np.multiply(stated["shot"], (1 / 4, 4)))
    np.testing.assert_allclose((noise.read.low, noise.read.high), np.multiply(stated["read"], (1 / 2, 2)))
    np.testing.assert_allclose(recipe.prior["mosaic_white_balance"].gains, stated["gains"][0], rtol=1e-6)
    with pytest.raises(InputError, match="at least one camera"):
        prior_from_cameras([])


def test_chroma_is_halved_before_the_picture_is_rounded(result):
    """A camera whose file stated no tables halves chroma itself."""
    nodes = list(result.camera.chain.without("jpeg_tables").nodes)
    at = [node.name for node in nodes].index("unsharp_mask") + 1
    nodes.insert(at, stage("chroma_subsampling"))
    prior = {k: v for k, v in result.camera.prior.items() if k != "jpeg_tables"}
    halving = {"chroma_subsampling": ChromaSubsampling(horizontal=np.float32(1), vertical=np.float32(1))}
    recipe = prior_from_cameras([Recipe(Chain(tuple(nodes)), prior | halving, meta=result.camera.meta)])
    names = [node.name for node in recipe.chain.nodes]
    assert names[-3:] == ["chroma_subsampling", "output_clip", "rounding"]


def test_a_prior_keeps_the_two_demosaickers_that_a_camera_mixes(result):
    design = model.Design("demosaic_bilinear", mixed=("demosaic_hibbard", 0.35))
    mix, shares = model.head("RGGB", design).nodes[-1], model.shares(design)
    nodes = [mix if n.name.startswith("demosaic") else n for n in result.camera.chain.nodes]
    camera = Recipe(Chain(tuple(nodes)), result.camera.prior | shares, meta=result.camera.meta)
    recipe = prior_from_cameras([camera, result.camera])
    assert mix in recipe.chain.nodes
    np.testing.assert_array_equal(recipe.prior["demosaicking"].shares, shares["demosaicking"].shares)
    assert "differ in their stages: demosaicking" in recipe.description


def test_a_camera_that_does_not_sharpen_is_no_camera_of_a_fit():
    with pytest.raises(InputError, match="is no camera from `jaxisp fit`: it has no unsharp_mask"):
        prior_from_cameras([standard_camera()])


def test_a_prior_says_which_camera_its_stages_are_of(result):
    text = result.camera.to_toml()
    names = [node.name for node in result.camera.chain.nodes]
    demosaicker = next(name for name in names if name.startswith("demosaic_"))
    another = "demosaic_bilinear" if demosaicker != "demosaic_bilinear" else "demosaic_malvar"
    changed = Recipe.from_toml(text.replace(demosaicker, another), "other")
    recipe = prior_from_cameras([changed, result.camera])
    assert f"differ in their stages: {another}" in recipe.description
    assert another in [node.name for node in recipe.chain.nodes]
    assert "differ" not in prior_from_cameras([result.camera] * 2).description

    without = dataclasses.replace(
        changed,
        chain=Chain(tuple(n for n in changed.chain.nodes if n.name != "jpeg_tables"), "raw only"),
        prior={name: values for name, values in changed.prior.items() if name != "jpeg_tables"},
    )
    assert "jpeg_tables" in names, "the pair's picture is a JPEG"
    joined = prior_from_cameras([without, result.camera])
    assert joined.chain.nodes[-1].name == "jpeg_tables"
    np.testing.assert_array_equal(
        joined.prior["jpeg_tables"].luma_table, result.camera.prior["jpeg_tables"].luma_table
    )


@pytest.mark.parametrize(
    "noted",
    ["hello", {"shot": [1e-3]}, {"shot": "x", "read": [1]}, {"shot": [float("nan")], "read": [1e-3]},
     {"shot": [1e-3], "read": [1e-3], "gains": [[0, 1, 2]]},
     {"shot": [1e-3], "read": [1e-3], "gains": [[1, 2]]}],
)  # fmt: skip
def test_noise_that_no_fit_noted_is_refused(result, noted):
    meta = {**result.camera.meta, "raw_noise": noted}
    with pytest.raises(InputError):
        prior_from_cameras([dataclasses.replace(result.camera, meta=meta)])
