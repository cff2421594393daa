"""Gradients in both modes, and against finite differences, in few programs."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.test_util import check_jvp, check_vjp


def both_modes(fn: Callable[..., Any], args: Sequence[Any], tangents: Any, cotangents: Any) -> Any:
    """(value, what the tangents become, what the cotangents become), out of one linearization.

    Each mode has the rules that it has by itself; what they share is traced and compiled once.

    Args:
        fn: of arrays, to trees of arrays.
        args: where it is differentiated.
        tangents: one tree for each argument.
        cotangents: a tree like the value's.
    """
    value, push = jax.linearize(fn, *args)
    return value, push(*tangents), jax.linear_transpose(push, *args)(cotangents)


def check_grads(fn: Callable[..., Any], args: Sequence[Any], order: int, **tolerances: float) -> None:
    """What `jax.test_util.check_grads` checks, forwards and backwards, one program for a function and order.

    JAX's own runs value, tangent and cotangent apart, and those that it differentiates again operation by
    operation.

    Args:
        fn: of arrays, to trees of arrays.
        args: where it is checked.
        order: of the gradients.
        **tolerances: `rtol` and `atol`, of JAX's.

    Raises:
        AssertionError: they differ.
    """
    args = tuple(args)

    def forwards(args: Any, tangents: Any) -> Any:
        return jax.jvp(fn, args, tangents)

    def backwards(*args: Any) -> Any:
        value, pull = jax.vjp(fn, *args)
        return pull(value)

    @jax.jit
    def program(args: Any, tangents: Any, cotangents: Any) -> Any:
        return fn(*args), *both_modes(fn, args, tangents, cotangents)

    still = jax.tree.map(np.zeros_like, args)
    none = jax.tree.map(lambda v: np.zeros(v.shape, v.dtype), jax.eval_shape(fn, *args))
    check_jvp(
        lambda *a: program(a, still, none)[0], lambda a, t: program(a, t, none)[1:3], args, **tolerances
    )
    check_vjp(
        lambda *a: program(a, still, none)[0],
        lambda *a: (program(a, still, none)[1], lambda c: program(a, still, c)[3]),
        args,
        **tolerances,
    )
    if order > 1:
        check_grads(forwards, (args, args), order - 1, **tolerances)
        check_grads(backwards, args, order - 1, **tolerances)
