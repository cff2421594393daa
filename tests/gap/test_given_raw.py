"""A camera that is given as the base of RAW+JPEG pairs: what of it is believed, and what it cannot be."""

import json
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from experiments.withheld.scenes import scenes
from jaxisp.camera import standard_camera, with_cfa
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit import model as fitted
from jaxisp.gap import EFFECTS
from jaxisp.gap.base.given_light import MATRIX, TONE
from jaxisp.gap.base.raw_jpeg import camera_model, raw_case
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.search.verdict import searched
from jaxisp.gap.simulator.effects import candidates
from jaxisp.io import Raw, open_dataset
from jaxisp.io.datasets import Loaded
from jaxisp.io.settings import Settings
from jaxisp.pipeline import Chain, Gate, Switch, run, stage
from jaxisp.priors import Uniform
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import Saturation
from jaxisp.stages.optics import Vignetting
from tests.gap.schema import keeps_the_schema

ALL = candidates("raw+jpeg")
SEARCHED = {e.name for e in ALL if all(m.grid for m in e.moves)}
PLAIN = Recipe(Chain(tuple(map(stage, ("clip", "demosaic_bilinear", "srgb_oetf", "rounding"))), "plain"), {})


def but(*names):
    """What is excluded for these effects to be tried."""
    return sorted(set(EFFECTS) - set(names))


def pair(jpeg=None, cfa="GRBG", **more):
    mosaic = np.random.default_rng(0).uniform(0.3, 0.5, (64, 64)).astype(np.float32)
    raw = Raw(Path("a"), mosaic, cfa, np.zeros(4), 1.0, np.ones(3), (0, 0, 64, 64), (0, 0, 64, 64), **more)
    return Loaded("a", np.zeros((64, 64, 3), np.float32), jpeg, raw, None, Settings(), False, None)


def camera(*nodes, prior=None, end=("srgb_oetf", "rounding")):
    nodes = ["demosaic_malvar", *nodes, *end]
    return Recipe(Chain(tuple(stage(n) if isinstance(n, str) else n for n in nodes), "mine"), prior or {})


def render(model, mosaic):
    return model.render(np.zeros(len(model.coordinates)), jnp.asarray(mosaic)[None])[0]


def wanted(recipe, mosaic):
    chain = with_cfa(recipe.chain, "GRBG")
    return np.clip(run(chain, recipe.prior, jnp.asarray(mosaic)), 0, 1)


def test_each_form_that_the_fit_gives_a_camera_is_a_base():
    """Its stages keep their values, whatever effects are called, and each effect has its own to act on."""
    start = fitted.start()
    for design in (
        fitted.Design(lens=True, sampling=True, median="3x3"),
        fitted.Design(passes=1, place="encoded"),
        fitted.Design("demosaic_rcd", mixed=("demosaic_ppg", 0.35)),
    ):
        chain = fitted.camera("GRBG", design)
        values = {name: start[name] for name in chain.init() if name in start}
        recipe = Recipe(chain, values | fitted.shares(design) | {"vignetting": Vignetting(a2=0.3)})
        model = camera_model(recipe, [pair()], ALL)
        for i, c in enumerate(model.coordinates):
            assert hasattr(model.shared[c.node], c.move.field), c
            assert model.ranges[0, i] <= 0 <= model.ranges[1, i] or c.move.grid, (
                "the base is a point of its own"
            )
        assert model.origin(model.effects["vignetting"][0]) == pytest.approx(0.3)


def test_a_camera_that_mixes_two_demosaickers_keeps_their_shares_and_others_can_have_some():
    design = fitted.Design("demosaic_bilinear", mixed=("demosaic_hibbard", 0.35))
    head = fitted.head("GRBG", design).nodes[-1]
    recipe = Recipe(Chain((head, stage("srgb_oetf"), stage("rounding")), "mine"), fitted.shares(design))
    given = pair()
    model = camera_model(recipe, [given], ALL)
    np.testing.assert_allclose(
        render(model, given.raw.mosaic), wanted(recipe, given.raw.mosaic), atol=1.01 / 255
    )
    shares = np.asarray(model.shared["demosaicking"].shares)
    assert shares.max() == np.float32(0.35) and len(model.effects["demosaicking"]) > 1


def test_an_effect_moves_within_the_bounds_of_the_cameras_own_stage():
    end = ("srgb_oetf", "saturation", "chroma_subsampling", "rounding")
    full = camera(prior={"saturation": Saturation(amount=1.5)}, end=end)
    model = camera_model(full, [pair()], ALL)
    (saturation,) = model.effects["saturation"]
    assert model.origin(saturation) + saturation.move.low >= 0
    assert {c.move.field for c in model.effects["chroma_subsampling"]} == {"sampled", "repeated"}


def test_what_each_file_states_stays_apart_from_an_effect():
    matrix = np.array([[1.5, -0.4, -0.1], [-0.2, 1.4, -0.2], [0, -0.5, 1.5]])
    given = pair(camera_to_srgb=matrix)
    model = camera_model(standard_camera("demosaic_bilinear"), [given], ALL)
    z = np.zeros(len(model.coordinates))
    z[model.indices(["color_matrix"])[1]] = 0.1
    light = jnp.asarray(given.raw.mosaic)[None]
    assert np.abs(model.render(z, light) - model.render(0 * z, light)).max() > 0.01
    assert "own_color_matrix" in model.per_pair


@pytest.mark.parametrize("stated", ["by the file", "by the camera's encoder"])
def test_chroma_is_sampled_as_it_is_stated(stated):
    """The encoder itself is no part of the base; what it does to the resolution of chroma is."""
    by_file = stated == "by the file"
    given = pair(SimpleNamespace(subsampling="4:2:0") if by_file else None)
    encoder = () if by_file else (stage("jpeg_tables", subsampling="4:2:0"),)
    model = camera_model(camera(end=("srgb_oetf", "rounding", *encoder)), [given], ALL)
    full = jnp.asarray(render(camera_model(camera(), [pair()], ALL), given.raw.mosaic))
    halved = run(stage("chroma_subsampling"), stage("chroma_subsampling").init(), full)
    np.testing.assert_allclose(render(model, given.raw.mosaic), np.clip(halved, 0, 1), atol=2e-6)


def test_an_unknown_demosaicker_is_believed():
    own = camera_model(
        Recipe(Chain((stage("demosaic_ahd", variant="libraw"), stage("srgb_oetf")), "own"), {}), [pair()], ALL
    )
    assert "demosaicking" not in own.effects and "crosstalk" in own.effects


def test_switches_that_are_constant_are_followed():
    recipe = camera(
        Gate(stage("vignetting")), prior={"use_vignetting": Switch(on=1.0), "vignetting": Vignetting(a2=0.4)}
    )
    given = pair()
    made = render(camera_model(recipe, [given], ALL), given.raw.mosaic)
    assert np.abs(made - wanted(recipe, given.raw.mosaic)).max() < 0.51 / 255


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (camera("vignetting", prior={"vignetting": Vignetting(a2=Uniform(0, 1))}), "vignetting draws"),
        (camera(end=("srgb_oetf", "film_grain")), "film_grain draws at random"),
        (camera(end=()), "needs mosaic into encoded sRGB"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_base_is_refused(recipe, message):
    with pytest.raises(InputError, match=message):
        camera_model(recipe, [pair()], ALL)


def test_raws_of_two_patterns_are_refused():
    with pytest.raises(InputError, match="different colour filter arrays"):
        camera_model(PLAIN, [pair(), pair(cfa="RGGB")], ALL)


def write(folder, change=lambda mosaic: mosaic, count=4, size=96):
    """Pairs of which the camera is `PLAIN`, but for what is done to the mosaic before, by NumPy."""
    for name, light in scenes("one", size, count).items():
        mosaic = light[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = light[::2, ::2, 0], light[1::2, 1::2, 2]
        np.save(folder / f"{name}.raw.npy", mosaic.astype(np.float32))
        made = np.clip(run(PLAIN.chain, PLAIN.prior, jnp.asarray(change(mosaic), jnp.float32)), 0, 1)
        Image.fromarray(np.rint(255 * made).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "dataset.toml").write_text(
        '[raw]\ncfa = "RGGB"\nblack = 0.0\nwhite = 1.0\nwhite_balanced = true\n'
    )
    return folder


def searched_for(folder, *effects):
    """What a search for these beside `PLAIN` finds, and the gap before it."""
    loaded = [pair.load() for pair in open_dataset(folder).pairs]
    case = raw_case(loaded, PLAIN, but(*effects), lambda *_: None)
    gap = case.gap()
    return searched(case, gap, lambda *_: None), case, gap


@pytest.mark.parametrize(
    "effect",
    [pytest.param(n, marks=[pytest.mark.slow] * (n != "highlight_clipping")) for n in sorted(SEARCHED)],
)
def test_effects_that_are_searched_for_are_refitted_beside_a_camera(tmp_path, effect):
    """They alone are tried: no number is fitted by its derivative."""
    found, case, _ = searched_for(write(tmp_path, lambda m: np.minimum(m, 0.55)), effect)
    assert {c.node for c in case.point.model.base} == {TONE, MATRIX} and case.given == "camera plain"
    if effect == "highlight_clipping":
        ((cause, _),) = found.causes
        white = case.point.model.params(cause.z)["highlight_clipping"].white
        assert white == pytest.approx(0.55, abs=0.03) and cause.closed > 0.75


@pytest.mark.parametrize("power", [1.0, 1.5])
def test_nothing_is_tried_beside_a_camera(tmp_path, power):
    found, case, gap = searched_for(write(tmp_path, lambda m: m**power, count=2))
    assert found.causes == [] and case.offered == []
    assert gap.exceeds(CRITERIA["raw+jpeg"].null_excess) == (power != 1.0)


@pytest.mark.slow
@pytest.mark.optimised
def test_a_camera_that_was_fitted_is_diagnosed_with(tmp_path, capsys):
    """By the commands, as a user calls them."""
    folder, file = write(tmp_path, count=2), tmp_path / "camera.toml"
    fit = ["fit", str(folder), "-o", str(file), "--steps", "2"]
    assert main([*fit, "--demosaic", "demosaic_bilinear", "--median", "none"]) == 0
    out = tmp_path / "out"
    call = ["diagnose", str(folder), "-o", str(out), "--camera", str(file), "--json"]
    assert (
        main([*call, "--exclude", ",".join(but("lateral_chromatic_aberration", "highlight_clipping"))]) == 0
    )
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    keeps_the_schema(report)
    assert report["base"]["given"] == "camera fitted"
