"""Stages and what is built of them: Chain, Gate and Shuffle.

A stage is a pure function on ONE image, `fn([params,] image, *, [key,] **static) -> image`, and its
signature is the declaration: `params` is annotated with its class, `image` and the return with a
domain, `key` makes it stochastic, other keyword-only arguments are static options. Parameters of a
composition are one flat dict by stage name, so the tree does not depend on order or nesting. All
nodes are hashable values: equal pipelines compare equal and share one compile.
"""

import functools
import inspect
import re
import typing
import zlib
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.domains import ANY, Domain, accepts
from jaxisp.numerics import materialize
from jaxisp.params import Leaf, batch_axes, param, parameters

Params = dict[str, Any]
REGISTRY: dict[str, Callable[..., jax.Array]] = {}


def register(fn: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """Add a stage function to `REGISTRY` under its name, checking its signature; return it unchanged.

    A registered stage can be named in TOML, is listed by `jaxisp stages`, and gets every contract
    test. Users register their own in the same way.
    """
    if REGISTRY.get(fn.__name__, fn) is not fn:
        raise ValueError(f"a stage named {fn.__name__!r} is registered already")
    signature(fn)
    REGISTRY[fn.__name__] = fn
    return fn


@dataclass(frozen=True)
class Signature:
    """What a stage function declares."""

    params: type | None
    stochastic: bool
    static: tuple[tuple[str, Hashable], ...]
    domain_in: Domain
    domain_out: Domain


@functools.cache
def signature(fn: Callable[..., jax.Array]) -> Signature:
    """Read a stage function's declaration. Raises TypeError where it is not one."""
    hints = typing.get_type_hints(fn, include_extras=True)
    arguments = inspect.signature(fn).parameters
    positional = [n for n, a in arguments.items() if a.kind is not a.KEYWORD_ONLY]
    static = {n: a.default for n, a in arguments.items() if a.kind is a.KEYWORD_ONLY and n != "key"}
    if positional not in (["image"], ["params", "image"]):
        raise TypeError(f"{fn.__name__}: positional arguments must be ([params,] image), got {positional}")
    for name, default in static.items():
        if default is inspect.Parameter.empty:
            raise TypeError(f"{fn.__name__}: static option {name} needs a default")
    try:
        domain_in, domain_out = (hints[n].__metadata__[0] for n in ("image", "return"))
    except (KeyError, AttributeError):
        raise TypeError(f"{fn.__name__}: annotate image and return with a domain") from None
    return Signature(hints.get("params"), "key" in arguments, tuple(static.items()), domain_in, domain_out)


def sections(fn: Callable[..., Any]) -> dict[str, str]:
    """The named sections (Args, Returns, Gradient, Source, ...) of a docstring, and its "Summary"."""
    text = inspect.getdoc(fn) or ""
    parts = re.split(r"^(Args|Returns|Raises|Gradient|Source|Example):[ ]*", text, flags=re.MULTILINE)
    found = {"Summary": parts[0].strip().split("\n\n")[0]}
    for title, body in zip(parts[1::2], parts[2::2]):
        found[title] = inspect.cleandoc(body).strip()
    return {title: " ".join(body.split()) for title, body in found.items()}


class Node:
    """A stage or a composition. `apply` takes the whole pipeline's flat parameter dict."""

    name: str

    @property
    def domain_in(self) -> Domain:
        raise NotImplementedError

    @property
    def domain_out(self) -> Domain:
        raise NotImplementedError

    def stages(self) -> Iterator["Stage"]:
        """The leaf stages, in order."""
        raise NotImplementedError

    def names(self) -> Iterator[str]:
        """Everything that may own an entry of the parameter dict."""
        raise NotImplementedError

    def init(self) -> Params:
        """Default parameters by stage name."""
        raise NotImplementedError

    def apply(self, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
        raise NotImplementedError

    @property
    def stochastic(self) -> bool:
        return any(signature(s.fn).stochastic for s in self.stages())

    def __call__(self, params: Params, image: jax.Array, *, key: jax.Array | None = None) -> jax.Array:
        """Run on one image. `params` may hold entries of stages that are not here."""
        if self.stochastic and key is None:
            raise TypeError(f"{self.name} draws noise: pass key=jax.random.key(seed)")
        return self.apply(params, image, key)


@dataclass(frozen=True)
class Stage(Node):
    """A stage function with its static options bound and a name. Build it with `stage`."""

    fn: Callable[..., jax.Array]
    name: str
    static: tuple[tuple[str, Hashable], ...] = ()

    @property
    def domain_in(self) -> Domain:
        return signature(self.fn).domain_in

    @property
    def domain_out(self) -> Domain:
        return signature(self.fn).domain_out

    @property
    def options(self) -> dict[str, Hashable]:
        """All static options, defaults included."""
        return dict(signature(self.fn).static) | dict(self.static)

    def stages(self) -> Iterator["Stage"]:
        yield self

    def names(self) -> Iterator[str]:
        yield self.name

    def init(self) -> Params:
        cls = signature(self.fn).params
        return {} if cls is None else {self.name: cls()}

    def apply(self, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
        declared = signature(self.fn)
        self._check_image(image)
        arguments: dict[str, Any] = dict(self.static)
        if declared.stochastic:
            assert key is not None, "__call__ has checked it"
            arguments["key"] = jax.random.fold_in(key, zlib.crc32(self.name.encode()) & 0x7FFFFFFF)
        if declared.params is None:
            return self.fn(image, **arguments)
        own = params.get(self.name)
        if not isinstance(own, declared.params):
            raise TypeError(
                f"stage {self.name!r}: params[{self.name!r}] must be a {declared.params.__name__}, "
                f"got {type(own).__name__}; there are {sorted(params)}"
            )
        return self.fn(own, image, **arguments)

    def _check_image(self, image: jax.Array) -> None:
        channels, shape = self.domain_in.channels, jnp.shape(image)
        fits = {1: len(shape) == 2, 3: len(shape) == 3 and shape[-1] == 3}
        if not (fits[channels] if channels else any(fits.values())):
            wanted = {1: "(H, W)", 3: "(H, W, 3)", None: "(H, W) or (H, W, 3)"}[channels]
            raise TypeError(
                f"stage {self.name!r} takes one image, {self.domain_in.name} of shape {wanted}, "
                f"got {shape}; use jax.vmap or jaxisp.run_batch for a batch"
            )
        if not jnp.issubdtype(jnp.result_type(image), jnp.floating):
            raise TypeError(f"stage {self.name!r} takes floats, got {jnp.result_type(image)}: divide by 255?")


def stage(fn: Callable[..., jax.Array] | str, *, name: str | None = None, **static: Any) -> Stage:
    """Bind a stage function (or a registered name) to static options.

    Args:
        fn: the function, or its name in the registry.
        name: what its parameters and its noise go by; the function's name unless given.
        **static: its static options; lists and arrays become nested tuples.

    Raises:
        KeyError: no stage of that name. TypeError: no such option.
    """
    if isinstance(fn, str):
        if fn not in REGISTRY:
            raise KeyError(f"no stage named {fn!r}; there are {', '.join(sorted(REGISTRY))}")
        fn = REGISTRY[fn]
    known = dict(signature(fn).static)
    for option in static:
        if option not in known:
            raise TypeError(f"{fn.__name__} has no option {option!r}; it has {sorted(known) or 'none'}")
    changed = {n: _frozen(v) for n, v in sorted(static.items()) if _frozen(v) != known[n]}
    return Stage(fn, name or fn.__name__, tuple(changed.items()))


def _frozen(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(_frozen(v) for v in value) if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class Chain(Node):
    """Stages one after another; itself a stage. Keys are folded in by stage name, so leaving one
    stage out keeps the others' noise bit-identical."""

    nodes: tuple[Node, ...]
    name: str = "chain"

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", tuple(self.nodes))
        _flow(self.nodes)
        names = list(self.names())
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names must be unique, {', '.join(twice)} is not: use stage(fn, name=...)")

    @property
    def domain_in(self) -> Domain:
        return _flow(self.nodes)[0]

    @property
    def domain_out(self) -> Domain:
        return _flow(self.nodes)[1]

    def names(self) -> Iterator[str]:
        for node in self.nodes:
            yield from node.names()

    def stages(self) -> Iterator[Stage]:
        for node in self.nodes:
            yield from node.stages()

    def init(self) -> Params:
        return {name: value for node in self.nodes for name, value in node.init().items()}

    def apply(self, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
        for i, node in enumerate(self.nodes):
            # without this XLA's CPU backend recomputes one stencil inside the next
            image = node.apply(params, materialize(image) if i else image, key)
        return image

    def without(self, *names: str) -> "Chain":
        """This chain less the nodes of those names (a static switch, as for an ablation)."""
        missing = set(names) - {n.name for n in self.nodes}
        if missing:
            raise KeyError(
                f"{self.name} has no node {sorted(missing)}; it has {[n.name for n in self.nodes]}"
            )
        return Chain(tuple(n for n in self.nodes if n.name not in names), self.name)


@parameters
class Switch:
    """A traced switch."""

    on: Leaf = param(1.0, (0.0, 1.0), "switch", doc="on above 0.5")


@dataclass(frozen=True)
class Gate(Node):
    """A node that a traced switch turns on and off without a retrace.

    Its switch is `params["use_NAME"].on`. Off costs next to nothing unbatched; under `vmap` with a
    switch per image both branches run.
    """

    node: Node
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.name or f"use_{self.node.name}")
        _require_keeping(self.node, "Gate")

    @property
    def domain_in(self) -> Domain:
        return self.node.domain_in

    @property
    def domain_out(self) -> Domain:
        return self.node.domain_out

    def stages(self) -> Iterator[Stage]:
        return self.node.stages()

    def names(self) -> Iterator[str]:
        yield self.name
        yield from self.node.names()

    def init(self) -> Params:
        return {self.name: Switch(), **self.node.init()}

    def apply(self, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
        # not jnp.where: a dead branch would leak NaN gradients
        on = params[self.name].on > 0.5
        return lax.cond(on, lambda x: self.node.apply(params, x, key), lambda x: x, image)


@parameters
class Order:
    """A traced order: nodes run by ascending priority."""

    priority: Leaf = param(
        (0.0,), (0.0, 1.0), "1", any_length=True, doc="one a node, in the order written; lowest first"
    )


@dataclass(frozen=True)
class Shuffle(Node):
    """Nodes that run in a traced order, `params[NAME].priority` ascending, without a retrace.

    Independent uniform priorities draw every order with equal chance. Unbatched, an order is free;
    under `vmap` with an order per image each step runs all branches.
    """

    nodes: tuple[Node, ...]
    name: str = "order"

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", tuple(self.nodes))
        for node in self.nodes:
            _require_keeping(node, "Shuffle")

    @property
    def domain_in(self) -> Domain:
        return _flow(self.nodes)[0]

    @property
    def domain_out(self) -> Domain:
        return self.domain_in

    def names(self) -> Iterator[str]:
        yield self.name
        for node in self.nodes:
            yield from node.names()

    def stages(self) -> Iterator[Stage]:
        for node in self.nodes:
            yield from node.stages()

    def init(self) -> Params:
        order = Order(priority=np.linspace(0, 1, len(self.nodes), dtype=np.float32))
        return {self.name: order, **{k: v for node in self.nodes for k, v in node.init().items()}}

    def apply(self, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
        priority = params[self.name].priority
        if priority.shape != (len(self.nodes),):
            raise TypeError(f"{self.name!r} orders {len(self.nodes)} nodes, got priorities {priority.shape}")
        branches = [functools.partial(node.apply, params, key=key) for node in self.nodes]

        def step(x: jax.Array, which: jax.Array) -> tuple[jax.Array, None]:
            return lax.switch(which, branches, x), None

        return lax.scan(step, image, jnp.argsort(priority))[0]


def _flow(nodes: tuple[Node, ...]) -> tuple[Domain, Domain]:
    """The domains that nodes in a row take and give. Raises ValueError where two do not meet."""
    first = now = ANY
    for node in nodes:
        if not accepts(node.domain_in, now):
            raise ValueError(
                f"{node.name!r} takes {node.domain_in.name}, but what comes before it gives {now.name}"
            )
        if now.keeps and node.domain_in != ANY:  # so far anything would do: now this narrows it
            first = now = node.domain_in
        if not node.domain_out.keeps:
            now = node.domain_out
    return first, now


def _require_keeping(node: Node, what: str) -> None:
    if not accepts(node.domain_in, node.domain_out) or node.domain_in.channels != node.domain_out.channels:
        raise ValueError(
            f"{what} needs a node that keeps its domain: {node.name!r} turns {node.domain_in.name} "
            f"into {node.domain_out.name}"
        )


@functools.partial(jax.jit, static_argnums=0)
def run(node: Node, params: Params, image: jax.Array, key: jax.Array | None = None) -> jax.Array:
    """`node(params, image, key=key)`, compiled once per pipeline and shape."""
    return node(params, image, key=key)


@functools.partial(jax.jit, static_argnums=0)
def run_batch(
    node: Node, params: Params, images: jax.Array, key: jax.Array | None = None, start: Any = 0
) -> jax.Array:
    """Run on a batch: image i has the key `fold_in(key, start + i)`, whatever the batch size.

    Args:
        node: a stage, chain, gate or shuffle.
        params: leaves with one axis more than their spec are per image, the rest are shared.
        images: (N, H, W, 3) or (N, H, W).
        key: a root key, where anything draws noise.
        start: the global index of the first image.
    """
    params = {name: params[name] for name in node.init()}
    keys = None if key is None else sample_keys(key, start + jnp.arange(len(images)))
    axes = (batch_axes(params), 0, None if key is None else 0)
    return jax.vmap(lambda p, x, k: node(p, x, key=k), in_axes=axes)(params, images, keys)


def sample_keys(key: jax.Array, indices: jax.Array) -> jax.Array:
    """One key per global sample index: the same bits whatever the batch size or device count."""
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, indices)
