"""Forms of a computation for a CPU and for other devices."""

from collections.abc import Callable
from typing import Any

from jax import lax
from jax.extend.backend import backends


def by_platform(*args: Any, cpu: Callable[..., Any], default: Callable[..., Any]) -> Any:
    """`lax.platform_dependent`. In a process that has CPUs alone only their form is traced.

    Both give the same values, to rounding. What such a process exports for another platform has the CPU's.
    """
    return cpu(*args) if has_cpus_alone() else lax.platform_dependent(*args, cpu=cpu, default=default)


def has_cpus_alone() -> bool:
    """Whether JAX has found no other device."""
    return set(backends()) == {"cpu"}
