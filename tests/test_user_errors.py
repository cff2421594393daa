"""What is refused where it is written, in words that say what would be right."""

import dataclasses
import importlib
import pickle
import re
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.data import Batches, CleanPatches, DegradedBatches, batches, load_clean, patches
from jaxisp.domains import RGB
from jaxisp.errors import InputError, UnknownStage, meant
from jaxisp.explore import picture_after
from jaxisp.io import write_png
from jaxisp.mixture import Mixture
from jaxisp.options import between
from jaxisp.pipeline import Chain, Gate, Shuffle, run, run_batch, run_in_strips, stage
from jaxisp.priors import Choice, LogUniform, Normal, Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES, find_degradation, find_recipe, mix
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import GaussianNoise, ShotReadNoise
from jaxisp.testing import smooth_image

KEY = jax.random.key(0)
IMAGES = np.stack([smooth_image((16, 18, 3), i) for i in range(2)]).astype(np.float32)

OPTIONS = [
    ("mosaic", {"cfa": "RGBG"}, "option cfa must be one of RGGB, BGGR, GRBG, GBRG, or X-Trans"),
    ("demosaic_hibbard", {"cfa": 3}, "option cfa must be str, got 3"),
    ("bilateral", {"chroma_cell": 3}, "option chroma_cell must be even, got 3"),
    ("bilateral", {"radius": 0}, "option radius must be 1 or more, got 0"),
    ("median", {"footprint": "7x7"}, "option footprint must be one of"),
    ("median", {"luma": 1}, "option luma must be bool, got 1"),
    ("jpeg", {"subsampling": "4:1:1"}, "option subsampling must be one of"),
    ("jpeg", {"row_phase": 16}, "option row_phase must be from 0 to 15, got 16"),
    ("resize", {"factor": 0.0}, "option factor must be positive, got 0.0"),
    ("resize", {"factor": float("nan")}, "option factor must be finite, got nan"),
    ("clip", {"low": 0.3}, "option low must be below 0.3, got 0.3"),
    ("prnu", {"sensor": "a"}, "option sensor must be int or None, got 'a'"),
    ("demosaic_ahd", {"variant": "dcraw"}, "option variant must be one of 'paper', 'libraw', got 'dcraw'"),
]


@pytest.mark.parametrize(("name", "options", "message"), OPTIONS)
def test_a_wrong_option_is_refused_when_the_stage_is_made(name, options, message):
    with pytest.raises(InputError) as refused:
        stage(name, **options)
    assert f"{name}: {message}" in str(refused.value)
    with pytest.raises(InputError):
        dataclasses.replace(stage(name), static=tuple(options.items()))


def test_numpys_numbers_are_options_too():
    assert stage("median", iterations=np.int64(2)) == stage("median", iterations=2)


def test_a_parameter_is_no_option():
    with pytest.raises(TypeError, match=r"jpeg has no option 'quality': it is a parameter, Jpeg\(quality="):
        stage("jpeg", quality=500)


def test_one_pattern_from_the_mosaic_to_demosaicking():
    mosaic, wrong = stage("mosaic", cfa="GRBG"), stage("demosaic_malvar")
    with pytest.raises(ValueError, match="'mosaic' has cfa='GRBG' and 'demosaic_malvar' 'RGGB'"):
        Chain((mosaic, stage("adc_quantization"), wrong))
    with pytest.raises(ValueError, match="'mosaic' has cfa"):
        Chain((Chain((mosaic, stage("clip")), "sensor"), Gate(stage("green_imbalance"))))
    with pytest.raises(ValueError, match="has cfa"):
        Shuffle((stage("green_imbalance", cfa="BGGR"), stage("mosaic_white_balance")))
    with pytest.raises(InputError, match="has cfa"):
        Recipe.from_toml(
            'stages = [{stage = "mosaic"}, {stage = "demosaic_malvar", options = {cfa = "BGGR"}}]'
        )
    twice = (mosaic, stage("demosaic_malvar", cfa="GRBG"), stage("mosaic", name="again"), wrong)
    with pytest.raises(ValueError, match="several are named demosaic_malvar"):  # two sensors may differ
        Chain(twice)
    Chain((*twice[:3], stage("demosaic_malvar", name="second")))


def test_what_is_no_stage():
    for kind in (Chain, Shuffle):
        with pytest.raises(TypeError, match=r"takes stages and pipelines, got 'mosaic': stage\('mosaic'\)"):
            kind(("mosaic", "demosaic_ahd"))
    with pytest.raises(TypeError, match="Gate takes stages and pipelines, got <function"):
        Gate(lambda x: x)


def test_what_is_no_prior():
    chain = RECIPES["amwgn"]().chain
    with pytest.raises(
        InputError, match=r"shot_read_noise must be a ShotReadNoise\(...\), got {'read': 0.1}"
    ):
        Recipe(chain, {"shot_read_noise": {"read": 0.1}})
    with pytest.raises(InputError, match=r"shot_read_noise must be a ShotReadNoise"):
        Recipe(chain, {"shot_read_noise": GaussianNoise()})
    with pytest.raises(InputError, match="has no stage shot_noise; is it shot_read_noise"):
        Recipe(chain, {"shot_noise": ShotReadNoise()})
    with pytest.raises(InputError, match=r"shot_read_noise.shot has the shape .* give Uniform\(0, 0.01\)"):
        Recipe(chain, {"shot_read_noise": ShotReadNoise(shot=(0, 0.01))})
    with pytest.raises(InputError, match=r"shot_read_noise.shot must be a number .* got 'low'"):
        Recipe(chain, {"shot_read_noise": ShotReadNoise(shot="low")})
    with pytest.raises(InputError, match=r"jpeg.quality = 500 is not within \[1, 100\]"):
        Recipe(Chain((stage("jpeg"),)), {"jpeg": Jpeg(quality=500)})


def test_the_numbers_of_a_distribution():
    with pytest.raises(InputError, match=r"Uniform.high must be a number"):
        jax.jit(lambda high: Uniform(0, high).sample(KEY, ()))(jnp.ones(2))
    with pytest.raises(InputError, match=r"LogUniform.low must be a number, got 'a'"):
        LogUniform("a", 1)
    with pytest.raises(InputError, match=r"Choice.values must be numbers"):
        Choice(3)
    assert Uniform(jnp.zeros(()), np.float32(1)) == Uniform(0, 1)
    assert hash(Normal(0, np.float64(1), -1, 1)) == hash(Normal(0.0, 1.0, -1.0, 1.0))


def test_parameters_that_are_missing_or_are_no_dict():
    node, image = stage("jpeg"), IMAGES[0]
    with pytest.raises(
        TypeError, match=r"params must be a dict by stage name, as {'jpeg': Jpeg\(\)}, got Jpeg"
    ):
        run(node, Jpeg(), image)
    with pytest.raises(TypeError, match=r"params\['jpeg'\] must be a Jpeg, got float"):
        run(node, {"jpeg": 75.0}, image)
    chain = Chain((stage("clip"), Gate(stage("gaussian_noise")), Shuffle((stage("unsharp_mask"),))))
    for name in chain.init():
        some = {n: v for n, v in chain.init().items() if n != name}
        for call in (run, run_batch):
            with pytest.raises(TypeError, match=f"params lacks '{name}', a "):
                call(chain, some, image if call is run else IMAGES, KEY)


def test_replacing_a_part_of_a_prior_keeps_the_rest():
    recipe = RECIPES["phone"]()
    noise = ShotReadNoise(shot=0.01, read=Uniform(0.0, 0.02))
    other = dataclasses.replace(recipe, prior={"shot_read_noise": noise})
    assert other.prior == recipe.prior | {"shot_read_noise": noise}
    assert dataclasses.replace(recipe, description="mine").prior == recipe.prior
    shorter = dataclasses.replace(recipe, chain=recipe.chain.without("median", "bilateral"), prior={})
    assert shorter.prior == {n: v for n, v in recipe.prior.items() if n not in ("median", "bilateral")}
    with pytest.raises(InputError, match="has no stage median"):
        dataclasses.replace(recipe, chain=recipe.chain.without("median"))


def test_override():
    recipe = RECIPES["phone"]()
    other = recipe.override(shot_read_noise={"read": Uniform(0.0, 0.02)}, unsharp_mask={"amount": 0.1})
    assert other.prior["shot_read_noise"].read == Uniform(0.0, 0.02)
    assert other.prior["shot_read_noise"].shot == recipe.prior["shot_read_noise"].shot
    assert other.prior["jpeg_photoshop"] == recipe.prior["jpeg_photoshop"] and other != recipe
    assert Recipe.from_toml(other.to_toml()) == other
    for wrong, message in (
        ({"shot_noise": {"read": 0.0}}, "has no stage shot_noise; is it shot_read_noise"),
        ({"shot_read_noise": {"reed": 0.0}}, r"shot_read_noise takes a dict of \['read', 'shot'\]"),
        ({"shot_read_noise": Uniform(0, 1)}, "takes a dict"),
        ({"shot_read_noise": {"read": 9.0}}, "shot_read_noise.read = 9 is not within"),
    ):
        with pytest.raises(InputError, match=message):
            recipe.override(**wrong)


@pytest.mark.parametrize("place", [np.asarray, jnp.asarray], ids=["host", "device"])
def test_the_range_of_a_batch(place):
    recipe = RECIPES["awgn"]()
    for images, message in (
        (255 * IMAGES, "divide 8 bits by 255"),
        (2 * IMAGES - 1, r"for -1 to 1 give \(x \+ 1\) / 2"),
        (np.where(IMAGES > 0.9, np.nan, IMAGES), "NaN"),
        (np.where(IMAGES > 0.9, np.inf, IMAGES), "NaN or infinite"),
    ):
        with pytest.raises(ValueError, match=message):
            recipe.degrade(KEY, place(images))
        with pytest.raises(ValueError, match=message):
            recipe.repeat(KEY, {}, place(images))
    recipe.degrade(KEY, place(1.3 * IMAGES - 0.15))  # a sharpened picture


@pytest.mark.parametrize(
    ("images", "advice"),
    [
        (IMAGES[0], r"\(16, 18, 3\): give one picture as image\[None\]"),
        (np.moveaxis(IMAGES, -1, 1), "move the channels last"),
        (np.uint8(255 * IMAGES), "divide 8 bits by 255"),
        (IMAGES.tolist(), r"got list: give an array"),
        (IMAGES[..., 0], "make three channels of grey"),
        (np.concatenate([IMAGES, IMAGES[..., :1]], -1), r"as images\[..., :3\]"),
    ],
    ids=["one", "channels", "bytes", "list", "grey", "alpha"],
)
def test_the_shape_of_a_batch(images, advice):
    with pytest.raises(TypeError, match=advice):
        RECIPES["awgn"]().degrade(KEY, images)


def test_the_range_of_a_batch_of_a_source():
    class Bytes:
        def batch(self, indices):
            return np.full((len(indices), 8, 8, 3), 128, np.float32)

    with (
        Batches(Bytes(), RECIPES["awgn"](), batch=2) as batches,
        pytest.raises(ValueError, match="divide 8 bits by 255"),
    ):
        next(batches)


def test_a_stage_of_ones_own_has_limits_too():
    def washed(image: RGB, *, share: Annotated[float, between(0, 1)] = 0.5) -> RGB:
        return image * share

    with pytest.raises(InputError, match="washed: option share must be from 0 to 1, got 2"):
        stage(washed, share=2)


def test_a_misspelt_stage_names_the_one_that_is_meant():
    with pytest.raises(KeyError, match="'gausian_noise'; is it gaussian_noise"):
        stage("gausian_noise")
    with pytest.raises(InputError, match=r"'xyzzy'; `jaxisp stages` and jaxisp\.STAGES have"):
        stage("xyzzy")
    assert isinstance(pickle.loads(pickle.dumps(UnknownStage("a"))), KeyError)
    for text, known, hint in (
        ("JPEG", ["jpeg"], "; is it jpeg?"),
        ("phone_any", ["phone", "phone-any"], "; is it phone-any?"),
        ("jpegg", ["clip", "jpeg_photoshop"], "; is it jpeg_photoshop?"),
        ("rgb", ["RGGB"], "; is it RGGB?"),
        ("xyzzy", ["jpeg"], ""),
    ):
        assert meant(text, known) == hint
    for name, options, hint in (
        ("mosaic", {"cfa": "rggb"}, "is it RGGB?"),
        ("median", {"footprint": "cros"}, "is it cross?"),
        ("jpeg", {"subsampling": "420"}, "is it 4:2:0?"),
    ):
        with pytest.raises(InputError, match=re.escape(hint)):
            stage(name, **options)


def test_parameters_of_another_number_of_images_are_told():
    node = stage("unsharp_mask")
    params = {"unsharp_mask": type(node.init()["unsharp_mask"])(amount=np.float32([0.1, 0.2]))}
    with pytest.raises(InputError, match=r"unsharp_mask\.amount has 2 values, one an image, for 3 images"):
        run_batch(node, params, np.full((3, 8, 8, 3), 0.5, np.float32))


def test_an_error_is_one_line_that_can_be_read():
    error = InputError("a.toml: got Chain\n  mosaic\r\n  noise")
    assert str(error) == "a.toml: got Chain mosaic noise" == str(pickle.loads(pickle.dumps(error)))
    assert str(InputError("a  b")) == "a  b" and str(InputError()) == ""
    long = str(InputError(f"a.toml: got {'0, ' * 5000}"))
    assert len(long) == 10_000 and long.startswith("a.toml: got 0, ") and long.endswith("0, 0, ")
    assert str(InputError(f"{'a' * 4000}: cannot be read")).endswith("aaa: cannot be read")


def test_what_a_file_holds_does_not_make_an_error_long(tmp_path):
    path = tmp_path / "a.toml"
    for text in (
        f"[[mixture]]\nshare = {[0] * 5000}\nrecipe = 'awgn'\n",
        "[[stages]]\nname = 'unprocessed'\n[stages.unprocessed]\n"
        "chain = [{stage = 'mosaic'}, {stage = 'crosstalk'}]\n",
    ):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            find_degradation(str(path))
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400


@pytest.mark.parametrize("share", [10**400, "x", None, float("nan")], ids=["large", "text", "None", "nan"])
def test_a_share_that_is_no_number_is_one_error(share):
    with pytest.raises(InputError, match="shares of a mixture must be"):
        Mixture({name: RECIPES[name]() for name in ("awgn", "amwgn")}, (share, 0.5))


@pytest.mark.parametrize(
    "value",
    [
        "0.1",
        b"1",
        None,
        {},
        float("nan"),
        float("inf"),
        True,
        1j,
        np.datetime64("2026-01-01"),
        Uniform,
        [1, [2]],
    ],
    ids=str,
)
def test_what_is_no_number_of_a_prior_is_one_error(value):
    """However it comes: by an edit, a class of parameters, or into what repeats and runs."""
    recipe = RECIPES["amwgn"]()
    told = r"^shot_read_noise\.read must be a number from 0 to 0.2 level, or drawn from such, as Uniform"
    for made in (
        lambda: recipe.override(shot_read_noise={"read": value}),
        lambda: Recipe(recipe.chain, {"shot_read_noise": ShotReadNoise(read=value)}),
    ):
        with pytest.raises(InputError, match=told) as refused:
            made()
        assert len(str(refused.value)) < 200 and "\n" not in str(refused.value)
    if not isinstance(value, float | bool):
        with pytest.raises(InputError, match=r"shot_read_noise\.read must be a number or an array, got "):
            run(stage("shot_read_noise"), {"shot_read_noise": ShotReadNoise(read=value)}, IMAGES[0], KEY)


def test_switches_of_a_prior_may_be_said_as_switches():
    recipe = RECIPES["phone-any"]().override(use_bilateral={"on": True})
    assert recipe.prior["use_bilateral"].on is True
    assert Recipe.from_toml(recipe.to_toml()).prior["use_bilateral"].on == 1


@pytest.mark.parametrize(
    "number", ["0", b"0", None, np.nan, np.inf, [0], 1j, pytest.param(10**400, id="large")]
)
def test_what_is_no_number_of_a_distribution(number):
    for made in (
        lambda: Uniform(number, 1), lambda: Normal(number, 1, 0, 1), lambda: Choice((number,)),
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"must be (a number|numbers, as .*|finite), got"):
            made()
    with pytest.raises(InputError, match="must be numbers"):
        Choice("456")


def test_parameters_that_repeat_are_those_of_the_images():
    recipe, mixture = RECIPES["amwgn"](), find_degradation("awgn=0.5,amwgn=0.5")
    _, _, params = recipe.degrade(KEY, IMAGES)
    _, _, mixed = mixture.degrade(KEY, IMAGES)
    more = np.concatenate([IMAGES, IMAGES])
    for images, count in ((IMAGES[:1], 1), (more, 4)):
        with pytest.raises(InputError, match=f"has 2 values, one an image, for {count} images"):
            recipe.repeat(KEY, params, images)
        with pytest.raises(InputError, match=rf"'recipe' has the shape \(2,\) for {count} images"):
            mixture.repeat(KEY, mixed, images)
    told = "recipe 'amwgn' repeats with the parameters that its degrade returned"
    fewer = {name: own for name, own in params.items() if name != "clip"}
    for other, what in (
        (None, ", a dict by stage name, got NoneType"),
        (params["clip"], ", a dict by stage name, got Clip"),
        (fewer, "; these lack clip"),
        (fewer | {"gaussian_noise": GaussianNoise()}, "; these lack clip"),
        (params | {"jpeg": Jpeg(), "median": 3}, "; these are of another recipe, with jpeg, median"),
    ):
        with pytest.raises(InputError, match=f"^{told}{what}$"):
            recipe.repeat(KEY, other, IMAGES)
    with pytest.raises(InputError, match=r"a distribution, which Recipe\.draw draws from"):
        recipe.repeat(KEY, recipe.prior, IMAGES)
    with pytest.raises(InputError, match=r"read has the shape \(2, 3\), expected \(\), or one an image"):
        wrong = ShotReadNoise(shot=0.0, read=np.zeros((2, 3), np.float32))
        recipe.repeat(KEY, params | {"shot_read_noise": wrong}, IMAGES)
    with pytest.raises(InputError, match=r"a mixture repeats .*, with recipe, awgn, amwgn; got"):
        mixture.repeat(KEY, params, IMAGES)
    with pytest.raises(InputError, match=r"a mixture, of 'awgn', repeats .*; these lack clip"):
        mixture.repeat(KEY, mixed | {"awgn": {}}, IMAGES)


@pytest.mark.parametrize("place", [np.asarray, jnp.asarray], ids=["host", "device"])
def test_levels_of_8_bits_are_no_encoded_picture(place):
    """A chain that decodes sRGB gives rubbish of them; linear light and mosaics may have any scale."""
    chain = Chain((stage("srgb_eotf"), stage("clip"), stage("srgb_oetf")))
    given, one = place(255 * IMAGES), place(255 * IMAGES[0])
    for call in (
        lambda: run(chain, chain.init(), one),
        lambda: run_in_strips(chain, chain.init(), one),
        lambda: run_batch(chain, chain.init(), given),
    ):
        with pytest.raises(InputError, match=r"takes encoded sRGB, .* got levels up to .*by 255"):
            call()
    jax.jit(lambda x: run(chain, chain.init(), x))(one)  # of what is traced nothing is known
    assert run(chain, chain.init(), place(8 * IMAGES[0])).max() > 0.999
    for node in (stage("exposure"), stage("optical_blur")):
        assert run(node, node.init(), one).shape == IMAGES[0].shape


def test_a_batch_is_one():
    chain = Chain((stage("srgb_eotf"), stage("gaussian_noise")), "noise")
    for wrong, message in (
        (
            IMAGES[0],
            r"takes a batch, encoded sRGB of shape \(N, H, W, 3\), got .*run takes one image",
        ),
        (IMAGES.tolist(), "takes an array, got list"),
        (3.0, "takes an array, got float"),
    ):
        with pytest.raises(TypeError, match=message):
            run_batch(chain, chain.init(), wrong, KEY)
    with pytest.raises(TypeError, match="run: 'noise' takes an array, got NoneType"):
        run(chain, chain.init(), None, KEY)


def test_a_key_is_one_key():
    recipe, chain = RECIPES["awgn"](), RECIPES["awgn"]().chain
    for key, got in (
        (0, "got 0"),
        ("a", "got 'a'"),
        (np.zeros(3), r"got float64\[3\]"),
        (jax.random.split(KEY, 4), "got 4 keys"),
        (jax.random.split(jax.random.PRNGKey(0), 4), "got 4 keys"),
    ):
        for call in (
            lambda key: recipe.degrade(key, IMAGES),
            lambda key: run(chain, chain.init(), IMAGES[0], key),
            lambda key: run_batch(chain, chain.init(), IMAGES, key),
            lambda key: chain(chain.init(), jnp.asarray(IMAGES[0]), key=key),
        ):
            with pytest.raises(TypeError, match=rf"takes a JAX key, as jax.random.key\(0\), {got}"):
                call(key)
    raw = recipe.degrade(jax.random.PRNGKey(7), IMAGES)[0]
    np.testing.assert_array_equal(raw, recipe.degrade(jax.random.key(7), IMAGES)[0])


def test_an_index_that_no_image_has():
    recipe, chain = RECIPES["awgn"](), RECIPES["awgn"]().chain
    for start, message in (
        (2**31 - 1, r"the last of 2 images would have the index 2147483648; indices go from 0 to 2147483647"),
        (-1, "below 0"),
        (1.5, "give the index of the first image"),
        ([0, 2**31], "would have the index 2147483648"),
    ):
        for call in (
            lambda start: recipe.degrade(KEY, IMAGES, start),
            lambda start: run_batch(chain, chain.init(), IMAGES, KEY, start),
        ):
            with pytest.raises(ValueError, match=message):
                call(start)


def test_how_a_chain_is_not_built():
    clip = stage("clip")
    for made, message in (
        (
            lambda: Chain(clip),
            r"Chain takes a tuple of stages.*got stage\('clip'\): several go in one tuple",
        ),
        (lambda: Chain(clip, stage("rounding")), "several go in one tuple, and the name comes last"),
        (lambda: Chain("a", [clip]), r"as Chain\(\(stage\('clip'\),\), 'mine'\), got 'a'"),
        (lambda: Chain([clip], [clip]), r"the name of a Chain, its second argument, is text, got \[stage"),
        (lambda: Shuffle(clip), "Shuffle takes a tuple of stages"),
        (lambda: Gate([clip]), r"got a list of 1: Chain\(\(...\)\) makes one of several"),
        (lambda: Gate(clip, 3), "the name of a Gate is text, got 3"),
        (lambda: stage("clip", name=3), "the name of a stage is text, got 3"),
        (lambda: run_batch("phone", {}, IMAGES), r"got 'phone': .*find_recipe\(NAME\).chain"),
        (lambda: Recipe("phone"), "Recipe takes a Chain"),
    ):
        with pytest.raises(TypeError, match=message):
            made()
    chain = Chain(stage(name) for name in ("clip", "rounding"))
    assert Recipe(chain) == Recipe(chain, {})
    for field, wrong in (("prior", None), ("prior", [1]), ("description", 3), ("meta", 3)):
        with pytest.raises(InputError, match=f"recipe 'chain': {field} must be "):
            Recipe(chain, **{field: wrong})
    with pytest.raises(InputError, match=r"named clip, .*, as stage\('clip', name='clip_2'\)"):
        Chain((clip, stage("rounding"), clip))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("fone-phases", "no recipe named 'fone'; is it phone\\? `jaxisp recipes` lists all"),
        ("xyzzy", "no recipe named 'xyzzy'; `jaxisp recipes` lists all"),
        ("AWGN", "'AWGN'; is it awgn\\?"),
        ("phone_any", "is it phone-any\\?"),
        ("", "a recipe is named, as phone, or the path of a TOML file; got ''"),
        ("phone,clean", "several recipes need their shares, which sum to 1, as phone=0.8,clean=0.2"),
        ("phone,", "several recipes need their shares"),
        ("phone=0.5,clean=0.5,", "'phone=0.5,clean=0.5,': '' is no share of a mixture, as phone=0.6"),
        ("phone=80%,clean=20%", "'phone=80%' is no share of a mixture"),
        ("phone=0.8,cleen=0.2", "no recipe named 'cleen'"),
        ("=1", "'=1' is no share"),
        ("phone=0.8", "shares of a mixture must sum to 1, got {'phone.*': 0.8}, 0.8 in all"),
        ("clean", "'clean' is a picture as it is, .* in a mixture alone"),
        ("a.toml-phases", "a.toml: cannot be read"),
    ],
)
@pytest.mark.parametrize("phases", [False, True])
def test_a_name_that_is_no_recipe_is_told_shortly(name, told, phases):
    with pytest.raises(InputError, match=told) as refused:
        find_degradation(name, phases=phases)
    assert len(str(refused.value)) < 160
    if "=" in name:
        with pytest.raises(InputError, match="is a mixture, several recipes: one is taken here"):
            find_recipe(name)


@pytest.mark.parametrize("share", ["0.5", b"1", True, np.True_, None, 1j], ids=str)
def test_a_share_is_a_number(share):
    with pytest.raises(InputError, match=r"must be numbers, as {'phone': 0\.8, 'clean': 0\.2}"):
        mix({"awgn": share, "clean": 1})


@pytest.mark.parametrize(
    "module", ["", "recipes", "priors", "params", "metrics", "camera", "fit", "data", "train"]
)
def test_an_editor_completes_what_is_public(module):
    found = importlib.import_module(f"jaxisp.{module}".rstrip("."))
    assert set(dir(found)) == {*found.__all__, *({"__version__"} if not module else ())}
    assert all(hasattr(found, name) for name in found.__all__)


@pytest.mark.parametrize("wrong", [0, -1, "80", (80, 80), True, 1.5], ids=str)
def test_sizes_of_batches_are_counts(wrong, tmp_path):
    write_png(tmp_path / "a.png", IMAGES[0])
    told = "must be a whole number from 1 on, got"
    for made in (
        lambda: batches(tmp_path, "awgn", wrong),
        lambda: batches(tmp_path, "awgn", 8, batch=wrong, downsample=1),
        lambda: batches(tmp_path, "awgn", 8, downsample=wrong),
        lambda: next(patches(tmp_path, wrong)),
        lambda: CleanPatches(load_clean(tmp_path, patch=8, downsample=1), wrong),
        lambda: DegradedBatches(
            CleanPatches(load_clean(tmp_path, patch=8, downsample=1), 8), "awgn", batch=wrong
        ),
    ):
        with pytest.raises(InputError, match=told):
            made()


def test_what_is_no_source_of_patches(tmp_path):
    for made, message in (
        (
            lambda: CleanPatches(str(tmp_path), 32),
            r"CleanPatches takes what load_clean\(FOLDER, patch=32\) reads",
        ),
        (
            lambda: Batches(str(tmp_path), "awgn"),
            r"Batches takes what has batch\(indices\), .*jaxisp.data.batches",
        ),
        (lambda: Batches(IMAGES, "awgn"), r"Batches takes what has batch"),
        (lambda: DegradedBatches(str(tmp_path), "awgn"), "DegradedBatches takes what has batch"),
    ):
        with pytest.raises(InputError, match=message):
            made()


def test_a_picture_to_explore_is_no_array_of_levels():
    with pytest.raises(InputError, match="the explorer takes encoded sRGB"):
        picture_after(stage("clip"), 255 * IMAGES[0])
    given = np.uint8(255 * IMAGES[0])
    assert np.allclose(picture_after(stage("srgb_eotf"), given), given / 255, atol=1e-3)


@pytest.mark.parametrize(
    "value", ['"0.1"', '["0.1"]', "1979-05-27", '{uniform = ["0", 0.1]}', "{uniform = [[0], 1]}"]
)
def test_a_text_is_no_number_of_a_file(value):
    text = 'stages = [{stage = "srgb_eotf"}, {stage = "gaussian_noise"}]\n[params.gaussian_noise]\nstd = '
    with pytest.raises(
        InputError, match=r"^mine.toml: gaussian_noise\.std = .*: give a number, an array, or one of"
    ):
        Recipe.from_toml(text + value, "mine.toml")


def test_a_recipe_draws_with_a_key():
    with pytest.raises(TypeError, match=r"recipe 'awgn' takes a JAX key, as jax.random.key\(0\), got 0"):
        RECIPES["awgn"]().draw(0)
