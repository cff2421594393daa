"""Compiled update and application of the small networks of a diagnosis."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import optax
from flax import nnx

from jaxisp.arrays.promotion import a_librarys


def programs(
    graph: Any, optimizer: optax.GradientTransformation, loss: Callable[..., jax.Array]
) -> tuple[Any, Any]:
    """Compile the update and the network.

    Args:
        graph: from `split_model`; the network must have no state besides its weights.
        optimizer: of the weights.
        loss: function of the network's output for the batch's first array, and of the other arrays.

    Returns:
        the update (params, state, *batch) -> (params, state), which reuses the memory of its arguments; the
        network (params, inputs) -> outputs.
    """

    def made(params: Any, inputs: jax.Array) -> Any:
        return nnx.merge(graph, params, {})(inputs)

    @functools.partial(jax.jit, donate_argnums=(0, 1))
    def update(params: Any, state: Any, inputs: jax.Array, *others: jax.Array) -> tuple[Any, Any]:
        gradient = jax.grad(lambda p: loss(made(p, inputs), *others))(params)
        with a_librarys():
            changes, state = optimizer.update(gradient, state, params)
            return optax.apply_updates(params, changes), state

    return update, jax.jit(made)
