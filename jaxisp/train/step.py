"""One training step: degrade, forward, backward and update, compiled as one."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import nnx
from jax.sharding import Mesh

from jaxisp.arrays.promotion import a_librarys
from jaxisp.losses import charbonnier, log_rms
from jaxisp.pipeline import sample_indices
from jaxisp.recipes import RecipeLike
from jaxisp.stages.transfer import srgb_eotf
from jaxisp.train.target import pair_maker

AXIS = "batch"
"""The mesh axis over which a batch is spread."""

LOSSES: dict[str, Callable[[jax.Array], jax.Array]] = {
    "l1": jnp.abs,
    "l2": jnp.square,
    "charbonnier": charbonnier,
    "smooth_l1": lambda x: optax.losses.huber_loss(x, delta=1.0),
    "log_rms": log_rms,
}
"""Penalties of (N, H, W, C) differences by the names in `TrainConfig.loss`; their mean is the loss."""


class State(NamedTuple):
    """What training changes; a pytree of arrays.

    Args:
        step: updates done.
        params: the weights, as nested dicts.
        stats: the rest of the model's state (running averages of batch norms).
        optimizer: optax's state.
        ema: averaged (params, stats), or None.
    """

    step: jax.Array
    params: Any
    stats: Any
    optimizer: Any
    ema: Any


Step = Callable[[State, Any, Any], tuple[State, dict[str, jax.Array]]]


def split_model(model: nnx.Module, *, train: bool) -> tuple[Any, Any, Any]:
    """A model's graph in training or evaluation mode, its weights and the rest, as nested dicts."""
    model = nnx.clone(model)
    model.train() if train else model.eval()
    graph, *states = nnx.split(model, nnx.Param, ...)
    params, stats = map(nnx.to_pure_dict, states)
    return graph, params, stats


def init_state(
    model: nnx.Module, optimizer: optax.GradientTransformation, *, ema: float | None = None
) -> State:
    """The state before the first step.

    Args:
        model: any nnx network that maps (N, H, W, 3) to the same.
        optimizer: as given to `make_step`.
        ema: as given to `make_step`.
    """
    _, params, stats = split_model(model, train=True)
    # copies: a step may reuse the memory of the state that it is given
    params, stats = jax.tree.map(jnp.copy, (params, stats))
    averaged = jax.tree.map(jnp.copy, (params, stats)) if ema else None
    with a_librarys():
        inner = optimizer.init(params)
    return State(jnp.zeros((), jnp.int32), params, stats, inner, averaged)


def make_step(
    model: nnx.Module,
    recipe: RecipeLike,
    optimizer: optax.GradientTransformation,
    *,
    key: jax.Array,
    loss: str | Callable[[jax.Array], jax.Array] = "l1",
    ema: float | None = None,
    forgets: bool = True,
    light: str = "encoded",
    target: str = "photo",
    mesh: Mesh | None = None,
) -> Step:
    """Compile a training step that degrades its clean batch on the device.

    Args:
        model: any nnx network that maps (N, H, W, 3) to the same; only its structure is used here. One with
            an `objective(noisy, target, penalty)` says itself what is to be least.
        recipe: takes and gives encoded sRGB.
        optimizer: an optax transformation.
        key: root of the degradation; sample i draws from `fold_in(key, i)`.
        loss: a name in `LOSSES`, or a function of the difference, whose mean is taken.
        ema: decay of the averaged weights; None or 0 for none.
        forgets: whether the average forgets the initial weights, as fresh ones should be: the decay is then
            smaller in the first steps, `(1 + step) / (10 + step)`. Trained ones keep their share of it.
        light: "encoded" or "linear": what the network sees and the loss is taken in.
        target: "photo", the clean picture, or "camera", what the recipe makes of it without noise.
        mesh: devices over which batches are spread (axis "batch"); state on it is replicated.

    Returns:
        `step(state, clean, index) -> (state, metrics)`: clean (N, H, W, 3) encoded sRGB, or (noisy, target)
        that were degraded before, 8 bits each; index, of its first sample among all, int32. The state that
        it is given is used up (donated). Metrics: loss and grad_norm, on the device.
    """
    graph, _, _ = split_model(model, train=True)
    penalty = LOSSES[loss] if isinstance(loss, str) else loss
    pairs = pair_maker(recipe, key, target, mesh)

    def objective(params: Any, stats: Any, noisy: jax.Array, clean: jax.Array) -> tuple[jax.Array, Any]:
        network = nnx.merge(graph, params, stats)
        if hasattr(network, "objective"):
            value = network.objective(noisy, clean, penalty)
        else:
            value = penalty(network(noisy) - clean).mean()
        return value, nnx.to_pure_dict(nnx.state(network, nnx.Not(nnx.Param)))

    @functools.partial(jax.jit, donate_argnums=0)
    def step(state: State, batch: Any, index: Any) -> tuple[State, dict[str, jax.Array]]:
        if isinstance(batch, tuple):
            noisy, clean = (levels.astype(jnp.float32) / 255 for levels in batch)
        else:
            noisy, clean = pairs(batch, sample_indices(index, len(batch)))
        if light == "linear":
            noisy, clean = srgb_eotf(noisy), srgb_eotf(clean)
        differentiate = jax.value_and_grad(objective, has_aux=True)
        (value, stats), gradients = differentiate(state.params, state.stats, noisy, clean)
        with a_librarys():
            updates, inner = optimizer.update(gradients, state.optimizer, state.params)
            params = optax.apply_updates(state.params, updates)
            norm = optax.tree.norm(gradients)
        averaged = _average(state, (params, stats), ema, forgets)
        new = State(state.step + 1, params, stats, inner, averaged)
        return new, {"loss": value, "grad_norm": norm}

    return step


def _average(state: State, new: Any, decay: float | None, forgets: bool) -> Any:
    if state.ema is None or not decay:
        return None
    steps = state.step.astype(jnp.float32)
    share = jnp.minimum(decay, (1 + steps) / (10 + steps)) if forgets else decay
    return jax.tree.map(lambda old, now: share * old + (1 - share) * now, state.ema, new)


def weights(state: State) -> tuple[Any, Any]:
    """The (params, stats) to use: the averaged ones where there are any."""
    return (state.params, state.stats) if state.ema is None else state.ema
