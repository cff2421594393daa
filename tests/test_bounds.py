"""Values out of bounds at `run`, in a call and in a batch: refused where the host knows them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxisp
from jaxisp import Chain, Gate, InputError, run, run_batch, run_in_strips, stage
from jaxisp.checks import check_known
from jaxisp.params import specs
from jaxisp.pipeline import REGISTRY, signature

PICTURE = np.full((16, 16, 3), 0.5, np.float32)
BATCH = np.full((3, 16, 16, 3), 0.5, np.float32)
TUNED = sorted(name for name in jaxisp.STAGES if signature(REGISTRY[name]).params is not None)


@pytest.mark.parametrize("name", TUNED)
def test_every_parameter_of_every_stage_is_held_to_its_bounds(name):
    node = stage(name)
    own = node.init()[name]
    for field, spec in specs(type(own)).items():
        shape, (low, high) = np.shape(spec.default), spec.bounds
        for bad in (low - 1, high * 1.01 + 1, np.nan, np.inf):
            for value in (np.full(shape, bad, np.float32), jnp.full(shape, bad)):
                with pytest.raises(InputError, match=rf"{name}\.{field} = .* is outside \["):
                    run(node, {name: dataclasses.replace(own, **{field: value})}, None)
    for field, spec in specs(type(own)).items():  # on a bound, as float32 and half precision round it
        for bound in spec.bounds:
            for dtype in (np.float32, np.float64, jnp.bfloat16):
                value = np.full(np.shape(spec.default), bound, dtype)
                check_known({name: dataclasses.replace(own, **{field: value})})


@pytest.mark.parametrize(
    "call",
    [
        lambda node, params: run(node, params, PICTURE),
        lambda node, params: node(params, PICTURE),
        lambda node, params: run_batch(node, params, BATCH),
        lambda node, params: run_in_strips(node, params, PICTURE),
        lambda node, params: jax.jit(lambda x: node(params, x))(PICTURE),
        lambda node, params: jax.vmap(lambda x: node(params, x))(BATCH),
        lambda node, params: jax.grad(lambda x: node(params, x).sum())(jnp.asarray(PICTURE)),
    ],
    ids=["run", "call", "batch", "strips", "jit", "vmap", "grad"],
)
def test_known_values_are_refused_however_a_pipeline_is_called(call):
    node = Chain((Gate(stage("jpeg")), stage("clip")))
    params = node.init()
    params["jpeg"] = dataclasses.replace(params["jpeg"], quality=500)
    with pytest.raises(InputError, match=r"jpeg.quality = 500.* is outside \[1, 100\]"):
        call(node, params)


def test_one_value_of_a_batch():
    node = stage("optical_blur")
    own = type(node.init()["optical_blur"])
    with pytest.raises(InputError, match=r"optical_blur.sigma = \[ ?1. 1. -2."):
        run_batch(node, {"optical_blur": own(sigma=jnp.array([1.0, 1.0, -2.0]))}, BATCH)


def test_traced_values_are_not_checked():
    node = stage("optical_blur")
    own = type(node.init()["optical_blur"])
    blur = jax.jit(lambda sigma: run(node, {"optical_blur": own(sigma=sigma)}, PICTURE))
    assert blur(-2.0).shape == PICTURE.shape
    with pytest.raises(InputError):
        run(node, {"optical_blur": own(sigma=-2.0)}, PICTURE)


def test_what_is_not_of_the_pipeline_is_not_checked():
    node = stage("optical_blur")
    others = stage("gaussian_noise").init()
    others["gaussian_noise"] = dataclasses.replace(others["gaussian_noise"], std=-1.0)
    np.testing.assert_allclose(run(node, {**node.init(), **others}, PICTURE), 0.5, atol=1e-6)


@pytest.mark.parametrize("name", ["gaussian_noise", "shot_read_noise", "optical_blur", "unsharp_mask"])
def test_python_numbers_outside_of_jit(name):
    node, key = stage(name), jax.random.key(0)
    own = node.init()[name]
    plain = {name: type(own)(**{field: float(getattr(own, field)) for field in specs(type(own))})}
    picture = PICTURE if node.domain_in.channels != 1 else PICTURE[..., 0]
    got, wanted = node(plain, picture, key=key), run(node, node.init(), picture, key)
    np.testing.assert_allclose(got, wanted, atol=1e-6)


def test_repeat_takes_what_degrade_drew_and_nothing_out_of_bounds():
    recipe = jaxisp.recipes.amwgn()
    mixture = jaxisp.recipes.mix({"awgn": 0.5, "clean": 0.5})
    key = jax.random.key(0)
    for made in (recipe, mixture):
        noisy, _, params = made.degrade(key, BATCH)
        np.testing.assert_array_equal(made.repeat(key, params, BATCH), noisy)
    drawn = recipe.degrade(key, BATCH)[2]
    bad = {**drawn, "shot_read_noise": dataclasses.replace(drawn["shot_read_noise"], read=jnp.full(3, -1.0))}
    with pytest.raises(InputError, match=r"shot_read_noise\.read"):
        recipe.repeat(key, bad, BATCH)
    drawn = mixture.degrade(key, BATCH)[2]
    bad = {**drawn, "awgn": jax.tree.map(lambda v: v - 9, drawn["awgn"]), "recipe": jnp.zeros(3, jnp.int32)}
    with pytest.raises(InputError, match=r"gaussian_noise\.std"):
        mixture.repeat(key, bad, BATCH)
