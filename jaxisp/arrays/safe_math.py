"""Gradient-safe primitives: total functions and surrogate gradients."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero


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
