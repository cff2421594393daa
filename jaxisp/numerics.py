"""Gradient-safe primitives: total functions, surrogate gradients, and what keeps XLA fast."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero


def materialize(x: Any) -> Any:
    """Make the CPU backend store `x` before it goes on; the identity elsewhere and to gradients.

    Fused across stages, XLA's CPU code recomputes one stencil inside the next. It drops a plain
    `optimization_barrier` between fusions; a branch on an opaque predicate survives, also under vmap.
    """
    return lax.platform_dependent(x, cpu=_branch, default=lambda v: v)


def store_off_cpu(x: Any) -> Any:
    """Make every other backend store `x`, where a barrier does.

    XLA's GPU code splits a stencil that is too large for one kernel at a place of its own, and stores every
    tap there; and it too computes one stencil anew for the taps of the next.
    """
    return lax.platform_dependent(x, cpu=lambda v: v, default=_barrier)


def store(x: Any) -> Any:
    """Make every backend store `x`: `materialize` on a CPU, `store_off_cpu` elsewhere."""
    return lax.platform_dependent(x, cpu=_branch, default=_barrier)


def _branch(value: Any) -> Any:
    # the branches hold a barrier because JAX removes a cond whose branches return what they were given
    return lax.cond(_barrier(True), _barrier, _barrier, value)


def _barrier(tree: Any) -> Any:
    """A barrier for each array: jax 0.12 cannot transpose one of several arrays of which only some move."""
    return jax.tree.map(lax.optimization_barrier, tree)


def barrier_on_cpu(tree: Any) -> Any:
    """Keep a CPU's compiler from moving what comes before into what comes after; it may fuse them yet."""
    return lax.platform_dependent(tree, cpu=_barrier, default=lambda v: v)


def on_all_cores(index: jax.Array) -> jax.Array:
    """The index of a loop, unchanged, of which the loop's body must make use; on a CPU it is sorted.

    From 0.11 on, jaxlib runs a loop on one of a CPU's cores if it takes it for small, and its count of bytes
    leaves out what is inside branches, where `materialize` puts the work. A loop that sorts is left as it is.
    """
    return lax.platform_dependent(index, cpu=lambda i: lax.sort(jnp.stack([i, i]))[0], default=lambda i: i)


def nearest_int(x: jax.Array) -> jax.Array:
    """The nearest whole numbers, half to even, as int32; |x| is at most 2**22.

    XLA's own conversion looks after NaN and overflow, and takes a CPU several times as long.
    """
    if x.dtype != jnp.float32:
        return jnp.round(x).astype(jnp.int32)
    far = np.float32(3 << 22)  # around it, steps of float32 are 1: the sum is rounded, and ends in the number
    return lax.bitcast_convert_type(x + far, jnp.int32) - far.view(np.int32)


def safe_sqrt(x: jax.Array) -> jax.Array:
    """sqrt(max(x, 0)) with a finite gradient at and below 0 (it is 0 there)."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def safe_divide(a: Any, b: jax.Array, tiny: float = 1e-12) -> jax.Array:
    """a / b where |b| > tiny, else 0, with finite gradients."""
    ok = jnp.abs(b) > tiny
    return jnp.where(ok, a / jnp.where(ok, b, 1.0), 0.0)


def straight_through(hard: jax.Array, soft: jax.Array) -> jax.Array:
    """The value of `hard` with the gradient of `soft`."""
    # selecting instead of soft + (hard - soft) keeps the value exact
    return _pass(soft, lax.stop_gradient(hard))


@jax.custom_jvp
def _pass(soft: jax.Array, hard: jax.Array) -> jax.Array:
    return hard


@_pass.defjvp
def _pass_jvp(primals: Any, tangents: Any) -> Any:
    return primals[1], tangents[0]


def round_through(x: jax.Array) -> jax.Array:
    """Round half to even; the gradient is 1 (straight-through)."""
    return straight_through(jnp.round(x), x)


def clip(x: jax.Array, low: Any, high: Any) -> jax.Array:
    """`jnp.clip` between two scalars, NaN kept; its gradient is 1 inside, 0 outside and 1/2 on a bound.

    JAX's own gradient divides, once for each bound, and XLA's CPU code stores the quotients.
    """
    x = jnp.asarray(x)
    return _clip(x, jnp.asarray(low, x.dtype), jnp.asarray(high, x.dtype))


@jax.custom_jvp
def _clip(x: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    return jnp.clip(x, low, high)


def _clip_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    x, low, high = primals
    y = _clip(x, low, high)
    where = (
        ((x >= low) & (x <= high), (x > low) & (x < high)),
        (x <= low, x < low),
        (x >= high, x > high),
    )
    moved = [(m, t) for m, t in zip(where, tangents) if not isinstance(t, SymbolicZero)]
    halves = [jnp.where(mask, change, 0) for masks, change in moved for mask in masks]
    return y, 0.5 * sum(halves, jnp.zeros_like(y))


_clip.defjvp(_clip_jvp, symbolic_zeros=True)


def clip_through(x: jax.Array, low: Any, high: Any, leak: float = 0.0) -> jax.Array:
    """Clip; the gradient is 1 inside and `leak` outside, so that a fitter can leave a clipped region."""
    inside = clip(x, low, high)
    return straight_through(inside, leak * x + (1 - leak) * inside) if leak else inside


def as_rows(image: jax.Array) -> jax.Array:
    """(H, W, C) as (H, W C): XLA's CPU code does not vectorise over a last axis of 3, and takes ten times
    as long."""
    # a barrier, or XLA would move the reshape out of the way
    return barrier_on_cpu(image.reshape(len(image), -1))


def from_rows(rows: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """The inverse of `as_rows`."""
    return barrier_on_cpu(rows).reshape(shape)


def elementwise(fn: Callable[..., jax.Array], *images: jax.Array) -> jax.Array:
    """`fn(*images)`, elementwise in images of one shape, as rows of interleaved pixels."""
    shape = images[0].shape
    if len(shape) < 3:
        return fn(*images)
    return from_rows(fn(*map(as_rows, images)), shape)
