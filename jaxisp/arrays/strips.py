"""A function of a large frame, strip of rows by strip: in the memory of a strip."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

from jaxisp.arrays.barriers import materialize, on_all_cores
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.varying import alike

_LARGE, _STRIP = 1 << 18, 1 << 17  # px: a frame that is worth strips, and one of them
ROWS = 64
"""Rows of a strip: few enough for the caches, many enough that the rows around it cost little."""


class Strips(NamedTuple):
    """How a frame is cut: strips of `core` rows, which need `window` rows, `step` rows apart."""

    height: int
    halo: int
    step: int
    core: int
    window: int

    @property
    def pieces(self) -> int:
        return -(-(self.height - self.core) // self.step) + 1

    def place(self, i: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The first row of strip i, and of its window."""
        start = jnp.minimum(i * self.step, self.height - self.core)
        # within the frame: so borders are treated where the frame's are
        return start, jnp.clip(start - self.halo, 0, self.height - self.window)


def _cut(height: int, reach: int, rows: int, unit: int) -> Strips:
    halo, step = -(-reach // unit) * unit, -(-rows // unit) * unit
    core = step + height % unit  # the last strip ends with the frame, and has the same shape as the others
    return Strips(height, halo, step, core, core + 2 * halo)


def _window(frame: Any, top: jax.Array, rows: int) -> Any:
    return jax.tree.map(lambda x: lax.dynamic_slice_in_dim(x, top, rows), frame)


def _put(frame: Any, strip: Any, top: jax.Array) -> Any:
    return jax.tree.map(lambda f, s: lax.dynamic_update_slice_in_dim(f, s, top, axis=0), frame, strip)


def in_strips(fn: Callable[[Any], Any], image: Any, reach: int, *, rows: int = ROWS, unit: int = 2) -> Any:
    """`fn(image)`, strip of rows by strip, in the memory of a strip.

    Args:
        fn: from what `image` is to a pytree of arrays with the rows first. It may depend on a row's
            parity or on its place in a block, not on more of where it stands.
        image: (H, W) or (H, W, C), or a pytree of such.
        reach: how far from a row its result depends on the image [rows].
        rows: of a strip.
        unit: rows of a block, 2 for a mosaic: a strip begins where one does.
    """
    cut = _cut(jax.tree.leaves(image)[0].shape[0], reach, rows, unit)
    if cut.window >= cut.height:
        return fn(image)

    def one(top: Any) -> Any:
        # stored before and after, or each read of a strip works out where it is: 2 to 4 times slower
        return materialize(fn(materialize(_window(image, top, cut.window))))

    def body(i: jax.Array, frame: Any) -> Any:
        start, top = cut.place(on_all_cores(i))
        return _put(frame, _window(one(top), start - top, cut.core), start)

    empty = jax.tree.map(lambda s: jnp.zeros((cut.height, *s.shape[1:]), s.dtype), jax.eval_shape(one, 0))
    return lax.fori_loop(0, cut.pieces, body, alike(empty, image))


def _pulled_in_strips(
    fn: Callable[[Any, Any, Any], Any], image: Any, still: Any, others: Any, cotangent: Any, cut: Strips
) -> tuple[Any, Any]:
    """What a cotangent of `fn(image, still, others)` pulls back to the first and the last, strip by strip.

    Each strip is computed again. `still` is cut as the image is.
    """

    def body(i: jax.Array, sums: tuple[Any, Any]) -> tuple[Any, Any]:
        start, top = cut.place(on_all_cores(i))
        row = start + jnp.arange(cut.core)
        # strips overlap where the height is no multiple of their steps: each row counts for one of them
        fresh = (row >= i * cut.step) & ((row < (i + 1) * cut.step) | (i == cut.pieces - 1))

        def widened(c: jax.Array) -> jax.Array:
            own = jnp.where(fresh.reshape(-1, *[1] * (c.ndim - 1)), _window(c, start, cut.core), 0)
            return _put(jnp.zeros((cut.window, *c.shape[1:]), c.dtype), own, start - top)

        strip, held = materialize(_window((image, still), top, cut.window))
        wanted = materialize(jax.tree.map(widened, cotangent))
        pull = jax.vjp(lambda s, o: fn(s, held, o), strip, others)[1]
        to_image, to_others = materialize(pull(wanted))
        so_far = _window(sums[0], top, cut.window)
        return (
            _put(sums[0], jax.tree.map(jnp.add, so_far, to_image), top),
            jax.tree.map(jnp.add, sums[1], to_others),
        )

    return lax.fori_loop(0, cut.pieces, body, jax.tree.map(jnp.zeros_like, (image, others)))


def in_strips_on_cpu(
    fn: Callable[..., Any],
    image: Any,
    reach: int,
    others: tuple[Any, ...] = (),
    unit: int = 2,
    *,
    forward: bool = True,
    large: int = 1,
) -> Any:
    """`fn(image, *others)`; on a CPU `in_strips` where the frame is large.

    Its scratch memory would take longer to get than strips take more: the C library has blocks of over
    32 MB from the system anew at every call, page by page.

    Args:
        fn: as for `in_strips`; `others` are parameters.
        image: (H, W) or (H, W, C), or a pytree of such.
        reach: how far from a row its result depends on the image [rows].
        others: further arguments, pytrees.
        unit: rows of a block.
        forward: False where the value itself needs little memory, and only the gradient much.
        large: how many times as many pixels as usual a frame needs to be worth strips.

    Gradient: that of `fn`, strip by strip too, each of which is computed again for it.
    """
    height, width = jax.tree.leaves(image)[0].shape[:2]
    rows = max(ROWS, _STRIP // width, 12 * reach)
    cut = _cut(height, reach, rows, unit)
    if height < 4 * ROWS or height * width < large * _LARGE or cut.window >= height:
        return fn(image, *others)
    leaves, tree = jax.tree.flatten(jax.tree.map(jnp.asarray, (image, *others)))
    frames = len(jax.tree.leaves(image))

    def whole(*leaves: jax.Array) -> Any:
        return fn(*jax.tree.unflatten(tree, leaves))

    def strips(*leaves: jax.Array) -> Any:
        image, *others = jax.tree.unflatten(tree, leaves)
        return in_strips(lambda strip: fn(strip, *others), image, reach, rows=rows, unit=unit)

    return _stripped(whole, strips if forward else whole, cut, frames, *leaves)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3))
def _stripped(
    whole: Callable[..., Any], strips: Callable[..., Any], cut: Strips, frames: int, *leaves: Any
) -> Any:
    return by_platform(*leaves, cpu=strips, default=whole)


def _stripped_jvp(
    whole: Callable[..., Any],
    strips: Callable[..., Any],
    cut: Strips,
    frames: int,
    primals: Any,
    tangents: Any,
) -> tuple[Any, Any]:
    moving = [i for i, t in enumerate(tangents) if not isinstance(t, SymbolicZero)]

    def merged(moved: Any, still: Any) -> list[Any]:
        return [moved[moving.index(i)] if i in moving else still[i] for i in range(len(primals))]

    def push(leaves: Any, change: Any) -> Any:
        moved = [leaves[i] for i in moving]
        return jax.jvp(lambda *m: whole(*merged(m, leaves)), moved, change)[1]

    def pull_whole(leaves: Any, cotangent: Any) -> Any:
        return list(jax.vjp(lambda *m: whole(*merged(m, leaves)), *[leaves[i] for i in moving])[1](cotangent))

    def pull_strips(leaves: Any, cotangent: Any) -> Any:
        image, others = ([leaves[i] for i in moving if (i < frames) == first] for first in (True, False))
        still = [leaves[i] for i in range(frames) if i not in moving]

        def fn(strip: Any, held: Any, others: Any) -> Any:
            of_image = iter(held)
            known = [None if i in moving else next(of_image) for i in range(frames)]
            return whole(*merged([*strip, *others], [*known, *leaves[frames:]]))

        to_image, to_others = _pulled_in_strips(fn, image, still, others, cotangent, cut)
        return [*to_image, *to_others]

    def pull(leaves: Any, cotangent: Any) -> Any:
        return by_platform(leaves, cotangent, cpu=pull_strips, default=pull_whole)

    y = _stripped(whole, strips, cut, frames, *primals)
    return y, linear_call(push, pull, list(primals), [tangents[i] for i in moving])


_stripped.defjvp(_stripped_jvp, symbolic_zeros=True)
