"""Stages compiled whole: a plain call compiles each of their operations by itself, ten times as long."""

from typing import Any

import jax

from jaxisp.pipeline import signature
from jaxisp.registry import StageFunction


def jitted(fn: StageFunction) -> Any:
    """The stage function, one program for each shape and each set of its static options."""
    return jax.jit(fn, static_argnames=tuple(name for name, _ in signature(fn).static))
