"""A large batch that is differentiated, group of images by group: in the scratch memory of a group.

What a gradient keeps of the way there grows with the batch. A group goes the way there again instead.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

AT_ONCE = 128_000_000
"""Bytes that the gradient of a whole batch may take. A program for groups has the way there twice: to compile
it takes 1.4 times as long, and a call is no faster (`phone`, 32 and 64 pictures of 80x80)."""
SCRATCH = 30_000_000
"""Bytes that the gradient of a group may take: the C library has blocks of over 32 MB from the system anew at
every call, page by page."""
PER_STAGE = 40
"""Bytes a pixel that a stage keeps for its gradient: what `phone` takes, 470, over its 13 stages."""
LEAST = 15_000
"""Pixels of a group: so many that its calls cost little."""


def group_size(images: int, pixels: int, stages: int) -> int:
    """How many images of a batch, of so many pixels each, are differentiated at once on a CPU."""
    each = PER_STAGE * max(stages, 1)
    if images * pixels * each <= AT_ONCE:
        return images
    most = SCRATCH // each
    size = max((n for n in range(1, images + 1) if images % n == 0 and n * pixels <= most), default=images)
    return size if size * pixels >= LEAST else images


def in_groups(fn: Callable[..., jax.Array], size: int, axes: Any, params: Any, *rest: Any) -> jax.Array:
    """`fn(params, *rest)`, which treats each image of a batch for itself; differentiated group by group.

    Args:
        fn: to one array with the batch axis first.
        size: of a group.
        axes: of each leaf of the parameters 0, where it has the batch axis first, or None.
        params: pytree of arrays.
        rest: pytrees of arrays that have the batch axis first.
    """
    leaves, tree = jax.tree.flatten((params, *rest))
    own = [axis == 0 for axis in jax.tree.leaves(axes, is_leaf=lambda axis: axis is None)]
    batched = (*own, *[True] * (len(leaves) - len(own)))
    return _in_groups(lambda *leaves: fn(*jax.tree.unflatten(tree, leaves)), batched, size, *leaves)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _in_groups(fn: Callable[..., jax.Array], batched: tuple[bool, ...], size: int, *leaves: Any) -> jax.Array:
    return fn(*leaves)


def _in_groups_jvp(
    fn: Callable[..., jax.Array], batched: tuple[bool, ...], size: int, primals: Any, tangents: Any
) -> tuple[jax.Array, jax.Array]:
    moving = [i for i, t in enumerate(tangents) if not _still(t)]

    def of(*moved: Any) -> jax.Array:
        leaves = [moved[moving.index(i)] if i in moving else p for i, p in enumerate(primals)]
        return _one_by_one(fn, batched, size, leaves)

    return jax.jvp(of, [primals[i] for i in moving], [tangents[i] for i in moving])


_in_groups.defjvp(_in_groups_jvp, symbolic_zeros=True)


def _still(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero) or jnp.result_type(tangent) == jax.dtypes.float0


def _one_by_one(
    fn: Callable[..., jax.Array], batched: tuple[bool, ...], size: int, leaves: list[Any]
) -> jax.Array:
    own = [v.reshape(-1, size, *v.shape[1:]) for v, of_image in zip(leaves, batched) if of_image]
    shared = [v for v, of_image in zip(leaves, batched) if not of_image]

    @jax.checkpoint
    def group(own: list[Any], shared: list[Any]) -> jax.Array:
        of_images, of_all = iter(own), iter(shared)
        return fn(*(next(of_images if of_image else of_all) for of_image in batched))

    done = lax.map(lambda group_own: group(group_own, shared), own)
    return done.reshape(-1, *done.shape[2:])
