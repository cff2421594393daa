"""Rendering node by node: what comes before the first node that has changed is kept.

One program of all effects takes a minute to compile, and a probe of a late stage would run all early ones
again. Here each node is compiled when it is first on, and runs where it, or what it is given, has changed.
"""

import functools
import threading
from collections import OrderedDict
from collections.abc import Hashable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import on_all_cores
from jaxisp.node import Node
from jaxisp.pipeline import Chain, Gate, Params, Stage
from jaxisp.stages.choice import DEMOSAICKERS, demosaicking

_BYTES = 250_000_000
_FEWEST = 8
_SET = 8
"""One program serves any number of pictures up to the next multiple of this."""


class Kept:
    """The pictures between nodes, the last used of them, by what they depend on; threads may share it."""

    def __init__(self) -> None:
        self.pictures: OrderedDict[Any, jax.Array] = OrderedDict()
        self._lights: list[jax.Array] = []
        self._lock = threading.Lock()

    def root(self, light: jax.Array, keys: jax.Array | None) -> Hashable:
        """What the first picture goes by: the number of its light, and its keys."""
        with self._lock:
            number = next((i for i, known in enumerate(self._lights) if known is light), len(self._lights))
            if number == len(self._lights):
                self._lights.append(light)
        return number, None if keys is None else np.asarray(jax.random.key_data(keys)).tobytes()

    def get(self, key: Any) -> jax.Array | None:
        with self._lock:
            if key in self.pictures:
                self.pictures.move_to_end(key)
            return self.pictures.get(key)

    def put(self, key: Any, picture: jax.Array) -> None:
        with self._lock:
            self.pictures[key] = picture
            while len(self.pictures) > max(_BYTES // max(picture.nbytes, 1), _FEWEST):
                self.pictures.popitem(last=False)


def render(
    chain: Chain, shared: Params, per_pair: Params, light: jax.Array, keys: jax.Array | None, kept: Kept
) -> np.ndarray:
    """(N, H, W, 3): the pictures of a chain, up to the order of rounding as the chain itself makes them.

    Args:
        chain: its gates are switched by `shared`.
        shared, per_pair: parameters; those of `per_pair` have a leading axis over the pictures.
        light: (N, ...) what the first node takes.
        keys: (N,) of stochastic nodes, or None.
        kept: of earlier calls.
    """
    return np.asarray(in_sets(chain, shared, per_pair, light, keys, kept))[: len(light)]


def in_sets(
    chain: Chain, shared: Params, per_pair: Params, light: jax.Array, keys: jax.Array | None, kept: Kept
) -> jax.Array:
    """(M, H, W, 3): what `render` makes, where it was computed; what is beyond N fills the last set."""
    todo = [n for n in chain.nodes if not isinstance(n, Gate) or float(shared[n.name].on) > 0.5]
    todo = [n.node if isinstance(n, Gate) else n for n in todo]
    names: list[Any] = [kept.root(light, keys)]
    owned = []
    for node in todo:
        mine = [{n: p[n] for n in node.names() if n in p} for p in (shared, per_pair)]
        owned.append(mine)
        names.append(hash((names[-1], node, _bytes(mine))))
    known = ((k, kept.get(names[k])) for k in range(len(todo), 0, -1))
    done, picture = next(((k, found) for k, found in known if found is not None), (0, None))
    if picture is None:
        picture = _whole_sets(light)
    if keys is not None:
        keys = _whole_sets(keys)
    for k in range(done, len(todo)):
        own, each = owned[k]
        picture = _run(todo[k], jax.tree.map(_whole_sets, each), own, picture, keys, len(light))
        kept.put(names[k + 1], picture)
    return picture


def _bytes(params: Any) -> tuple[bytes, ...]:
    return tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(params))


def _whole_sets(a: Any) -> jax.Array:
    missing = -len(a) % _SET
    more = [jnp.broadcast_to(a[:1], (missing, *a.shape[1:]))] if missing else []
    return jnp.concatenate([a, *more]) if more else jnp.asarray(a)


def _run(node: Node, per_pair: Params, own: Params, images: jax.Array, keys: Any, count: int) -> jax.Array:
    """A choice of demosaickers is made here: as one program all of them would be compiled to run one."""
    if not isinstance(node, Stage) or node.fn is not demosaicking or per_pair:
        return _apply(node, per_pair, own, images, keys, count)
    options = dict(node.options)
    shares = np.array(own[node.name].shares, np.float32)
    shares[list(DEMOSAICKERS).index(str(options["algorithm"]))] += 1 - shares.sum()
    mixed: Any = 0.0
    for share, fn in zip(shares, DEMOSAICKERS.values()):
        if abs(share) > 1e-6:
            one = Stage(fn, node.name, (("cfa", options["cfa"]),))
            mixed = mixed + share * _apply(one, {}, {}, images, None, count)
    return jnp.asarray(mixed)


@functools.partial(jax.jit, static_argnums=0)
def _apply(
    node: Node, per_pair: Params, shared: Params, images: jax.Array, keys: Any, count: jax.Array
) -> jax.Array:
    def one(i: jax.Array) -> jax.Array:
        own, image, key = jax.tree.map(lambda a: a[i], (per_pair, images, keys))
        return node.apply({**shared, **own}, image, key)

    shape = jax.eval_shape(one, 0)
    start = jnp.zeros((len(images), *shape.shape), shape.dtype)
    return lax.fori_loop(0, count, lambda i, found: found.at[i].set(one(on_all_cores(i))), start)
