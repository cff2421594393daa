"""Demosaicking is linear in the mosaic once its decisions are made: its derivative and its adjoint.

Autodiff turns a stencil's reads into sums of padded planes, which a CPU runs many times slower than
reads. The adjoint of a stencil is a stencil, so each algorithm states its own.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.stencils import edge_counts

Operator = Callable[..., jax.Array]
"""`operator(*held, x)`, linear in x."""


def piecewise_linear(
    evaluate: Callable[[jax.Array], tuple[jax.Array, tuple[jax.Array, ...]]],
    forward: Operator,
    adjoint: Operator,
) -> Callable[[jax.Array], jax.Array]:
    """A function that is linear between changes of its decisions.

    Args:
        evaluate: x to (value, decisions).
        forward: the derivative, `forward(*decisions, tangent)`.
        adjoint: its transpose, `adjoint(*decisions, cotangent)`.
    """

    @jax.custom_jvp
    def function(x: jax.Array) -> jax.Array:
        return evaluate(x)[0]

    @function.defjvp
    def derivative(primals: Any, tangents: Any) -> Any:
        value, decisions = evaluate(*primals)
        held = lax.stop_gradient(decisions)
        change = linear_call(lambda h, x: forward(*h, x), lambda h, y: adjoint(*h, y), held, *tangents)
        return value, change

    return function


def mirrored(
    forward: Operator, adjoint: Operator, shape: tuple[int, ...], channel_axis: int = -1
) -> Operator:
    """The adjoint of a map of (H, W) planes with reflected borders, made of the one without borders.

    Reflected, a plane is a symmetric function with period 2 (n - 1) along an axis of n samples, where an
    edge sample occurs once a period and any other twice. So the adjoint is `adjoint` itself, reflected,
    between a weight on the edges and its inverse.

    Args:
        forward: the map, from planes of that shape.
        adjoint: its transpose on an endless plane, which reads the cotangent with reflected borders.
        shape: (H, W).
        channel_axis: of the cotangent, where it has three.
    """
    if min(shape) < 2:  # one row or column: `windows.pad` repeats the edge instead
        return lambda *args: jax.linear_transpose(
            lambda x: forward(*args[:-1], x), jax.ShapeDtypeStruct(shape, args[-1].dtype)
        )(args[-1])[0]

    def weighted(*args: jax.Array) -> jax.Array:
        *held, cotangent = args
        counts = edge_counts(shape, cotangent.dtype)
        outer = counts if cotangent.ndim == 2 else jnp.expand_dims(counts, channel_axis)
        return adjoint(*held, cotangent * outer) / counts

    return weighted
