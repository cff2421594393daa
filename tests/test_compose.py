"""Recipes as their users change them: new numbers, edits and mixtures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxisp import Chain, InputError, Recipe, run, stage
from jaxisp.domains import EncodedRGB
from jaxisp.generate import degrade_files
from jaxisp.io import write_png
from jaxisp.mixture import Mixture
from jaxisp.params import Leaf, param, parameters
from jaxisp.phase import AnyPhase, CfaPhase
from jaxisp.priors import Bernoulli, Choice, LogUniform, Normal, PowerUniform, Uniform
from jaxisp.recipes import RECIPES, any_phase, find_degradation, find_recipe, mix
from jaxisp.testing import smooth_image
from jaxisp.unprocess import CameraColors, Unprocessed

KEY = jax.random.key(7)
IMAGES = np.stack([smooth_image((16, 16, 3), i) for i in range(4)]).astype(np.float32)


@parameters
class Lift:
    level: Leaf = param(0.0, (-1.0, 1.0), "level")


def lifting():
    """A recipe of one stage, and the list of its traces."""
    traces = []

    def lift(params: Lift, image: EncodedRGB) -> EncodedRGB:
        traces.append(1)
        return image + params.level

    return Recipe(Chain((stage(lift),), "lifting"), {}), traces


@pytest.mark.parametrize(
    "laws",
    [
        (0.25, 0.5),
        (Uniform(0, 0.1), Uniform(0.2, 0.3)),
        (LogUniform(0.1, 0.2), LogUniform(0.3, 0.4)),
        (PowerUniform(0, 0.1, 2), PowerUniform(0.5, 0.6, 1)),
        (Normal(0.1, 0.1, 0, 0.2), Normal(0.4, 0.1, 0.3, 1)),
        (Choice((0, 0.1)), Choice((0.5, 0.75))),
        (Bernoulli(0.0), Bernoulli(1.0)),
    ],
    ids=lambda laws: type(laws[0]).__name__,
)
def test_new_numbers_of_a_prior_do_not_compile_again(laws):
    recipe, traces = lifting()
    for law in laws:
        noisy, _, params = recipe.override(lift={"level": law}).degrade(KEY, IMAGES)
        low, high = law.support if hasattr(law, "support") else (law, law)
        level = np.asarray(params["lift"].level)
        assert (level >= low - 1e-6).all() and (level <= high + 1e-6).all()
        np.testing.assert_allclose(noisy, IMAGES + level[:, None, None, None], atol=1e-6)
    assert len(traces) == 1


def test_a_schedule_in_ones_own_step():
    """The recipe is an argument, or its numbers are computed from the step; neither compiles again."""
    recipe, traces = lifting()

    @jax.jit
    def passed(recipe, images):
        return recipe.degrade(KEY, images)[2]["lift"].level

    @jax.jit
    def computed(step, images):
        now = recipe.override(lift={"level": Uniform(0.1 * step, 0.1 * step + 0.05)})
        return now.degrade(KEY, images)[2]["lift"].level

    for step in range(1, 4):
        now = recipe.override(lift={"level": Uniform(0.1 * step, 0.1 * step + 0.05)})
        outside = now.degrade(KEY, IMAGES)[2]["lift"].level
        np.testing.assert_array_equal(passed(now, IMAGES), outside)
        np.testing.assert_allclose(computed(jnp.float32(step), IMAGES), outside, atol=1e-6)
    assert len(traces) <= 3  # one a program


def test_draws_have_the_same_bits_within_a_program_and_outside():
    law = LogUniform(0.003, 0.06)
    recipe = lifting()[0].override(lift={"level": law})
    inside = jax.jit(lambda images: recipe.degrade(KEY, images)[2]["lift"].level)(IMAGES)
    np.testing.assert_array_equal(inside, recipe.degrade(KEY, IMAGES)[2]["lift"].level)


def test_a_recipe_that_went_through_a_tree_map_is_itself():
    recipe = RECIPES["phone-any"]()
    again = jax.tree.map(lambda number: number, recipe)
    assert again == recipe and again.description == recipe.description


def test_traced_numbers_are_not_written():
    recipe, _ = lifting()
    with pytest.raises(InputError, match="traced"):
        jax.jit(lambda x: recipe.override(lift={"level": x}).to_toml())(0.5)


def names(pipeline):
    return [s.name for s in pipeline.stages()]


def test_editing_a_recipe():
    phone = RECIPES["phone"]()
    shaded = phone.insert(stage("vignetting"), before="mosaic")
    assert names(shaded.chain)[:3] == ["srgb_eotf", "vignetting", "mosaic"]
    assert names(phone.insert(stage("median", name="second"), after="median").chain)[6:8] == [
        "median",
        "second",
    ]
    assert shaded.prior["shot_read_noise"] == phone.prior["shot_read_noise"]
    assert shaded.without("vignetting").named("phone") == phone
    assert phone.without(["median", "clip"]) == phone.without("median", "clip")
    two = [stage("vignetting"), stage("exposure")]
    assert phone.insert(two, before="mosaic") == phone.insert(*two, before="mosaic")
    assert phone.override({"median": {"strength": 0.5}}) == phone.override(median={"strength": 0.5})
    other = phone.replace("demosaic_hibbard", stage("demosaic_ahd", cfa="GRBG"))
    assert names(other.chain) == [
        "demosaic_ahd" if n == "demosaic_hibbard" else n for n in names(phone.chain)
    ]
    assert other.prior["jpeg_photoshop"] == phone.prior["jpeg_photoshop"]
    same = phone.override(bilateral={"chroma_cell": 8, "guide_gamma": 1.0})
    assert dict(same.chain.nodes[7].static)["chroma_cell"] == 8 and same.prior["bilateral"].guide_gamma == 1.0
    assert same.prior["bilateral"].luma_sigma_space == phone.prior["bilateral"].luma_sigma_space
    assert Recipe.from_toml(other.to_toml()) == other
    assert phone.chain.without("median") == phone.without("median").chain
    assert phone.chain.override(median={"footprint": "5x5"}).nodes[6] == stage("median", footprint="5x5")


def test_a_chain_within_may_be_replaced_by_one_of_another_name():
    inner = Chain((stage("clip"), stage("rounding")), "inner")
    chain = Chain((Chain((inner, stage("median")), "whole"),), "outer")
    other = chain.replace("inner", Chain(inner.nodes, "other"))
    assert [n.name for n in other.nodes[0].nodes] == ["other", "median"] and other == chain


def test_an_edited_recipe_says_so():
    """In its name, its text, its files and as a part of a mixture; and runs what is compiled already."""
    phone, (recipe, traces) = RECIPES["phone"](), lifting()
    for edited in (
        phone.override(median={"strength": 0.5}),
        phone.override(median={"footprint": "5x5"}),
        phone.insert(stage("exposure"), before="mosaic"),
        phone.replace("median", stage("median", footprint="5x5")),
        phone.without("median"),
        phone.without("median").without("clip"),
    ):
        assert edited.name == "phone-edited" and repr(edited).startswith("Recipe 'phone-edited': ")
        assert 'name = "phone-edited"' in edited.to_toml() and edited.named("x").name == "x"
    assert phone.override() is phone.without() is phone and phone.override(median={}) is phone
    for wrong, error in ((" ", InputError), (3, TypeError)):
        with pytest.raises(error, match="name"):
            phone.named(wrong)
    loud = recipe.override(lift={"level": 0.5})
    for own in (recipe, loud, loud.named("loud")):
        own.degrade(KEY, IMAGES)
    assert len(traces) == 1
    between = jax.tree.map(lambda a, b: (a + b) / 2, recipe, loud)
    assert between.prior["lift"].level == 0.25
    mixture = mix({recipe: 0.5, loud: 0.25, loud.named("loud"): 0.25})
    assert mixture.names == ("lifting", "lifting-edited", "loud")


def test_editing_what_is_within_a_gate():
    recipe = RECIPES["phone-any"]()
    assert "use_bilateral" not in recipe.without("bilateral").prior
    before = recipe.insert(stage("median", name="second"), before="bilateral").chain.nodes
    assert [n.name for n in before[7:9]] == ["second", "use_bilateral"]
    wavelets = recipe.replace("bilateral", stage("median", name="other"))
    assert "use_other" in wavelets.prior and "bilateral" not in wavelets.prior


def test_what_is_left_out_takes_nothing_of_the_rest_along():
    amwgn = RECIPES["amwgn"]()
    shaded = amwgn.insert(stage("exposure"), before="shot_read_noise")  # 0 EV: nothing changes
    np.testing.assert_array_equal(shaded.degrade(KEY, IMAGES)[0], amwgn.degrade(KEY, IMAGES)[0])


@pytest.mark.parametrize("of", [lambda recipe: recipe, lambda recipe: recipe.chain], ids=["recipe", "chain"])
def test_edits_that_are_refused(of):
    phone = of(RECIPES["phone"]())
    for edit, message in (
        (lambda: phone.without("medain"), "has no stage 'medain'; is it median"),
        (lambda: phone.replace("demosaic", stage("demosaic_ahd")), "has no stage 'demosaic'"),
        (lambda: phone.insert(stage("vignetting")), "one of before= and after="),
        (
            lambda: phone.insert(stage("vignetting"), before="mosaic", after="clip"),
            "one of before= and after=",
        ),
        (lambda: phone.insert("vignetting", before="mosaic"), r"stage\('vignetting'\)\?"),
        (lambda: phone.insert(stage("median"), before="median"), "several are named median"),
        (lambda: phone.without("mosaic"), "takes"),
        (lambda: phone.replace("demosaic_hibbard", stage("demosaic_ahd")), "takes one colour for another"),
        (lambda: phone.override(mosaic={"cfa": "GRBB"}), "one of RGGB"),
        (lambda: phone.override(median={"footprnt": "cross"}), "footprint"),
        (lambda: phone.override(medain={}), "has no stage '?medain'?; is it median"),
        (lambda: phone.without("jpegg"), "has no stage 'jpegg'; is it jpeg_photoshop"),
        (lambda: phone.insert(stage("exposure"), before=stage("mosaic")), "give its name, 'mosaic'"),
        (lambda: phone.override([]), r"override takes dicts by stage, as median={...}, got \[\]"),
        (lambda: phone.override({"median": {}}, median={}), "override was given median twice"),
    ):
        with pytest.raises((InputError, ValueError, TypeError), match=message):
            edit()


def test_a_mixture_gives_each_image_what_its_recipe_gives():
    heavy, light = RECIPES["amwgn"](), RECIPES["awgn"]()
    mixture = mix({heavy: 0.5, "awgn": 0.25, "clean": 0.25})
    images = np.concatenate([IMAGES] * 6)
    noisy, clean, params = mixture.degrade(KEY, images, 3)
    which = np.asarray(params["recipe"])
    assert mixture.names == ("amwgn", "awgn", "clean") and set(which) == {0, 1, 2}
    np.testing.assert_array_equal(clean, images)
    for i, recipe in enumerate((heavy, light)):
        alone, _, drawn = recipe.degrade(KEY, images, 3)
        np.testing.assert_array_equal(noisy[which == i], alone[which == i])
        for mixed, own in zip(jax.tree.leaves(params[recipe.name]), jax.tree.leaves(drawn)):
            np.testing.assert_array_equal(mixed[which == i], own[which == i])
            assert np.isnan(mixed[which != i]).all()
    np.testing.assert_array_equal(noisy[which == 2], images[which == 2])
    np.testing.assert_array_equal(mixture.repeat(KEY, params, images, 3), noisy)
    np.testing.assert_array_equal(mixture.degrade(KEY, images[5:9], 8)[0], noisy[5:9])
    inside = jax.jit(lambda images: mixture.degrade(KEY, images, 3)[0])(images)
    np.testing.assert_array_equal(inside, noisy)


def test_a_mixture_draws_its_shares_and_compiles_once():
    recipe, traces = lifting()
    images = np.zeros((4000, 2, 2, 3), np.float32)
    for share in (0.3, 0.8, 0.0):
        mixture = mix({recipe.override(lift={"level": 0.5 * share}): share, "clean": 1 - share})
        for seed in range(2):
            noisy, _, params = mixture.degrade(jax.random.key(seed), images)
            lifted = np.asarray(params["recipe"]) == 0
            assert abs(lifted.mean() - share) < 5 * (share * (1 - share) / 4000) ** 0.5 + 1e-9
            np.testing.assert_array_equal(noisy[:, 0, 0, 0], np.where(lifted, np.float32(0.5 * share), 0))
    assert len(traces) == 1


def test_a_schedule_of_shares_in_ones_own_step():
    """A mixture is an argument of a jitted step, or its shares are computed there; neither compiles again."""
    recipe, traces = lifting()
    images = np.zeros((64, 2, 2, 3), np.float32)
    lifted = {share: recipe.override(lift={"level": 0.5 * share}) for share in (0.25, 0.5, 0.75)}

    @jax.jit
    def passed(mixture, images):
        return mixture.degrade(KEY, images)[0]

    @jax.jit
    def computed(share, images):
        now = mix({recipe.override(lift={"level": 0.5 * share}): share, "clean": 1 - share})
        return now.degrade(KEY, images)[0]

    for share, own in lifted.items():
        mixture = mix({own: share, "clean": 1 - share})
        outside = mixture.degrade(KEY, images)[0]
        np.testing.assert_array_equal(passed(mixture, images), outside)
        np.testing.assert_array_equal(computed(np.float32(share), images), outside)
    assert len(traces) <= 3  # one a program
    again = jax.tree.map(lambda number: number, mix({own: 0.9, "clean": 0.1}))
    assert again == mix({own: 0.9, "clean": 0.1}) and hash(again) == hash(mix({own: 0.9, "clean": 0.1}))
    assert repr(again) == "mix({'lifting-edited': 0.9, 'clean': 0.1})"
    named = jax.tree.map(lambda number: number, mix({"awgn": 0.9, "clean": 0.1}))
    assert Mixture.from_toml(named.to_toml()) == named == mix({"awgn": 0.9, "clean": 0.1})
    moved = jax.device_put(again)
    assert moved == again and np.array_equal(moved.degrade(KEY, images)[0], again.degrade(KEY, images)[0])
    with pytest.raises(InputError, match="a share for each"):
        jax.jit(lambda share: Mixture({"clean": mix({"clean": 1}).recipes["clean"]}, (share, share)))(0.5)


def test_a_mixture_runs_no_recipe_for_the_images_of_another():
    """A recipe counts its images as they are computed."""
    seen = []

    def counted(image: EncodedRGB) -> EncodedRGB:
        jax.debug.callback(lambda _: seen.append(1), image[0, 0, 0])
        return image

    mixture = mix({Recipe(Chain((stage(counted),), "counted"), {}): 0.25, "clean": 0.75})
    images = np.concatenate([IMAGES] * 16)
    jax.block_until_ready(mixture.degrade(KEY, images))
    jax.effects_barrier()
    own = int((np.asarray(mixture.degrade(KEY, images)[2]["recipe"]) == 0).sum())
    jax.effects_barrier()
    assert 0 < own < 30 and 2 * own <= len(seen) < 2 * (own + len(images) // 8)


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ({"phone": 0.5}, "sum to 1"),
        ({"phone": 1.5, "awgn": -0.5}, "0 or more"),
        ({"fone": 1.0}, "no recipe named 'fone'"),
        ({"phone": 0.5, RECIPES["phone"](): 0.5}, "two recipes of a mixture are named 'phone'"),
        ({Recipe(Chain((stage("srgb_eotf"),), "linear"), {}): 1.0}, "not photographs"),
        ({}, "a share for each"),
        ({"phone": "all"}, "must be numbers"),
        ({"phone": None}, "must be numbers"),
        ({3: 1.0}, "a recipe is a Recipe, a Chain, a name"),
        ({mix({"awgn": 1.0}): 1.0}, "several recipes: give one of them"),
        (["phone"], "shares by recipe"),
    ],
    ids=str,
)
def test_mixtures_that_are_refused(shares, message):
    with pytest.raises(InputError, match=message):
        mix(shares)


@pytest.mark.parametrize("phase", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_phase_is_the_pattern_seen_from_there(phase):
    """Against the static pattern, named by hand; within borders, where either reflects otherwise."""
    seen = {(0, 0): "GRBG", (0, 1): "RGGB", (1, 0): "BGGR", (1, 1): "GBRG"}[phase]
    image = np.random.default_rng(1).random((21, 24, 3), np.float32)

    def sensor(cfa):
        return Chain((stage("mosaic", cfa=cfa), stage("demosaic_malvar", cfa=cfa)))

    node = AnyPhase(sensor("GRBG"))
    got = run(node, {"cfa_phase": CfaPhase(row=np.float32(phase[0]), column=np.float32(phase[1]))}, image)
    np.testing.assert_allclose(got[4:-4, 4:-4], run(sensor(seen), {}, image)[4:-4, 4:-4], atol=1e-6)
    assert got.shape == image.shape


def test_phases_are_drawn_for_each_image():
    recipe = find_recipe("phone-bilinear-phases")
    assert recipe == any_phase(RECIPES["phone-bilinear"]()) and recipe != RECIPES["phone-bilinear"]()
    assert Recipe.from_toml(recipe.to_toml()) == recipe
    quiet = recipe.override(shot_read_noise={"shot": 0.0, "read": 0.0})
    # red light alone: with no noise, the photosites that see it are those of the drawn phase
    red = np.zeros((32, 8, 8, 3), np.float32)
    red[..., 0] = np.random.default_rng(0).random((32, 8, 8))
    noisy, _, params = quiet.degrade(KEY, red)
    row, column = (np.asarray(v) > 0.5 for v in (params["cfa_phase"].row, params["cfa_phase"].column))
    assert len(set(zip(row, column))) == 4
    for i in range(32):
        # GRBG: red is in the cell's first row, second column
        y, x = int(row[i]) % 2, int(1 - column[i]) % 2
        at = (i, slice(2 + y, 6, 2), slice(2 + x, 6, 2), 0)
        np.testing.assert_allclose(noisy[at], red[at], atol=3e-3)
    np.testing.assert_array_equal(quiet.repeat(KEY, params, red), noisy)
    edited = recipe.without("sensor_clip").insert(stage("black_level"), before="shot_read_noise")
    assert names(edited.chain)[1:4] == ["mosaic", "black_level", "shot_read_noise"]
    with pytest.raises(InputError, match="has no mosaic"):
        find_recipe("awgn-phases")
    with pytest.raises(InputError, match="draws already where"):
        any_phase("any-camera")
    with pytest.raises(InputError, match="draws already where"):
        any_phase(recipe)


@pytest.mark.parametrize("phase", [(0, 1), (1, 1)])
def test_a_phase_within_unprocessed_moves_gains_and_mosaic_alike(phase):
    """Against the static pattern, named by hand; highlights, gains and matrix as there."""
    seen = {(0, 1): "GRBG", (1, 1): "BGGR"}[phase]
    image = np.random.default_rng(2).random((20, 23, 3), np.float32)

    def sensor(cfa):
        return Unprocessed(Chain((stage("mosaic", cfa=cfa), stage("demosaic_bilinear", cfa=cfa))))

    colors = {"unprocessed": CameraColors(red=np.float32(2.3), blue=np.float32(1.6), dimming=np.float32(0.9))}
    place = {"cfa_phase": CfaPhase(row=np.float32(phase[0]), column=np.float32(phase[1]))}
    got = run(AnyPhase(sensor("RGGB")), colors | place, image)
    np.testing.assert_allclose(got[4:-4, 4:-4], run(sensor(seen), colors, image)[4:-4, 4:-4], atol=1e-5)


@pytest.mark.parametrize("name", ["unprocessing", "rsblur", "bsrgan", "phone-any"])
def test_a_mosaic_is_found_wherever_it_stands(name):
    recipe, before = any_phase(name), RECIPES[name]()
    assert set(recipe.prior) == {*before.prior, "cfa_phase"}
    assert names(recipe.chain) == names(before.chain)
    assert Recipe.from_toml(recipe.to_toml()) == recipe == find_recipe(name, phases=True)
    assert recipe.chain.nodes[-1] == before.chain.nodes[-1] and repr(recipe).count("(AnyPhase)") == 1


def test_two_mosaics_have_no_one_phase():
    sensor = stage("mosaic"), stage("demosaic_bilinear")
    again = stage("mosaic", name="again"), stage("demosaic_bilinear", name="again_demosaicked")
    with pytest.raises(InputError, match="has 2 mosaics"):
        any_phase(Chain((*sensor, *again), "two"))


def test_a_mixture_over_devices():
    """In a user's own `shard_map`, and on a mesh of explicit axes: the same bits as on one device."""
    images = np.concatenate([IMAGES] * 2)
    mixture = mix({"amwgn": 0.5, "clean": 0.5})
    alone = np.asarray(mixture.degrade(KEY, images)[0])
    devices, rows = np.array(jax.devices()[:2]), PartitionSpec("batch")
    if len(devices) < 2:
        pytest.skip("one device")

    def own(images, indices):
        return mixture.degrade(KEY, images, indices)[0]

    plain = jax.jit(jax.shard_map(own, mesh=Mesh(devices, ("batch",)), in_specs=(rows, rows), out_specs=rows))
    np.testing.assert_array_equal(plain(images, np.arange(8, dtype=np.int32)), alone)
    mesh = Mesh(devices, ("batch",), axis_types=(AxisType.Explicit,))
    spread = jax.device_put(images, NamedSharding(mesh, rows))
    np.testing.assert_array_equal(mixture.degrade(KEY, spread)[0], alone)


def test_a_mixture_reads_back_and_runs_as_it_was(tmp_path):
    mixture = mix({"awgn": 0.6, "amwgn": 0.25, "clean": 0.15})
    mixture.save(tmp_path / "mine.toml")
    again = find_degradation(str(tmp_path / "mine.toml"))
    assert again == mixture and again.to_toml() == mixture.to_toml() and hash(again) == hash(mixture)
    assert find_degradation("awgn=0.6, amwgn=0.25, clean=0.15") == mixture
    assert find_degradation("awgn") == find_recipe("awgn")
    for text, words in (
        ("awgn=0.6,amwgn", "no share of a mixture"),
        ("awgn=0.6,amwgn=0.6", "sum to 1"),
        ("magic=1", "no recipe named 'magic'"),
    ):
        with pytest.raises(InputError, match=words):
            find_degradation(text)
    broken = mixture.to_toml().replace("share = 0.6", "share = 0.7")
    with pytest.raises(InputError, match=r"mine: shares of a mixture"):
        Mixture.from_toml(broken, "mine")
    with pytest.raises(InputError, match=r"each .*has a share"):
        Mixture.from_toml("[[mixture]]\nshare = 1.0\n", "mine")


def test_a_folder_degraded_by_a_mixture_can_be_made_again(tmp_path):
    """Each image's TOML is the recipe that it had, with the parameters that were drawn."""
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    write_png(photographs / "a.png", smooth_image((32, 32, 3)))
    mixture = find_degradation("awgn=0.5,clean=0.5")
    degrade_files([photographs], tmp_path / "out", mixture, count=6, seed=2)
    names = [Recipe.load(tmp_path / "out" / f"a_{i:03d}.toml").name for i in range(6)]
    assert set(names) == {"awgn", "clean"}
    for i, name in enumerate(names):
        own = find_degradation(str(tmp_path / "out" / f"a_{i:03d}.toml"))
        degrade_files([photographs / "a.png"], tmp_path / f"again{i}", own, seed=2, start=i)
        first, second = (
            p.read_bytes()
            for p in (tmp_path / "out" / f"a_{i:03d}.noisy.png", tmp_path / f"again{i}" / "a_000.noisy.png")
        )
        assert first == second, name
