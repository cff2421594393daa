"""Recipes, batches, networks, training and fits in JAX's numeric modes: double precision enabled, strict
dtype promotion, no implicit rank promotion. Stages are tested in `tests/contract`."""

from contextlib import ExitStack

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxisp.fit import model, program, sharing
from jaxisp.fit.align import Alignment, covered, warp
from jaxisp.fit.problem import Problem
from jaxisp.metrics import match_moments
from jaxisp.models import MODELS, make_model
from jaxisp.pipeline import run_batch, stage
from jaxisp.recipes import RECIPES, find_recipe, mix
from jaxisp.testing import smooth_image
from jaxisp.train.step import init_state, make_step

MODES = {"double": {"x64"}, "strict": {"strict"}, "rank": {"rank"}, "all": {"x64", "strict", "rank"}}


def entered(mode):
    """The mode, to be used in a `with`."""
    stack = ExitStack()
    if "x64" in MODES[mode]:
        stack.enter_context(jax.enable_x64(True))
    if "strict" in MODES[mode]:
        stack.enter_context(jax.numpy_dtype_promotion("strict"))
    if "rank" in MODES[mode]:
        stack.enter_context(jax.numpy_rank_promotion("raise"))
    return stack


@pytest.fixture(params=[m if m == "all" else pytest.param(m, marks=pytest.mark.slow) for m in MODES])
def mode(request):
    """What one mode refuses all of them together refuse, but for what differs in single precision."""
    with entered(request.param):
        yield request.param


def dtypes(tree):
    return {str(leaf.dtype) for leaf in jax.tree.leaves(tree)}


def pictures(count=2, size=(24, 30)):
    return np.stack([smooth_image((*size, 3), seed) for seed in range(count)]).astype(np.float32)


@pytest.mark.parametrize("start", [3, np.asarray([3, 9])])
@pytest.mark.parametrize("on_device", [False, True])
def test_run_batch_gives_the_same_pictures(start, on_device):
    node, images, key = stage("gaussian_noise"), pictures(), jax.random.key(0)
    want = run_batch(node, node.init(), images, key, start)
    with entered("all"):
        # 64-bit indices, as double precision makes them on the device
        got = run_batch(node, node.init(), images, key, jnp.asarray(start) if on_device else start)
    assert got.dtype == jnp.float32
    np.testing.assert_array_equal(got, want)


MIXED = mix({"awgn": 0.5, "cbdnet": 0.5})


@pytest.mark.parametrize("recipe", [find_recipe("awgn"), MIXED], ids=["awgn", "mixture"])
def test_degrade_and_repeat_give_the_same_pictures(recipe):
    images, key = pictures(), jax.random.key(0)
    want = recipe.degrade(key, images, start=3)
    with entered("all"):
        got = recipe.degrade(key, images, start=3)
        again = recipe.repeat(key, got[2], images, start=3)
    assert dtypes(got) == dtypes(want) <= {"float32", "int32"}
    jax.tree.map(np.testing.assert_array_equal, got, want)
    np.testing.assert_array_equal(again, want[0])


QUICK = {"awgn", "phone"}


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in sorted(RECIPES)]
)
def test_every_recipe_traces_to_float32(name):
    recipe, images = find_recipe(name), jax.ShapeDtypeStruct((2, 32, 40, 3), jnp.float32)
    with entered("all"):
        made = jax.eval_shape(lambda key, x: recipe.degrade(key, x), jax.random.key(0), images)
    assert dtypes(made) == {"float32"}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(RECIPES))
def test_every_recipe_gives_the_same_pictures(name):
    recipe, images, key = find_recipe(name), pictures(), jax.random.key(0)
    want = recipe.degrade(key, images)
    with entered("all"):
        got = recipe.degrade(key, images)
    jax.tree.map(np.testing.assert_array_equal, got, want)


def test_a_fits_program_keeps_float32(mode):
    start = model.start()
    problem = Problem("camera", sharing.Layout.of(start, sharing.sharing(start)))
    given = program.on_nothing(problem)
    near = np.zeros(program.jacobian_shape(problem), np.float32)
    made = jax.eval_shape(lambda *args: program.normal_equations(problem, *args), *given, near)
    assert dtypes(made) == {"float32"}


def test_what_evaluation_lays_on_each_other(mode):
    image, place = pictures(1)[0], Alignment(0.3, -0.2, 1.01, 0.99)
    laid = jax.eval_shape(lambda x: warp(x, place), jax.ShapeDtypeStruct(image.shape, jnp.float32))
    assert laid.dtype == jnp.float32
    rows = 11.5 + 1.01 * (np.arange(24) - 11.5) + 0.3
    columns = 14.5 + 0.99 * (np.arange(30) - 14.5) - 0.2
    both = np.outer((rows >= 0) & (rows <= 23), (columns >= 0) & (columns <= 29))
    np.testing.assert_array_equal(covered(place, image.shape), both)
    matched = match_moments(image, image * np.float32(0.5))
    np.testing.assert_allclose(matched, image * 0.5, atol=1e-5)


@pytest.mark.parametrize(
    "name", [n if n in ("fast", "levelnet") else pytest.param(n, marks=pytest.mark.slow) for n in MODELS]
)
def test_a_step_of_training_keeps_its_dtypes(name, mode):
    """And so does the network that denoises."""
    rate = optax.linear_schedule(1e-3, 0, 9)
    optimizer = optax.chain(optax.scale_by_adam(), optax.scale_by_learning_rate(rate))

    def trained(clean):
        network = make_model(name)
        before = init_state(network, optimizer, ema=0.9)
        step = make_step(network, "awgn", optimizer, key=jax.random.key(0), ema=0.9)
        return network(clean), before, step(before, clean, jnp.int32(5))

    images = jax.ShapeDtypeStruct((2, 48, 48, 3), jnp.float32)
    denoised, before, (after, metrics) = jax.eval_shape(trained, images)
    assert denoised.dtype == jnp.float32 and dtypes(metrics) == {"float32"}
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), before
    )
