"""The training step: against a loop written out, averages, schedules, one compile, many devices."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import nnx
from jax.sharding import Mesh

from jaxisp.models import make_model
from jaxisp.recipes import RECIPES
from jaxisp.stages.transfer import srgb_eotf
from jaxisp.train import TrainConfig, degrader, init_state, make_step, schedule, weights
from jaxisp.train.step import split_model

KEY = jax.random.key(7)
CLEAN = np.random.default_rng(0).random((8, 12, 12, 3), np.float32)


def tiny():
    return make_model("dncnn6", depth=3, features=4)


@pytest.mark.parametrize("light", ["encoded", "linear"])
def test_a_step_is_the_loop_written_out(light):
    recipe, optimizer, model = RECIPES["awgn"](), optax.sgd(0.1), tiny()
    step = make_step(model, recipe, optimizer, key=KEY, loss="l2", light=light)
    state, metrics = step(init_state(model, optimizer), CLEAN, 16)
    noisy, clean, _ = recipe.degrade(KEY, CLEAN, 16)
    if light == "linear":
        noisy, clean = srgb_eotf(noisy), srgb_eotf(clean)
    graph, params, stats = split_model(model, train=True)

    def loss(params):
        return ((nnx.merge(graph, params, stats)(noisy) - clean) ** 2).mean()

    value, gradients = jax.jit(jax.value_and_grad(loss))(params)
    assert float(metrics["loss"]) == pytest.approx(float(value), rel=1e-5)
    wanted = jax.tree.map(lambda p, g: p - 0.1 * g, params, gradients)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), state.params, wanted)
    moved = jax.tree.leaves(jax.tree.map(lambda a, b: np.abs(a - b).max(), state.stats, stats))
    assert min(moved) > 0  # batch norms' running averages follow


@pytest.mark.parametrize("forgets", [True, False])
def test_the_average_follows_its_formula_and_new_values_do_not_retrace(forgets):
    optimizer, model = optax.adam(1e-2), tiny()
    step = make_step(model, RECIPES["awgn"](), optimizer, key=KEY, ema=0.2, forgets=forgets)
    state = init_state(model, optimizer, ema=0.2)
    average = jax.tree.map(np.asarray, state.params)
    for i in range(3):
        state, _ = step(state, CLEAN, jnp.int32(8 * i))
        share = min(0.2, (1 + i) / (10 + i)) if forgets else 0.2
        average = jax.tree.map(lambda a, p, s=share: s * a + (1 - s) * np.asarray(p), average, state.params)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), weights(state)[0], average)
    assert step._cache_size() == 1 and int(state.step) == 3


def test_schedules():
    options = {"clean": ("x",), "recipe": "awgn", "steps": 1000, "lr": 1e-3}
    cosine = schedule(TrainConfig(**options, warmup=100), 10)
    assert float(cosine(0)) < 2e-5 and float(cosine(100)) == pytest.approx(1e-3)
    assert float(cosine(550)) == pytest.approx(5e-4, rel=1e-3) and float(cosine(1000)) < 1e-9
    stairs = schedule(TrainConfig(**options, warmup=0, schedule="staircase"), 10)
    assert float(stairs(9)) == pytest.approx(1e-3)
    # the paper's: 10**-0.05 an epoch for 100 epochs
    assert float(stairs(10)) == pytest.approx(1e-3 * 10**-0.05, rel=1e-4)
    assert float(stairs(1000)) == pytest.approx(1e-8, rel=1e-3)
    assert float(schedule(TrainConfig(**options, warmup=0, schedule="constant"), 10)(999)) == pytest.approx(
        1e-3
    )


def test_eight_devices_give_the_loss_curve_of_one():
    assert len(jax.devices()) == 8
    recipe, curves, noisy = RECIPES["phone-bilinear"](), [], []
    optimizer = optax.adam(1e-3)
    for count in (1, 8):
        mesh, model = Mesh(np.asarray(jax.devices()[:count]), ("batch",)), tiny()
        sharded = jax.device_put(CLEAN, jax.NamedSharding(mesh, jax.P("batch")))
        noisy.append(jax.jit(degrader(recipe, KEY, mesh))(sharded, jnp.arange(8)))
        step = make_step(model, recipe, optimizer, key=KEY, ema=0.9, mesh=mesh)
        state = jax.device_put(init_state(model, optimizer, ema=0.9), jax.NamedSharding(mesh, jax.P()))
        losses = []
        for i in range(3):
            state, metrics = step(state, sharded, 8 * i)
            losses.append(float(metrics["loss"]))
        curves.append(losses)
    np.testing.assert_array_equal(*noisy)
    np.testing.assert_allclose(curves[1], curves[0], rtol=2e-5)
    assert len(set(curves[0])) == 3
