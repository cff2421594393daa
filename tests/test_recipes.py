"""Recipes: what they draw, reproducibility, TOML."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.checks import LAST_INDEX
from jaxisp.domains import LINEAR, EncodedRGB
from jaxisp.errors import InputError
from jaxisp.phase import AnyPhase, CfaPhase
from jaxisp.pipeline import Chain, Gate, Order, Shuffle, Switch, run, stage
from jaxisp.priors import Bernoulli, Uniform
from jaxisp.recipe import Recipe, _degrade, check_levels, check_photographs, check_traces
from jaxisp.recipes import RECIPES, find_recipe, mix
from jaxisp.stages.detail import UnsharpMask
from jaxisp.testing import smooth_image

KEY = jax.random.key(5)
IMAGES = np.stack([smooth_image((24, 32, 3), i) for i in range(8)]).astype(np.float32)
CONTRACT = {
    "awgn", "amwgn", "phone", "phone-no-post", "phone-no-denoise", "phone-no-demosaic",
    "phone-bilinear", "phone-ahd", "phone-kodak",
}  # fmt: skip


def test_the_recipes_of_the_contract_are_there():
    assert set(RECIPES) >= CONTRACT


# `phone` with other numbers, or with stages left out
LIKE_PHONE = {"phone-authors-code", "phone-shot", "phone-no-post", "phone-no-denoise"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LIKE_PHONE)) for n in sorted(RECIPES)]
)
def test_degrade(name):
    recipe = RECIPES[name]()
    noisy, clean, params = recipe.degrade(KEY, IMAGES)
    assert noisy.shape == IMAGES.shape and noisy.dtype == np.float32
    assert np.isfinite(noisy).all() and noisy.min() >= 0 and noisy.max() <= 1
    np.testing.assert_array_equal(clean, IMAGES)
    assert all(len(leaf) == len(IMAGES) for leaf in jax.tree.leaves(params))
    levels = np.asarray(noisy) * 255
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-3)
    assert 1e-3 < float(np.mean((noisy - IMAGES) ** 2)) ** 0.5 < 0.4


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_toml_round_trip(name):
    recipe = RECIPES[name]()
    back = Recipe.from_toml(recipe.to_toml())
    assert back == recipe and hash(back) == hash(recipe)
    assert back.chain == recipe.chain


@pytest.mark.optimised
@pytest.mark.slow
def test_the_phone_is_the_same_bits_at_any_batch_size_and_on_eight_devices():
    recipe = RECIPES["phone"]()
    whole = np.asarray(recipe.degrade(KEY, IMAGES)[0])
    parts = [recipe.degrade(KEY, IMAGES[i : i + 2], i)[0] for i in range(0, 8, 2)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    sharding = NamedSharding(Mesh(np.array(jax.devices()), ("batch",)), PartitionSpec("batch"))
    sharded = recipe.degrade(KEY, jax.device_put(IMAGES, sharding))[0]
    assert len(sharded.sharding.device_set) == 8
    np.testing.assert_array_equal(sharded, whole)


def test_switches_and_orders_can_be_drawn():
    nodes = (Gate(stage("median")), stage("unsharp_mask", radius=2))
    prior = {
        "use_median": Switch(on=Bernoulli(0.5)),
        "order": Order(priority=Uniform(0, 1)),
        "unsharp_mask": UnsharpMask(amount=1.0, sigma=0.7),
    }
    recipe = Recipe(Chain((Shuffle(nodes),), "shuffled"), prior)
    noisy, _, params = recipe.degrade(KEY, IMAGES)
    assert set(np.asarray(params["use_median"].on)) == {0, 1}
    parts = [recipe.degrade(KEY, IMAGES[i : i + 2], i)[0] for i in range(0, 8, 2)]
    np.testing.assert_array_equal(np.concatenate(parts), noisy)
    for i in range(8):
        one = jax.tree.map(lambda v, i=i: v[i], params)
        np.testing.assert_allclose(run(recipe.chain, one, IMAGES[i]), noisy[i], atol=1e-6)


def test_drawn_parameters_make_the_image_again():
    recipe = RECIPES["phone-no-denoise"]()
    noisy, _, params = recipe.degrade(KEY, IMAGES, 3)
    np.testing.assert_array_equal(recipe.repeat(KEY, params, IMAGES, 3), noisy)
    one = Recipe(recipe.chain, jax.tree.map(lambda v: np.asarray(v[2]), params))
    again = one.degrade(KEY, IMAGES[2:3], 5)[0]
    np.testing.assert_array_equal(again[0], noisy[2])


def test_equal_recipes_share_a_compile_and_new_keys_do_not_retrace():
    _degrade._clear_cache()
    for seed in range(3):
        RECIPES["awgn"]().degrade(jax.random.key(seed), IMAGES, seed)
    assert _degrade._cache_size() == 1


def test_awgn_has_the_drawn_standard_deviation():
    gray = np.full((64, 48, 48, 3), 0.6, np.float32)  # linear 0.319: clipping is rare for small std
    recipe = RECIPES["awgn"]()
    noisy, _, params = recipe.degrade(KEY, gray)
    decoded = np.where(noisy <= 0.04045, noisy / 12.92, ((noisy + 0.055) / 1.055) ** 2.4)
    std = np.asarray(params["gaussian_noise"].std)
    small = std < 0.08
    measured = decoded.reshape(64, -1).std(1)
    np.testing.assert_allclose(measured[small], np.hypot(std, 0.002)[small], rtol=0.06, atol=1e-3)
    assert std.min() >= 0 and std.max() <= 0.2


def test_the_paper_and_the_authors_code_draw_other_noise():
    draws = {}
    for name in ("phone", "phone-authors-code"):
        recipe = RECIPES[name]()
        draws[name] = jax.vmap(recipe.draw)(jax.random.split(KEY, 2000))["shot_read_noise"]
    paper, code = (np.sqrt(draws[n].shot) for n in ("phone", "phone-authors-code"))
    assert paper.max() <= 0.0201 and paper.mean() == pytest.approx(0.01, rel=0.1)
    assert code.min() >= 0.0099 and code.max() <= 0.2002 and code.max() > 0.15


def test_some_cameras_of_any_kind_do_not_denoise():
    recipe = RECIPES["phone-any"]()
    drawn = jax.vmap(recipe.draw)(jax.random.split(jax.random.key(0), 200))
    strength = drawn["median"].strength
    assert 0.4 < drawn["use_bilateral"].on.mean() < 0.6
    assert strength.min() < 0.05 and strength.max() > 0.95


def test_find_recipe(tmp_path):
    assert find_recipe("phone") == RECIPES["phone"]()
    with pytest.raises(InputError, match="no recipe named 'fone'; is it phone"):
        find_recipe("fone")
    with pytest.raises(InputError, match=r"x.toml: cannot be read"):
        find_recipe(str(tmp_path / "x.toml"))
    RECIPES["amwgn"]().save(tmp_path / "a b é.toml")
    assert find_recipe(str(tmp_path / "a b é.toml")) == RECIPES["amwgn"]()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stages = 3", "a recipe has"),
        ("stages = [", "r.toml:"),
        ('meta = 3\nstages = [{stage = "unsharp_mask"}]', "meta must be a table"),
        ('stages = [{stage = "sharpen"}]', "no stage named 'sharpen'"),
        (
            'stages = [{stage = "unsharp_mask"}]\n[params.unsharp_mask]\namount = 99.0',
            "unsharp_mask.amount = 99",
        ),
        ('stages = [{stage = "mosaic"}, {stage = "unsharp_mask"}]', "gives mosaic"),
        ('stages = [{stage = "unsharp_mask"}]\nauthor = "x"', "a recipe has"),
    ],
)
def test_a_broken_recipe_is_refused(text, message):
    with pytest.raises(InputError, match=message) as caught:
        Recipe.from_toml(text, "r.toml")
    assert str(caught.value).startswith("r.toml: ")


@pytest.mark.parametrize(
    "images", [np.zeros((8, 8, 3), np.float32), np.zeros((1, 8, 8, 3), np.uint8), [[[[0.5] * 3] * 8] * 8]]
)
def test_wrong_images_are_refused(images):
    with pytest.raises(TypeError, match="'awgn' takes"):
        RECIPES["awgn"]().degrade(KEY, images)


def test_levels_of_8_bits_and_a_key_that_is_none_are_refused_in_words():
    images = np.full((1, 8, 8, 3), 200, np.float32)
    with pytest.raises(ValueError, match="got levels from 200 to 200: divide 8 bits by 255"):
        RECIPES["awgn"]().degrade(KEY, images)
    with pytest.raises(TypeError, match=r"jax\.random\.key\(0\), got 0"):
        RECIPES["awgn"]().degrade(0, images / 255)


@pytest.mark.parametrize("name", ["awgn", "phone"])
def test_encoded_levels_well_above_white_are_refused(name):
    """Linear light may have them, before its curve."""
    images = np.linspace(0, 1, 192, dtype=np.float32).reshape(1, 8, 8, 3)
    recipe = RECIPES[name]()
    for given in (images, jnp.asarray(images)):
        for most in (1.5, 2.0, 3.9):
            with pytest.raises(ValueError, match=f"in \\[0, 1\\], got levels from 0 to {most:g}: scale them"):
                recipe.degrade(KEY, most * given)
        check_levels(1.2 * given - 0.1, "sharpened pictures")
        check_levels(3.9 * given, "light", LINEAR)
        with pytest.raises(ValueError, match="linear light whose white is 1, got levels from 0 to 200"):
            check_levels(200 * given, "light", LINEAR)
    camera = Recipe(Chain((stage("exposure"), stage("srgb_oetf")), "from light"), {})
    assert camera.chain.domain_in == LINEAR
    assert np.isfinite(camera.degrade(KEY, 2 * images)[0]).all()


@pytest.mark.parametrize(
    ("start", "told"),
    [
        (
            LAST_INDEX - 6,
            "the last of 8 images would have the index 2147483648; indices go from 0 to 2147483647",
        ),
        (np.int64(2**32), "the last of 8 images would have the index 4294967303"),
        ([2**31] * 8, "the last of 8 images would have the index 2147483648"),
        (-1, "below 0; indices go from 0"),
        ([0, 1, 2, 3, 4, 5, 6, -7], "below 0; indices go from 0"),
        (2**70, "give the index of the first image, or one for each of the 8"),
        (0.5, "give the index of the first image, or one for each of the 8"),
        ([0, 1, 2], "give the index of the first image, or one for each of the 8"),
    ],
)
def test_an_index_that_no_sample_has_is_refused(start, told):
    with pytest.raises(ValueError, match=rf"start = .*: {told}"):
        RECIPES["awgn"]().degrade(KEY, IMAGES, start)


def test_the_last_indices():
    recipe = RECIPES["awgn"]()
    many = recipe.degrade(KEY, IMAGES, LAST_INDEX - 7)[0]
    np.testing.assert_array_equal(recipe.degrade(KEY, IMAGES[7:], [LAST_INDEX])[0], many[7:])


def test_a_stage_that_was_edited_is_compiled_anew():
    """As where a notebook's cell is run again: the text of the recipe is what it was."""

    def times(factor):
        def tint(image: EncodedRGB) -> EncodedRGB:
            return factor * image

        return Recipe(Chain((stage(tint),), "mine"), {})

    before, after = times(0.5), times(0.25)
    assert before.to_toml() == after.to_toml() and before != after
    for recipe, factor in ((before, 0.5), (after, 0.25)):
        np.testing.assert_array_equal(recipe.degrade(KEY, IMAGES)[0], np.float32(factor) * IMAGES)


def test_nan_does_not_pass_for_a_picture():
    bad = IMAGES.copy()
    bad[0, 10, 10, 1] = np.nan
    with pytest.raises(ValueError, match="got NaN"):
        RECIPES["phone"]().degrade(KEY, bad)
    noisy = np.asarray(jax.jit(RECIPES["phone"]().degrade)(KEY, bad)[0])  # traced, so not looked at
    assert np.isnan(noisy[0, 10, 10]).all() and np.isfinite(noisy[1:]).all()


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_floats_are_computed_in_whole_ones(dtype):
    recipe, halves = RECIPES["awgn"](), jnp.asarray(IMAGES, dtype)
    noisy, clean, params = recipe.degrade(KEY, halves)
    assert noisy.dtype == clean.dtype == np.float32
    np.testing.assert_array_equal(noisy, recipe.degrade(KEY, halves.astype(np.float32))[0])
    np.testing.assert_array_equal(recipe.repeat(KEY, params, halves), noisy)


def test_draws_and_pictures_are_float32_under_x64(x64):
    noisy, clean, params = RECIPES["awgn"]().degrade(KEY, IMAGES.astype(np.float64))
    assert {leaf.dtype for leaf in jax.tree.leaves((noisy, clean, params))} == {np.dtype("float32")}


def test_no_image_and_an_image_without_pixels():
    recipe = RECIPES["phone-any"]()  # its switches are drawn: a CPU takes the images one by one
    noisy, _, params = recipe.degrade(KEY, IMAGES[:0])
    assert noisy.shape == (0, 24, 32, 3) and params["use_bilateral"].on.shape == (0,)
    for nothing in (IMAGES[:, :0], IMAGES[:, :, :0]):
        with pytest.raises(ValueError, match="phone-any: pictures without pixels"):
            recipe.degrade(KEY, nothing)


def recipe_of(stages, params=""):
    return Recipe.from_toml(f'name = "mine"\nstages = [{stages}]\n{params}')


@pytest.mark.parametrize(
    ("stages", "params", "message"),
    [
        (
            '{stage="srgb_eotf"}, {stage="mosaic", options={cfa="XXXX"}}, {stage="demosaic_ahd"}', "",
            "mosaic: option cfa must be one of",
        ),
        ('{stage="rounding", options={bits=0}}', "", "rounding: option bits must be from 1 to 16, got 0"),
        ('{gate={stage="unsharp_mask", options={radius=-3}}}', "", "unsharp_mask: option radius must be"),
        ('{stage="spline_curve"}', "[params.spline_curve]\noffsets=[0.1]", "spline_curve: "),
        ('{stage="motion_blur"}', "[params.motion_blur]\nlengths=[1.0]", r"motion_blur: \(1,\) lengths but"),
        (
            '{shuffle=[{stage="saturation"}, {stage="hue_rotation"}]}', "[params.order]\npriority=[0.5]",
            "order: 'order' orders 2 nodes",
        ),
    ],
)  # fmt: skip
def test_what_stages_refuse_is_told_before_any_work(stages, params, message):
    with pytest.raises(InputError, match=f"^recipe( 'mine')?: {message}") as caught:
        check_traces(recipe_of(stages, params))
    assert "\n" not in str(caught.value)


def test_pictures_keep_their_size():
    with pytest.raises(InputError, match=r"'mine' makes \(32, 32, 3\) of .* must keep its size"):
        check_traces(recipe_of('{stage="resize"}'))
    check_traces(recipe_of('{stage="resize"}, {stage="resize", name="back", options={factor=2}}'))
    check_traces(recipe_of('{stage="demosaic_bilinear"}, {stage="resize"}'))  # a camera may shrink
    check_traces(recipe_of('{stage="srgb_eotf"}, {stage="mosaic"}'))


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_the_recipes_pass_the_checks(name):
    check_photographs(RECIPES[name]())
    check_traces(RECIPES[name]())


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ('{stage="srgb_eotf"}', "gives linear sRGB, not photographs"),
        ('{stage="mosaic"}, {stage="demosaic_ahd"}', "takes linear sRGB, not photographs"),
        ('{stage="srgb_eotf"}, {stage="mosaic"}', "gives mosaic, not photographs"),
    ],
)
def test_recipes_for_photographs_take_and_give_encoded_srgb(stages, message):
    with pytest.raises(InputError, match=f"recipe 'mine' {message}"):
        check_photographs(recipe_of(stages))
    check_photographs(recipe_of('{stage="gaussian_noise"}'))  # takes anything, and keeps it


def test_a_file_that_is_too_large_for_a_recipe_is_not_read(tmp_path):
    with (tmp_path / "r.toml").open("wb") as file:
        file.truncate((16 << 20) + 1)
    with pytest.raises(InputError, match=r"r.toml: is larger than 16 MiB"):
        Recipe.load(tmp_path / "r.toml")


def test_a_recipe_without_noise_needs_no_noise():
    recipe = Recipe(Chain((stage("unsharp_mask"),), "plain"), {})
    noisy, _, _ = recipe.degrade(KEY, IMAGES)
    assert noisy.shape == IMAGES.shape


def test_clean_pictures_are_the_callers_no_more():
    """Neither a NumPy array that JAX would take as it lies in memory, nor an array on the device."""
    shape, recipe = (2, 8, 8, 3), RECIPES["awgn"]()
    size = 4 * np.prod(shape)
    room = np.empty(size + 64, np.uint8)
    start = -room.ctypes.data % 64  # where JAX would not copy it
    given = room[start : start + size].view(np.float32).reshape(shape)
    given[:] = 0.5
    clean = jax.block_until_ready(recipe.degrade(KEY, given))[1]
    given[:] = 0.1
    np.testing.assert_array_equal(clean, 0.5)
    images = jnp.full(shape, 0.5)
    recipe.degrade(KEY, images)[1].delete()
    np.testing.assert_array_equal(images, 0.5)


def in_frames(recipe, pictures, frame):
    """A batch of pictures of several sizes at the top left of one frame, as `degrade` takes it."""
    images = np.full((len(pictures), *frame, 3), 0.3, np.float32)
    for own, picture in zip(images, pictures):
        own[: picture.shape[0], : picture.shape[1]] = picture
    return recipe.degrade(jax.random.key(5), images, 0, [p.shape[:2] for p in pictures])


AUTOMATIC = Recipe(Chain((stage("auto_level"),), "automatic"), {})
SENSOR = (
    stage("mosaic", cfa="GRBG"), stage("shot_read_noise"), stage("demosaic_hibbard", cfa="GRBG"),
    stage("unsharp_mask", radius=2),
)  # fmt: skip


@pytest.mark.parametrize(
    ("nodes", "margin"),
    [
        ((stage("gaussian_noise"), stage("rounding")), 0),
        ((AnyPhase(Chain(SENSOR[:3], "sensor")), Gate(stage("median")), SENSOR[3]), 2),
        ((stage("bilateral", radius=1, chroma_cell=4, chroma_bins=3, iterations=2),), 0),
        ((stage("bilateral", radius=1, chroma_radius=2, iterations=2),), 0),
    ],
    ids=["noise", "sensor", "grid", "bilateral"],
)
def test_a_picture_comes_out_of_a_larger_frame_as_alone(nodes, margin):
    recipe = Recipe(Chain(nodes, "mine"), {"cfa_phase": CfaPhase(row=Bernoulli(0.5))} if margin else {})
    assert recipe.chain.margin == margin
    sizes = [(14, 21), (21, 14), (5, 19)]
    pictures = [smooth_image((*size, 3), i).astype(np.float32) for i, size in enumerate(sizes)]
    noisy, _, params = in_frames(recipe, pictures, (21 + margin, 21 + margin))
    for i, picture in enumerate(pictures):
        alone, _, own = recipe.degrade(jax.random.key(5), picture[None], i)
        np.testing.assert_array_equal(noisy[i, : picture.shape[0], : picture.shape[1]], alone[0])
        jax.tree.map(lambda a, b, i=i: np.testing.assert_array_equal(a[i], b[0]), params, own)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["phone", "any-camera"])
def test_a_camera_comes_out_of_a_larger_frame_as_alone(name):
    """Smaller than a loop of the grid's sums, larger, and with an edge inside a cell."""
    recipe = RECIPES[name]()
    sizes = [(64, 80), (141, 83), (33, 190)]
    pictures = [smooth_image((*size, 3), i).astype(np.float32) for i, size in enumerate(sizes)]
    noisy, _, _ = in_frames(recipe, pictures, (160, 208))
    for i, picture in enumerate(pictures):
        alone, _, _ = recipe.degrade(jax.random.key(5), picture[None], i)
        np.testing.assert_array_equal(noisy[i, : picture.shape[0], : picture.shape[1]], alone[0])


def test_all_recipes_take_frames():
    assert [name for name, recipe in RECIPES.items() if recipe().chain.margin is None] == []


def test_a_mixture_of_such_recipes_takes_frames_too():
    mixture = mix({"awgn": 0.5, "clean": 0.5})
    pictures = [smooth_image((9 + i, 14, 3), i).astype(np.float32) for i in range(3)]
    noisy = in_frames(mixture, pictures, (12, 14))[0]
    assert mixture.margin == 0 and mix({"awgn": 0.5, AUTOMATIC: 0.5}).margin is None
    for i, picture in enumerate(pictures):
        alone, _, _ = mixture.degrade(jax.random.key(5), picture[None], i)
        np.testing.assert_array_equal(noisy[i, : len(picture)], alone[0])


@pytest.mark.parametrize(
    ("recipe", "sizes", "told"),
    [
        (AUTOMATIC, [[16, 20]], "what auto_level gives depends on the size of the image"),
        ("phone-kodak", [[15, 20]], "a side is the same or 2 px less, and at least 5"),
        ("phone-kodak", [[4, 20]], "at least 5"),
        ("phone-kodak", [[17, 20]], "17 x 20 px in an image of 16 x 20"),
        ("awgn", [16, 20], r"sizes are \(1, 2\) rows and columns"),
        ("awgn", [[16.0, 20.0]], r"sizes are \(1, 2\) rows and columns"),
    ],
)
def test_sizes_without_room_are_refused(recipe, sizes, told):
    with pytest.raises(InputError, match=told):
        find_recipe(recipe).degrade(jax.random.key(0), np.full((1, 16, 20, 3), 0.5, np.float32), 0, sizes)


def test_sizes_may_be_traced():
    recipe, images, sizes = RECIPES["awgn"](), np.full((2, 9, 12, 3), 0.5, np.float32), [[9, 7], [5, 12]]
    traced = jax.jit(lambda sizes: recipe.degrade(KEY, images, 0, sizes)[0])(jnp.asarray(sizes))
    np.testing.assert_array_equal(traced, recipe.degrade(KEY, images, 0, sizes)[0])
    with pytest.raises(InputError, match=r"sizes are \(2, 2\) rows"):
        jax.jit(lambda sizes: recipe.degrade(KEY, images, 0, sizes))(jnp.ones(2, int))


def test_noise_of_other_keys_depends_on_the_frame():
    with pytest.raises(InputError, match="needs a key of Threefry"):
        images = np.full((1, 16, 20, 3), 0.5, np.float32)
        RECIPES["awgn"]().degrade(jax.random.key(0, impl="rbg"), images, 0, [[9, 20]])
