"""Linear maps that bring their own transpose, for both modes of differentiation.

`jax.custom_vjp` refuses forward mode, and `jax.custom_derivatives.linear_call` refuses `vmap`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxisp.arrays.dtypes import given_and_exact
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.rows import elementwise
from jaxisp.arrays.varying import alike

_linear = Primitive("linear_with_transpose")
_linear.multiple_results = True

Flat = Callable[..., Any]


class _Traced(NamedTuple):
    """A function of arrays, and what it was traced to: this is run, and the function transformed."""

    fn: Flat
    jaxpr: ClosedJaxpr


def linear_call(
    fn: Callable[[Any, Any], Any], transpose: Callable[[Any, Any], Any], residuals: Any, x: Any
) -> Any:
    """`fn(residuals, x)`, linear in x, with `transpose` to pull cotangents back.

    In the rule of a `jax.custom_jvp` it gives the tangent, so that reverse mode, which transposes
    it, is as fast as the transpose that is given. Under `jit`, `vmap` and every nesting of `jvp` and
    `grad`; to the residuals it is differentiated as `fn` and `transpose` are written.

    Args:
        fn: (residuals, x) to y, linear in x.
        transpose: (residuals, y's cotangent) to x's cotangent. Nothing checks that it is the transpose.
        residuals: pytree of arrays.
        x: pytree of arrays.
    """
    residuals, x = alike((residuals, x))
    fixed, fixed_tree = jax.tree.flatten(residuals)
    moving, x_tree = jax.tree.flatten(x)

    def flat(of: Callable[[Any, Any], Any], tree: Any) -> Flat:
        def call(*leaves: jax.Array) -> Any:
            known = jax.tree.unflatten(fixed_tree, leaves[: len(fixed)])
            return of(known, jax.tree.unflatten(tree, leaves[len(fixed) :]))

        return call

    # traced here for the shape and for the program: nested, it would be three times as often a level
    there = flat(fn, x_tree)
    jaxpr, shapes = jax.make_jaxpr(there, return_shape=True)(*fixed, *moving)
    y_tree = jax.tree.structure(shapes)
    how = {"forward": _Traced(there, jaxpr), "backward": flat(transpose, y_tree), "fixed": len(fixed)}
    y = _linear.bind(*fixed, *moving, **how)
    return jax.tree.unflatten(y_tree, y)


def _run(*leaves: Any, forward: _Traced, backward: Flat, fixed: int) -> list[jax.Array]:
    return jaxpr_as_fun(forward.jaxpr)(*leaves)


def _abstract(*leaves: Any, forward: _Traced, backward: Flat, fixed: int) -> list[Any]:
    return list(forward.jaxpr.out_avals)


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], **how: Any) -> tuple[Any, Any]:
    fixed, forward = how["fixed"], how["forward"].fn
    y = _linear.bind(*primals, **how)
    moved = [ad.instantiate_zeros(t) for t in tangents[fixed:]]
    change = _linear.bind(*primals[:fixed], *moved, **how)
    if any(type(t) is not ad.Zero for t in tangents[:fixed]):
        moved = [ad.instantiate_zeros(t) for t in tangents[:fixed]]
        by_fixed = jax.jvp(
            lambda *r: jax.tree.leaves(forward(*r, *primals[fixed:])), tuple(primals[:fixed]), tuple(moved)
        )[1]
        change = [a + b for a, b in zip(change, by_fixed)]
    return y, change


def _transpose(cotangents: Sequence[Any], *leaves: Any, forward: _Traced, backward: Flat, fixed: int) -> Any:
    known, moved = leaves[:fixed], [ad.instantiate_zeros(c) for c in cotangents]
    pulled = _linear.bind(
        *known,
        *moved,
        forward=_traced(backward, *known, *moved),
        backward=forward.fn,
        fixed=fixed,
    )
    wanted = zip(pulled, leaves[fixed:])
    return [None] * fixed + [p if ad.is_undefined_primal(x) else None for p, x in wanted]


def _batch(
    leaves: Sequence[Any], dims: Sequence[Any], *, forward: _Traced, backward: Flat, fixed: int
) -> Any:
    size = next(v.shape[d] for v, d in zip(leaves, dims) if d is not None)

    def front(v: Any, d: Any) -> Any:
        if d is None:
            return jnp.broadcast_to(v, (size, *v.shape))
        return jnp.moveaxis(v, d, 0)

    # what moves always has the batch axis, so that its cotangent needs no sum
    axes = [None if d is None else 0 for d in dims[:fixed]]
    shared = [v if a is None else front(v, d) for v, d, a in zip(leaves, dims, axes)]
    moving = [front(v, d) for v, d in zip(leaves[fixed:], dims[fixed:])]
    there = jax.vmap(forward.fn, in_axes=(*axes, *[0] * len(moving)))
    results = len(forward.jaxpr.out_avals)
    back = jax.vmap(backward, in_axes=(*axes, *[0] * results))
    forward = _traced(there, *shared, *moving)
    return _linear.bind(*shared, *moving, forward=forward, backward=back, fixed=fixed), [0] * results


def _traced(fn: Flat, *leaves: Any) -> _Traced:
    return _Traced(fn, jax.make_jaxpr(fn)(*leaves))


_linear.def_impl(_run)
_linear.def_abstract_eval(_abstract)
ad.primitive_jvps[_linear] = _jvp
ad.primitive_transposes[_linear] = _transpose
batching.primitive_batchers[_linear] = _batch
mlir.register_lowering(_linear, mlir.lower_fun(_run, multiple_results=True))


def total(image: jax.Array) -> jax.Array:
    """The sum over an image.

    By a product with ones: XLA's CPU code takes ten times as long to reduce an image to a number.
    """
    rows = image.reshape(*image.shape[:1], -1)
    return jnp.matmul(rows, jnp.ones(rows.shape[-1], rows.dtype), precision=lax.Precision.HIGHEST).sum()


def mean(image: jax.Array) -> jax.Array:
    """The mean over an image, summed in float32 at least."""
    wide = image.astype(given_and_exact(image)[1])
    return (total(wide) / image.size).astype(image.dtype)


def fused_sum(x: jax.Array, axis: int) -> jax.Array:
    """`x.sum(axis)`, in the kernel that computes x.

    From 0.11 on, jaxlib leaves the sums that it recognises to a library on a CPU, which first stores all that
    is summed: 10 times slower where that is computed on the spot.
    """
    shape = x.shape

    def add(a: jax.Array, b: jax.Array) -> jax.Array:
        return a - (-b)

    return linear_call(
        lambda _, x: lax.reduce(x, np.zeros((), x.dtype), add, (axis,)),
        lambda _, y: jnp.broadcast_to(jnp.expand_dims(y, axis), shape),
        (),
        x,
    )


def inner_product(x: jax.Array, y: jax.Array) -> jax.Array:
    """The sum of x * y over two images of one shape."""
    return total(x * y)


def sums(fn: Callable[..., tuple[jax.Array, ...]], *images: jax.Array) -> tuple[jax.Array, ...]:
    """The sums over the rows, (W,) or (W, C), of the images that `fn` makes of some, elementwise.

    On a CPU row by row: XLA's code takes seven times as long to reduce what it computes on the spot.

    Args:
        fn: images of one shape to a tuple of such.
        images: (H, W) or (H, W, C) each.
    """
    start = tuple(jnp.zeros(s.shape[1:], s.dtype) for s in jax.eval_shape(fn, *images))

    def row_by_row(*images: jax.Array) -> tuple[jax.Array, ...]:
        def body(i: jax.Array, so_far: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            rows = (lax.dynamic_index_in_dim(x, i, 0, keepdims=False) for x in images)
            return tuple(s + v for s, v in zip(so_far, fn(*rows)))

        return lax.fori_loop(0, len(images[0]), body, alike(start, images))

    def at_once(*images: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(v.sum(0) for v in fn(*images))

    return by_platform(*alike(images), cpu=row_by_row, default=at_once)


def scaled(scalar: jax.Array, image: jax.Array) -> jax.Array:
    """`scalar * image`, linear in the scalar, with a fast gradient to it."""
    return linear_call(lambda x, s: s * x, inner_product, image, scalar)


def pointwise(fn: Callable[..., jax.Array], arrays: tuple[jax.Array, ...], *scalars: Any) -> jax.Array:
    """`fn(*arrays, *scalars)`, elementwise in arrays of one shape, with a fast gradient to the scalars."""
    values = tuple(jnp.asarray(s, arrays[0].dtype) for s in scalars)
    return elementwise(lambda *rows: _pointwise(fn, rows, values), *arrays)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _pointwise(
    fn: Callable[..., jax.Array], arrays: tuple[jax.Array, ...], scalars: tuple[jax.Array, ...]
) -> jax.Array:
    return fn(*arrays, *scalars)


def _pointwise_jvp(fn: Callable[..., jax.Array], primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    arrays, scalars = primals
    moved = tuple(jnp.zeros(t.shape, t.dtype) if isinstance(t, SymbolicZero) else t for t in tangents[0])
    y, change = jax.jvp(lambda *a: fn(*a, *scalars), arrays, moved)
    for i, by in enumerate(tangents[1]):
        if not isinstance(by, SymbolicZero):
            alone = lambda s, i=i: fn(*arrays, *scalars[:i], s, *scalars[i + 1 :])  # noqa: E731
            change += scaled(by, jax.jvp(alone, (scalars[i],), (jnp.ones_like(scalars[i]),))[1])
    return y, change


_pointwise.defjvp(_pointwise_jvp, symbolic_zeros=True)
