"""Barriers: where a backend stores what it would otherwise compute anew."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.varying import alike


def materialize(x: Any) -> Any:
    """Make the CPU backend store `x` before it goes on; the identity elsewhere and to gradients.

    Fused across stages, XLA's CPU code recomputes one stencil inside the next. It drops a plain
    `optimization_barrier` between fusions; a branch on an opaque predicate survives, also under vmap.
    """
    return by_platform(x, cpu=_branch, default=lambda v: v)


def store_off_cpu(x: Any) -> Any:
    """Make every other backend store `x`, where a barrier does.

    XLA's GPU code splits a stencil that is too large for one kernel at a place of its own, and stores every
    tap there; and it too computes one stencil anew for the taps of the next.
    """
    return by_platform(x, cpu=lambda v: v, default=_barrier)


def store(x: Any) -> Any:
    """Make every backend store `x`: `materialize` on a CPU, `store_off_cpu` elsewhere."""
    return by_platform(x, cpu=_branch, default=_barrier)


def _branch(value: Any) -> Any:
    # the branches hold a barrier because JAX removes a cond whose branches return what they were given
    return lax.cond(_barrier(True), _barrier, _barrier, value)


def _barrier(tree: Any) -> Any:
    """A barrier for each array: jax 0.12 cannot transpose one of several arrays of which only some move."""
    return jax.tree.map(lax.optimization_barrier, tree)


def barrier_on_cpu(tree: Any) -> Any:
    """Keep a CPU's compiler from moving what comes before into what comes after; it may fuse them yet."""
    return by_platform(tree, cpu=_barrier, default=lambda v: v)


def unknown_zeros(shape: Sequence[int], *others: jax.Array) -> jax.Array:
    """Zeros in the dtype of the first of `others` that XLA does not know: a sum of products begins with them.

    XLA leaves out a zero that it knows, and then either of the first two products may be the one that is not
    rounded, as the size of the array has it.
    """
    zero = jnp.zeros((), others[0].dtype)
    return jnp.broadcast_to(lax.optimization_barrier(alike(zero, others)), shape)


def on_all_cores(index: jax.Array) -> jax.Array:
    """The index of a loop, unchanged, of which the loop's body must make use; on a CPU it is sorted.

    From 0.11 on, jaxlib runs a loop on one of a CPU's cores if it takes it for small, and its count of bytes
    leaves out what is inside branches, where `materialize` puts the work. A loop that sorts is left as it is.
    """
    return by_platform(index, cpu=lambda i: lax.sort(jnp.stack([i, i]))[0], default=lambda i: i)
