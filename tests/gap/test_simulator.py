"""The simulator of a diagnosis as a recipe: a camera to develop with, or what changes a picture."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.camera import develop, standard_camera
from jaxisp.gap.base.plain_raw import choices
from jaxisp.gap.base.raw_jpeg import camera_model
from jaxisp.gap.report.simulator import simulator_of
from jaxisp.gap.simulator.choices import encoder_of
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.model import build, plain_camera, plain_freedom
from jaxisp.pipeline import run
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, ChromaSubsampling, Demosaicking
from jaxisp.stages.optics import RectilinearWarp
from tests.gap.test_given_raw import pair

EFFECTS = candidates("raw+jpeg")
GAINS = np.float32([[2.0, 1.0, 1.5], [1.4, 1.0, 2.2]])


def loaded():
    """Two RAW files that state their white balance and matrix."""
    own = pair(camera_to_srgb=np.float32(1.2 * np.eye(3) - 0.2 / 3))
    return [replace(own, raw=replace(own.raw, white_balance=g)) for g in GAINS]


def simulator(model, z, causes=(), **more):
    about = {"encoder": encoder_of(None), "from_file": (*model.per_pair,), "given": None} | more
    case = SimpleNamespace(kind="raw+jpeg", reference_gap=None, split=SimpleNamespace(fit=(0,)), **about)
    return simulator_of(case, SimpleNamespace(model=model, z=z), causes)


def plain(**more):
    """A plain camera, white-balanced after demosaicking, as RAW files state."""
    chain, params = plain_camera("GRBG", **more)
    one = np.ones_like(GAINS)
    per_pair = {"mosaic_white_balance": WhiteBalance(gains=GAINS), "later_balance": WhiteBalance(gains=one)}
    model = build(chain, params, per_pair, plain_freedom(), EFFECTS)
    late = choices(model)[2 * list(DEMOSAICKERS).index("hamilton-adams") + 1]
    return model.chosen(late)


def moved(model, effect, value):
    z = np.zeros(len(model.coordinates))
    z[model.indices([effect])[0]] = value
    return z


def same(recipe, model, z):
    """That each RAW is developed as the model renders it, but for the rounding of a file."""
    made = model.render(z, jnp.stack([own.raw.mosaic for own in loaded()]))
    for own, picture in zip(loaded(), made):
        np.testing.assert_allclose(255 * develop(own.raw, recipe), 255 * picture, atol=0.51)


def test_white_balance_after_demosaicking_is_taken_from_each_file():
    model = plain()
    z = moved(model, "vignetting", -0.4)
    recipe = simulator(model, z, ["vignetting"])
    assert recipe.meta == {"causes": ["vignetting"], "from_file": ["later_balance"]}
    names = list(recipe.chain.names())
    assert "demosaic_hamilton_adams" in names and "vignetting" in names
    assert not any(name.startswith("use_") or name == "sharpening" for name in names)
    same(recipe, model, z)


def test_of_a_given_camera_all_that_files_state_is_taken_from_them():
    model = camera_model(standard_camera("demosaic_bilinear"), loaded(), EFFECTS)
    z = np.zeros(len(model.coordinates))
    recipe = simulator(model, z, given="camera standard")
    assert {"mosaic_white_balance", "exposure"} <= {*recipe.meta["from_file"]}
    same(recipe, model, z)


def test_gains_that_no_file_states_are_the_cameras():
    model = plain()
    alike = {"later_balance": WhiteBalance(gains=GAINS[[0, 0]])}
    model = replace(model, per_pair=model.per_pair | alike)
    recipe = simulator(model, np.zeros(len(model.coordinates)), from_file=())
    assert "from_file" not in recipe.meta
    assert recipe.prior["later_balance"].gains == pytest.approx(GAINS[0])


def test_lens_tags_of_a_file_are_no_cameras():
    model = plain(warped=True)
    own = jax.tree.map(lambda leaf: np.stack([leaf, 1.01 * np.asarray(leaf)]), RectilinearWarp())
    model = replace(model, per_pair=model.per_pair | {"rectilinear_warp": own})
    recipe = simulator(model, np.zeros(len(model.coordinates)))
    assert "rectilinear_warp" not in recipe.chain.names()


def test_a_mix_of_demosaickers_stays():
    shares = np.zeros(len(DEMOSAICKERS), np.float32)
    shares[[3, 4]] = 0.7, 0.3
    model = plain()
    model = replace(model, shared=model.shared | {"demosaicking": Demosaicking(shares=shares)})
    recipe = simulator(model, np.zeros(len(model.coordinates)))
    assert recipe.prior["demosaicking"].shares == pytest.approx(shares)


def test_the_files_encoder_samples_chroma_once():
    tables = np.full((3, 8, 8), 3.0)
    file = SimpleNamespace(
        subsampling="4:2:0", tables=tables, color_space="YCbCr", converted=False, space=None, icc=None
    )
    model = plain(subsampling="4:2:0")
    z = np.zeros(len(model.coordinates))
    recipe = simulator(model, z, encoder=encoder_of(file))
    assert "chroma_subsampling" not in recipe.chain.names()
    # made by the encoder of what the model makes before its own sampling
    half = {"chroma_subsampling": ChromaSubsampling(horizontal=np.float32(0), vertical=np.float32(0))}
    whole = model.with_shared(model.shared | half)
    made = whole.render(z, jnp.stack([own.raw.mosaic for own in loaded()]))[0]
    wanted = run(*encoder_of(file), jnp.asarray(made))
    np.testing.assert_allclose(develop(loaded()[0].raw, recipe), np.clip(wanted, 0, 1), atol=2e-3)
    # the model's own sampling stays where the file has none
    file.subsampling = "4:4:4"
    kept = simulator(model, z, encoder=encoder_of(file))
    assert "chroma_subsampling" in kept.chain.names()
