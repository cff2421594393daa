"""Arrays within `jax.shard_map`, which tells those that vary over a mesh's axes from those that do not."""

from typing import Any

import jax
from jax import lax
from jax.sharding import AbstractMesh


def alike(tree: Any, *others: Any) -> Any:
    """`tree`, each of its arrays varying over every mesh axis over which an array of it or of `others` does.

    Branches must give, and loops keep, what varies alike; a constant does not vary by itself. Outside of
    `shard_map` nothing varies. Gradient: what did not vary gets the sum over the axes.
    """
    axes = varying((tree, others))
    if not axes:
        return tree

    def cast(x: Any) -> Any:
        missing = tuple(sorted(axes - _axes(x)))
        if not missing:
            return x
        before = getattr(lax, "pvary", None)  # jax 0.7 has no pcast
        return before(x, missing) if before else lax.pcast(x, missing, to="varying")

    return jax.tree.map(cast, tree)


def varying(tree: Any) -> frozenset[Any]:
    """The mesh axes over which an array of a tree varies."""
    return frozenset[Any]().union(*map(_axes, jax.tree.leaves(tree)))


def spread_over(images: Any) -> AbstractMesh | None:
    """The explicit mesh that an array is spread over, along any axis; None where it is not."""
    sharding: Any = getattr(jax.typeof(images), "sharding", None)
    spec = getattr(sharding, "spec", ())
    return sharding.mesh if any(axis is not None for axis in spec) else None


def _axes(x: Any) -> frozenset[Any]:
    kind = jax.typeof(x)
    if hasattr(kind, "manual_axis_type"):
        return frozenset(kind.manual_axis_type.varying)
    return frozenset(getattr(kind, "vma", ()))  # before jax 0.10
