"""Refuse a backend whose compiler returns wrong numbers, before it returns wrong pictures."""

import functools
import os
from importlib.metadata import version

import jax
import numpy as np

SKIP = "JAXISP_SKIP_SELFCHECK"
"""Set to 1 in the environment, it lets any backend pass."""

_TOLERANCE = 1e-5
# jaxlib 0.10.2 goes wrong from 3 weights, 3 channels and planes of 108 x 108 on; this is a little more
_WEIGHTS, _CHANNELS, _SIDE = 3, 3, 128


def check_backend() -> None:
    """Compute one weighted sum of planes and compare it with NumPy's: once a process and backend.

    Raises:
        RuntimeError: it is wrong; what to do about it is said.
    """
    if os.environ.get(SKIP, "0") in ("", "0"):
        _check(jax.default_backend())


@functools.cache
def _check(backend: str) -> None:
    error = measured_error()
    if not error <= _TOLERANCE:
        raise RuntimeError(
            f"jaxlib {version('jaxlib')} on {backend} computes wrong sums (relative error {error:.2g}, "
            f"{_TOLERANCE:g} allowed), so its pictures would be wrong: install jax 0.10.1, or 0.11 or later; "
            f"or set XLA_FLAGS=--xla_cpu_experimental_ynn_fusion_type=-reduce before Python starts. "
            f"{SKIP}=1 skips this check."
        )


def measured_error() -> float:
    """The largest relative error of `(w[:, None] * q).sum(0)` on the default backend."""
    # small whole numbers: every order of summation is exact
    pixels = np.arange(_SIDE * _SIDE, dtype=np.float32).reshape(_SIDE, _SIDE)
    weights = np.stack([pixels % (5 + k) + 1 for k in range(_WEIGHTS)])
    image = np.stack([pixels % (7 + c) + 1 for c in range(_CHANNELS)])
    stack = np.stack([image + k for k in range(_WEIGHTS)])
    # ahead of time: a call would become part of whatever is being traced around this
    with jax.disable_jit(False):
        compiled = jax.jit(_weighted_sum).lower(weights, stack).compile()
        found = np.asarray(compiled(weights, stack))
    want = (weights[:, None] * stack).sum(0)
    return float(np.max(np.abs(found - want) / want))


def _weighted_sum(weights: jax.Array, stack: jax.Array) -> jax.Array:
    return (weights[:, None] * stack).sum(0)
