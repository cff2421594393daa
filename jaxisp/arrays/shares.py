"""A share of what a function makes, which is not run where the share is 0."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

from jaxisp.arrays.linear import scaled


def weighted(fn: Callable[..., jax.Array], share: jax.Array, *operands: jax.Array) -> jax.Array:
    """`share * fn(*operands)`; where the share is 0 `fn` is not run.

    Gradient: the product's, at 0 too, so that a fit can leave 0; a share that is 0 and fixed runs nothing. Of
    the first order only: at 0 second derivatives to the share and an operand depend on which comes first.

    Args:
        fn: its result has the shape of the last operand. It must not close over what is differentiated.
        share: a scalar.
        operands: arrays.
    """
    return scaled(share, _run_where(share != 0, fn, operands)) + _leaving_zero(fn, share, *operands)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _leaving_zero(fn: Callable[..., jax.Array], share: jax.Array, *operands: jax.Array) -> jax.Array:
    return _zero(share, operands[-1])


def _zero(share: jax.Array, x: jax.Array) -> jax.Array:
    """0 with the batch axes of both: without, JAX cannot transpose a rule whose tangents have them."""
    return jnp.where(jnp.zeros_like(x, bool) & (share == 0), x, 0)


def _leaving_zero_jvp(fn: Callable[..., jax.Array], primals: Any, tangents: Any) -> Any:
    """No tangent goes through the branch here: batched, it could not be transposed."""
    share, *operands = primals
    still, change = _zero(share, operands[-1]), tangents[0]
    if isinstance(change, SymbolicZero):
        return still, still
    return still, scaled(change, _run_where(share == 0, fn, operands))


_leaving_zero.defjvp(_leaving_zero_jvp, symbolic_zeros=True)


def _run_where(wanted: jax.Array, fn: Callable[..., jax.Array], operands: Sequence[jax.Array]) -> jax.Array:
    return lax.cond(wanted, fn, lambda *xs: jnp.zeros_like(xs[-1]), *operands)
