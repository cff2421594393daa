"""A simulator that is given as the base of clean+noisy pairs: what of it is believed, fitted and refused."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from experiments.withheld.numeric import srgb_encode
from experiments.withheld.scenes import scenes
from jaxisp.camera import standard_camera
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base.given import of_recipe
from jaxisp.gap.base.given_camera import of_camera
from jaxisp.gap.base.given_chain import check_camera
from jaxisp.gap.base.mean import MeanFit
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.effects import candidates
from jaxisp.pipeline import Chain, Gate, Shuffle, Switch, run, stage
from jaxisp.priors import Bernoulli, Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import find_recipe
from jaxisp.stages.noise import ShotReadNoise
from jaxisp.stages.optics import Vignetting
from jaxisp.stages.sensor import AdcQuantization
from tests.gap.schema import keeps_the_schema

ALL = candidates("clean+noisy")
NOISE = ShotReadNoise(shot=4e-4, read=0.006)


def simulator(*more, prior=None, start=("srgb_eotf",), end=("clip", "srgb_oetf", "rounding")):
    nodes = [*start, *more, "mosaic", "shot_read_noise", "adc_quantization", "demosaic_malvar", *end]
    chain = Chain(tuple(stage(n) if isinstance(n, str) else n for n in nodes), "mine")
    return Recipe(chain, {"shot_read_noise": NOISE, **(prior or {})})


def given(recipe, file=None, cfa="RGGB"):
    return of_recipe(recipe, ALL, cfa, file)


def test_what_a_recipe_draws_is_open_from_its_median_and_within_its_range():
    base = given(find_recipe("phone"), cfa="BGGR")
    opened = {(o.node, o.field): o for o in base.open}
    assert ("shot_read_noise", "shot") in opened and ("unsharp_mask", "sigma") not in opened
    assert float(base.params["shot_read_noise"].read) == pytest.approx(0.05, abs=0.005)
    read = opened["shot_read_noise", "read"].coordinate(base.params).move
    assert read.low == pytest.approx(-0.05, abs=0.005) and read.high == pytest.approx(0.05, abs=0.005)
    level = opened["jpeg_photoshop", "level"]
    assert level.levels == [4, 5, 6, 7] and not level.steady
    assert {s.options["cfa"] for s in base.chain.stages() if "cfa" in s.options} == {"BGGR"}
    assert base.chain.nodes[0].name == "mosaic", "light is linear already"


def test_what_the_header_states_replaces_the_last_compression():
    tables = np.full((3, 8, 8), 7.0)
    file = SimpleNamespace(
        subsampling="4:2:0", tables=tables, color_space="YCbCr", converted=False, space=None
    )
    base = given(find_recipe("phone"), file)
    assert [n.name for n in base.chain.nodes][-2:] == ["rounding", "file"]
    assert "jpeg_photoshop" not in {o.node for o in base.open}


def test_effects_act_on_the_simulators_own_stages():
    vignetting = {"vignetting": Vignetting(a2=-0.4, a4=Uniform(-0.1, 0.1))}
    model, tried, absorbed = given(simulator("vignetting", prior=vignetting)).whole_model(ALL)
    assert [c.move.field for c in model.effects["vignetting"]] == ["a2"], "a4 is open, and in the base"
    assert model.origin(model.effects["vignetting"][0]) == pytest.approx(-0.4)
    assert {c.node for c in model.effects["noise_level"]} == {"shot_read_noise"}
    assert {c.move.field: c.move.low for c in model.effects["noise_level"]} == pytest.approx(
        {"shot": -4e-4, "read": -0.006}
    )
    assert "own_adc_quantization" in {n.name for n in model.chain.nodes}, "it is not the effect's stage"
    assert {"tone_curve", "demosaicking", "noise_level"} <= set(tried) and absorbed == []


def test_at_its_start_the_base_is_the_simulator(rng):
    recipe = simulator(prior={"adc_quantization": AdcQuantization(bits=6.0)})
    base = given(recipe)
    model, _, _ = base.whole_model(ALL)
    light = rng.random((1, 40, 48, 3))
    keys = jax.random.split(jax.random.key(0), 1)
    made = model.render(np.zeros(len(model.coordinates)), jnp.asarray(light, jnp.float32), keys)[0]
    seen = jnp.asarray(srgb_encode(light[0]), jnp.float32)
    wanted = np.asarray(run(recipe.chain, recipe.draw(keys[0]), seen, keys[0]))
    assert np.mean(np.abs(made - wanted) > 0.5 / 255) < 0.01, "but for a level that falls on the other side"


def test_constant_switches_and_orders_are_followed():
    gate = Gate(stage("median"))
    order = Shuffle((stage("clip", name="a"), stage("clip", name="b")))
    prior = {"use_median": Switch(on=0.0)}
    names = [n.name for n in given(simulator(gate, order, prior=prior)).chain.nodes]
    assert names[:3] == ["a", "b", "mosaic"]


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (find_recipe("awgn"), "0 stages that make a mosaic"),
        (find_recipe("unprocessing"), "its mosaic within 'unprocessed'"),
        (simulator(end=("clip",)), "into camera RGB"),
        (simulator(start=()), "needs encoded sRGB into encoded sRGB"),
        (simulator(Gate(stage("median")), prior={"use_median": Switch(on=Bernoulli(0.5))}), "at random"),
    ],
)
def test_what_cannot_be_a_base_is_refused(recipe, message):
    with pytest.raises(InputError, match=message):
        given(recipe)


def test_a_camera_takes_a_mosaic():
    with pytest.raises(InputError, match="needs mosaic into encoded sRGB"):
        check_camera(find_recipe("phone"))


def test_what_stands_for_the_clean_light_goes_to_the_sensor_as_that_does(rng):
    light = jnp.asarray(rng.uniform(0.05, 0.8, (2, 40, 40, 3)), jnp.float32)
    plain = Camera(None)
    model = plain.mean_model({})
    pictures = model.render(np.zeros(len(model.coordinates)), light)
    pairs = Pairs(("a", "b"), light, pictures, np.ones((2, 40, 40), bool), light[::-1])
    objective = PixelObjective.of(pairs)
    mean = MeanFit(plain, objective, objective.at(model, np.zeros(len(model.coordinates))))
    _, seen = of_camera(standard_camera(), ALL, mean)
    assert not np.allclose(seen.light, light, atol=0.02)
    np.testing.assert_allclose(seen.again, seen.light[::-1], atol=1e-6)


def write(folder, recipe, gain, count=4, size=128):
    """Pairs that a recipe made of light that NumPy has changed before."""
    params = recipe.draw(jax.random.key(0))
    for i, (name, light) in enumerate(scenes("one", size, count).items()):
        seen = jnp.asarray(srgb_encode(light * gain[..., None]), jnp.float32)
        noisy = np.asarray(run(recipe.chain, params, seen, jax.random.key(i)))
        for ending, a in ((".clean.png", srgb_encode(light)), (".noisy.png", noisy)):
            Image.fromarray(np.rint(255 * np.clip(a, 0, 1)).astype(np.uint8)).save(folder / (name + ending))


def radial(size=128):
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return 1 - 0.35 * (y**2 + x**2) / (2 * (size / 2) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("lacking", ["nothing", "vignetting"])
def test_what_a_simulator_lacks_is_named(tmp_path, lacking):
    recipe = simulator()
    write(tmp_path, recipe, radial() if lacking == "vignetting" else np.ones((128, 128)))
    tried = ("vignetting", "film_grain", "tone_curve", "row_noise")
    report = diagnose(tmp_path, recipe=recipe, exclude=sorted(set(EFFECTS) - set(tried))).report
    keeps_the_schema(report)
    assert report["base"]["given"] == "recipe mine" and report["base"]["fitted"].keys() <= {"demosaicking"}
    causes = [c["effect"] for c in report["causes"]]
    assert causes == ([] if lacking == "nothing" else ["vignetting"]), report["ranking"]
    if causes:
        assert report["causes"][0]["params"]["a2"] == pytest.approx(np.log2(0.65), abs=0.15)


def test_the_command_refuses_in_one_line(tmp_path, capsys):
    write(tmp_path, simulator(), np.ones((128, 128)), count=1)
    assert main(["diagnose", str(tmp_path), "-o", str(tmp_path / "o"), "--recipe", "awgn"]) == 2
    error = capsys.readouterr().err
    assert "phone-bilinear" in error and error.count("\n") == 1
    (tmp_path / "mine.toml").write_text(simulator().to_toml())
    both = ["--recipe", str(tmp_path / "mine.toml"), "--camera", str(tmp_path / "mine.toml")]
    assert main(["diagnose", str(tmp_path), "-o", str(tmp_path / "o"), *both]) == 2
    assert "not both" in capsys.readouterr().err
