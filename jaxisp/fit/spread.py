"""Where a fit's chunks are rendered: side by side on one device, or one a device over a mesh."""

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.errors import InputError
from jaxisp.fit.problem import Given, Normal, Problem
from jaxisp.fit.program import jacobian_shape, normal_equations, on_nothing
from jaxisp.fit.tiles import Chunk
from jaxisp.process import cores

S = TypeVar("S")
T = TypeVar("T")
Call = tuple[Given, np.ndarray, Chunk]
"""The arguments of `normal_equations` after the problem."""

_MOST = 8


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """One for the process, begun when it is first wanted.

    A thread a core: XLA's CPU code runs the small steps of one program one after another.
    """
    return ThreadPoolExecutor(min(cores.available(), _MOST), "jaxisp-fit")


def ahead(function: Callable[[], T]) -> "Future[T]":
    """Begin a call that is wanted later."""
    return _pool().submit(function)


def each(
    problem: Problem,
    call: Callable[[S], Call],
    items: Sequence[S],
    mesh: Mesh | None = None,
    near: Any = None,
) -> tuple[list[Normal], Any]:
    """`normal_equations` of every item's call.

    Args:
        problem: as there.
        call: makes its arguments, as late as they are wanted, so that few are in memory at once.
        items: the same on every process.
        mesh: of one axis, whose devices take one call each at a time; without one the calls are threads
            on the default device.
        near: the Jacobians that an earlier call gave for the same items on the same mesh.

    Returns:
        the results in the order of the items, on every process, without their Jacobians, which are large;
        and these, where they were computed. Without derivatives there are none.
    """
    if mesh is not None:
        return _each_on_mesh(problem, call, items, mesh, near)

    def one(item: S, near: Any) -> tuple[Normal, Any]:
        made = call(item)
        found = jax.block_until_ready(normal_equations(problem, *made, near))
        return found._replace(jacobian=None), found.jacobian if made[0].moving.any() else None

    found = list(_pool().map(one, items, near or [_no_jacobian(problem)] * len(items)))
    return [part for part, _ in found], [jacobian for _, jacobian in found]


def _each_on_mesh(
    problem: Problem, call: Callable[[S], Call], items: Sequence[S], mesh: Mesh, near: Any
) -> tuple[list[Normal], Any]:
    rows = _rows(mesh)
    parts: list[Normal] = []
    jacobians = []
    for n, first in enumerate(range(0, len(items), mesh.size)):
        made = [call(item) for item in items[first : first + mesh.size]]
        full = made + made[-1:] * (mesh.size - len(made))
        stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(v) for v in leaves]), *full)
        calls = jax.tree.map(lambda v: jax.make_array_from_callback(v.shape, rows, v.__getitem__), stacked)
        out = _on_mesh(problem, mesh, *calls, near[n] if near else _no_jacobians(problem, mesh))
        jacobians.append(out.jacobian if stacked[0].moving.any() else None)
        whole = process_allgather(out._replace(jacobian=None), tiled=True)
        parts += [jax.tree.map(lambda v, i=i: v[i], whole) for i in range(len(made))]
    return parts, jacobians


@functools.partial(jax.jit, static_argnums=(0, 1))
def _on_mesh(problem: Problem, mesh: Mesh, *calls: Any) -> Normal:
    """`normal_equations`, with a leading axis over the devices."""

    def one(*call: Any) -> Normal:
        own = jax.tree.map(lambda v: v[0], call)
        return jax.tree.map(lambda v: v[None], normal_equations(problem, *own))

    rows = PartitionSpec(*mesh.axis_names)
    return jax.shard_map(one, mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False)(*calls)


@functools.cache
def _no_jacobian(problem: Problem) -> jax.Array:
    """What `near` is where nothing is known."""
    return jnp.zeros(jacobian_shape(problem), jnp.float32)


@functools.cache
def _no_jacobians(problem: Problem, mesh: Mesh) -> jax.Array:
    """The same on each device."""
    shape = mesh.size, *jacobian_shape(problem)
    return jax.jit(lambda: jnp.zeros(shape, jnp.float32), out_shardings=_rows(mesh))()


def compile_for(problem: Problem, mesh: Mesh | None = None) -> None:
    """Run `normal_equations` once on nothing: it takes far longer to compile than to run."""
    call = on_nothing(problem)
    if mesh is None:
        jax.block_until_ready(normal_equations(problem, *call, _no_jacobian(problem)))
    else:
        _each_on_mesh(problem, lambda _: call, [None], mesh, None)


def _rows(mesh: Mesh) -> NamedSharding:
    return NamedSharding(mesh, PartitionSpec(*mesh.axis_names))


def agree(digest: str) -> None:
    """Make sure that all processes are at the same fit: else they would wait for each other for ever.

    Raises:
        InputError: their digests differ.
    """
    if jax.process_count() > 1:
        found = process_allgather(np.frombuffer(digest.encode(), np.uint8))
        if (found != found[0]).any():
            raise InputError(
                "the processes see different pairs, options or stopped fits: all need the same files"
            )
