"""What the small networks of a diagnosis share: their update and themselves, compiled."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import optax
from flax import nnx


def programs(
    graph: Any, optimizer: optax.GradientTransformation, loss: Callable[..., jax.Array]
) -> tuple[Any, Any]:
    """The update and the network, jitted.

    Args:
        graph: of `split_model`, of a network without other state than its weights.
        optimizer: of the weights.
        loss: of what the network makes of a batch's first array, and the batch's others.

    Returns:
        (params, state, *batch) -> (params, state), which reuses the memory of these two; and
        (params, inputs) -> outputs.
    """

    def made(params: Any, inputs: jax.Array) -> Any:
        return nnx.merge(graph, params, {})(inputs)

    @functools.partial(jax.jit, donate_argnums=(0, 1))
    def update(params: Any, state: Any, inputs: jax.Array, *others: jax.Array) -> tuple[Any, Any]:
        gradient = jax.grad(lambda p: loss(made(p, inputs), *others))(params)
        changes, state = optimizer.update(gradient, state, params)
        return optax.apply_updates(params, changes), state

    return update, jax.jit(made)
