"""What is built of stages: Chain, Gate and Shuffle, and running them on one image or a batch.

Parameters of a composition are one flat dict by stage name, so the tree does not depend on order or
nesting. All nodes are hashable values: equal pipelines compare equal and share one compile.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import NamedSharding, PartitionSpec
from jax.typing import ArrayLike

from jaxisp import edits
from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.batches import group_size, in_groups
from jaxisp.arrays.extents import Extent
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.strips import ROWS, in_strips, in_strips_on_cpu
from jaxisp.arrays.varying import spread_over, varying
from jaxisp.checks import check_count, check_key, check_scale, check_start
from jaxisp.domains import ANY, Domain, accepts
from jaxisp.errors import InputError, short
from jaxisp.node import Around, Node, Params, Stage, entry, require_name, require_node, stage
from jaxisp.params import Leaf, batch_axes, param, parameters
from jaxisp.process.selfcheck import check_backend
from jaxisp.registry import LARGEST_CELL, REGISTRY, Signature, register, sections, signature

__all__ = [
    "REGISTRY", "Chain", "Gate", "Node", "Order", "Params", "Row", "Shuffle", "Signature", "Stage", "Switch",
    "over_batch", "register", "run", "run_batch", "run_in_strips", "sample_indices", "sample_keys",
    "sections", "signature", "spread", "stage",
]  # fmt: skip


@dataclass(frozen=True, repr=False)
class Row(Node):
    """What nodes in a row have in common, in whatever order they run."""

    nodes: tuple[Node, ...]
    name: str

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if isinstance(self.nodes, Node | str) or not isinstance(self.nodes, Iterable):
            what = "several go in one tuple, and the name comes last" if isinstance(self.nodes, Node) else ""
            raise TypeError(
                f"{kind} takes a tuple of stages, then its name, as {kind}((stage('clip'),), 'mine'), got "
                f"{short(self.nodes)}{f': {what}' * bool(what)}"
            )
        object.__setattr__(self, "nodes", tuple(self.nodes))
        for node in self.nodes:
            require_node(node, kind)
        require_name(self.name, f"{kind}, its second argument,")
        _check_pattern(self.stages())

    @functools.cached_property
    def _domains(self) -> tuple[Domain, Domain]:
        return _flow(self.nodes)

    @property
    def domain_in(self) -> Domain:
        return self._domains[0]

    @property
    def reach(self) -> int | None:
        each = [node.reach for node in self.nodes]
        return None if None in each else sum(filter(None, each))

    @property
    def margin(self) -> int | None:
        each = [node.margin for node in self.nodes]
        return None if None in each else max(filter(None, each), default=0)

    def names(self) -> Iterator[str]:
        for node in self.nodes:
            yield from node.names()

    def stages(self) -> Iterator[Stage]:
        for node in self.nodes:
            yield from node.stages()

    def init(self) -> Params:
        return {name: value for node in self.nodes for name, value in node.init().items()}


@dataclass(frozen=True, repr=False)
class Chain(Row):
    """Stages one after another; itself a stage. Keys are folded in by stage name, so leaving one
    stage out keeps the others' noise bit-identical.

    Example:
        >>> import jaxisp
        >>> blur = jaxisp.stage("optical_blur")
        >>> chain = jaxisp.Chain((blur, jaxisp.stage("unsharp_mask")))
        >>> sorted(chain.init())
        ['optical_blur', 'unsharp_mask']
        >>> list(chain.without("unsharp_mask").names())
        ['optical_blur']
    """

    name: str = field(default="chain", compare=False)  # chains of other names share one compile

    def __post_init__(self) -> None:
        super().__post_init__()
        _flow(self.nodes)  # raises where they do not meet
        names = list(self.names())
        if twice := sorted({n for n in names if names.count(n) > 1}):
            fn = next((s.fn.__name__ for s in self.stages() if s.name == twice[0]), twice[0])
            raise InputError(
                f"{self.name!r}: several are named {', '.join(twice)}, by which parameters and noise go; "
                f"give one another name, as stage({fn!r}, name='{twice[0]}_2')"
            )

    @property
    def domain_out(self) -> Domain:
        return self._domains[1]

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        for group in _groups(self.nodes):
            part = functools.partial(_in_turn, group.nodes, stored=group.nodes[0] is self.nodes[0])
            reach = group.reach
            if not reach or extent is not None:  # a strip would not know which rows it has
                image = part(image, params, key, extent)
            else:
                own = {name: params[name] for name in group.init() if name in params}
                image = in_strips_on_cpu(part, image, reach, (own,), unit=group.block)
        return image

    def insert(
        self, *nodes: Node | Iterable[Node], before: str | None = None, after: str | None = None
    ) -> "Chain":
        """This chain with nodes before or after the one of a name, at any depth.

        Raises:
            InputError: there is none of that name, or the chain could not be built.
            TypeError: what is inserted is no stage.
        """
        return edits.insert(self, tuple(_each(nodes)), before, after)

    def replace(self, name: str, node: Node) -> "Chain":
        """This chain with another node in the place of the one of that name. Raises what `insert` does."""
        return edits.replace(self, name, node)

    def without(self, *names: str | Iterable[str]) -> "Chain":
        """This chain less the nodes of those names (a static switch, as for an ablation).

        Raises what `insert` does.
        """
        return edits.without(self, *_each(names))

    def override(
        self, stages: Mapping[str, dict[str, Any]] | None = None, /, **named: dict[str, Any]
    ) -> "Chain":
        """This chain with other static options: `chain.override(median={"footprint": "cross"})`.

        Raises what `insert` does, and what `stage` does.
        """
        return edits.with_options(self, edits.by_stage(self.name, stages, named))


@parameters
class Switch:
    """A traced switch."""

    on: Leaf = param(1.0, (0.0, 1.0), "switch", doc="on above 0.5")


@dataclass(frozen=True, repr=False)
class Gate(Around):
    """A node that a traced switch turns on and off without a retrace.

    Its switch is `params["use_NAME"].on`. Off costs next to nothing unbatched; under `vmap` with a
    switch per image both branches run.

    Example:
        >>> import jaxisp, numpy as np
        >>> gate = jaxisp.Gate(jaxisp.stage("unsharp_mask"))
        >>> params, image = gate.init(), np.eye(8, dtype=np.float32)[..., None].repeat(3, -1)
        >>> params["use_unsharp_mask"] = type(params["use_unsharp_mask"])(on=0.0)
        >>> bool((jaxisp.run(gate, params, image) == image).all())
        True
    """

    node: Node
    name: str = ""

    def __post_init__(self) -> None:
        require_node(self.node, "Gate")
        require_name(self.name, "Gate")
        object.__setattr__(self, "name", self.name or f"use_{self.node.name}")
        _require_keeping(self.node, "Gate")

    @property
    def reach(self) -> int | None:
        return self.node.reach

    @property
    def margin(self) -> int | None:
        return self.node.margin

    def init(self) -> Params:
        return {self.name: Switch(), **self.node.init()}

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        # not jnp.where: a dead branch would leak NaN gradients
        on = entry(params, self.name, Switch).on > 0.5
        return lax.cond(on, lambda x: self.node.in_frame(params, x, key, extent), lambda x: x, image)


@parameters
class Order:
    """A traced order: nodes run by ascending priority."""

    priority: Leaf = param(
        (0.0,), (0.0, 1.0), "1", any_length=True, doc="one a node, in the order written; lowest first"
    )


@dataclass(frozen=True, repr=False)
class Shuffle(Row):
    """Nodes that run in a traced order, `params[NAME].priority` ascending, without a retrace.

    Independent uniform priorities draw every order with equal chance. Unbatched, an order is free;
    under `vmap` with an order per image each step runs all branches.

    Example:
        >>> import jaxisp
        >>> both = jaxisp.Shuffle((jaxisp.stage("median"), jaxisp.stage("unsharp_mask")))
        >>> list(both.names())
        ['order', 'median', 'unsharp_mask']
        >>> both.init()["order"].priority.tolist()
        [0.0, 1.0]
    """

    name: str = "order"

    def __post_init__(self) -> None:
        super().__post_init__()
        for node in self.nodes:
            _require_keeping(node, "Shuffle")

    @property
    def domain_out(self) -> Domain:
        return self.domain_in

    def names(self) -> Iterator[str]:
        yield self.name
        yield from super().names()

    def init(self) -> Params:
        order = Order(priority=np.linspace(0, 1, len(self.nodes), dtype=np.float32))
        return {self.name: order, **super().init()}

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        priority = entry(params, self.name, Order).priority
        if priority.shape != (len(self.nodes),):
            raise TypeError(f"{self.name!r} orders {len(self.nodes)} nodes, got priorities {priority.shape}")
        branches = [functools.partial(node.in_frame, params, key=key, extent=extent) for node in self.nodes]

        def step(x: jax.Array, which: jax.Array) -> tuple[jax.Array, None]:
            return lax.switch(which, branches, x), None

        return lax.scan(step, image, jnp.argsort(priority))[0]


def _groups(nodes: Iterable[Node]) -> Iterator[Row]:
    """Nodes in a row, in groups that can run in strips together.

    An encoder is alone: in the strips that its blocks need, other stages would do more over again. So is a
    node whose reach is not known.
    """
    for alone, group in itertools.groupby(nodes, lambda n: n.reach is None or n.block > LARGEST_CELL):
        together = tuple(group)
        for some in [(n,) for n in together] if alone else [together]:
            yield Row(some, "group")


def _in_turn(
    nodes: tuple[Node, ...],
    image: jax.Array,
    params: Params,
    key: jax.Array | None = None,
    extent: Extent | None = None,
    *,
    stored: bool,
) -> jax.Array:
    for i, node in enumerate(nodes):
        # without this XLA's CPU backend recomputes one stencil inside the next
        image = node.in_frame(params, image if stored and not i else _stored(image), key, extent)
    return image


def _stored(image: jax.Array) -> jax.Array:
    """`materialize`, as rows of interleaved pixels: a last axis of 3 would not be vectorised over."""
    return materialize(image.reshape(len(image), -1)).reshape(image.shape)


def _flow(nodes: tuple[Node, ...]) -> tuple[Domain, Domain]:
    """The domains that nodes in a row take and give. Raises InputError where two do not meet."""
    first = now = ANY
    for node in nodes:
        if not accepts(node.domain_in, now):
            raise InputError(
                f"{node.name!r} takes {node.domain_in.name}, but what comes before it gives {now.name}"
            )
        if now.keeps and node.domain_in != ANY:  # so far anything would do: now this narrows it
            first = now = node.domain_in
        if not node.domain_out.keeps:
            now = node.domain_out
    return first, now


def _check_pattern(stages: Iterable[Stage]) -> None:
    """Raise InputError where two stages in a row take a mosaic for one of another pattern."""
    first: Stage | None = None
    for now in stages:
        if "cfa" in now.options:
            first = first or now
            a, b = first.options["cfa"], now.options["cfa"]
            if a != b:
                raise InputError(
                    f"{first.name!r} has cfa={a!r} and {now.name!r} {b!r}, which takes one colour for "
                    "another; give both one pattern"
                )
        if now.domain_out.channels == 3:
            first = None  # what comes next may be another sensor


def _require_keeping(node: Node, what: str) -> None:
    if not accepts(node.domain_in, node.domain_out) or node.domain_in.channels != node.domain_out.channels:
        raise InputError(
            f"{what} needs a node that keeps its domain: {node.name!r} turns {node.domain_in.name} "
            f"into {node.domain_out.name}"
        )


def _check_call(what: str, node: Node, params: Params, images: ArrayLike, key: jax.Array | None) -> None:
    """Raise what is wrong with the arguments of `run` and its like, as far as the host knows."""
    require_node(node, what)
    if key is not None:
        check_key(what, key)
    node.check(params)
    check_scale(f"{what}: {node.name!r}", node.domain_in, images)


def run(node: Node, params: Params, image: ArrayLike, key: jax.Array | None = None) -> jax.Array:
    """`node(params, image, key=key)`, compiled once per pipeline and shape.

    Raises:
        InputError: a parameter is NaN or out of its bounds, of traced ones nothing is known; or a pipeline
            that takes encoded pictures gets levels above 16, as those of 8 bits, in an array on the host.
        TypeError: a key is missing, or parameters or image are of another kind.

    Example:
        >>> import jaxisp, numpy as np
        >>> node = jaxisp.stage("optical_blur")
        >>> jaxisp.run(node, node.init(), np.ones((8, 12, 3), np.float32)).shape
        (8, 12, 3)
    """
    _check_call("run", node, params, image, key)
    return compiled(node, params, image, key)


@functools.partial(jax.jit, static_argnums=0)
def compiled(node: Node, params: Params, image: jax.Array, key: jax.Array | None) -> jax.Array:
    """What `run` compiles."""
    check_backend()  # while this is traced, so once a compile
    return node(params, image, key=key)


def run_in_strips(
    node: Node, params: Params, image: ArrayLike, key: jax.Array | None = None, *, rows: int = ROWS
) -> jax.Array:
    """`run(node, params, image, key)` on a large frame, strip of rows by strip: in less memory and time.

    A strip is computed with as many more rows around it as its stages reach. Stages that need the whole
    frame, or whose reach is not known, run on all of it, between strips.

    Args:
        node: a stage or a pipeline; as many of its stages as can run in strips.
        params: its parameters.
        image: (H, W, 3) or (H, W).
        key: where anything draws noise.
        rows: of a strip.

    Returns:
        What `run` returns, to rounding.

    Raises:
        What `run` raises.

    Example:
        >>> import jaxisp, numpy as np
        >>> node, frame = jaxisp.stage("optical_blur"), np.ones((600, 16, 3), np.float32)
        >>> strips = jaxisp.run_in_strips(node, node.init(), frame, rows=128)
        >>> bool(np.allclose(strips, jaxisp.run(node, node.init(), frame), atol=1e-6))
        True
    """
    _check_call("run_in_strips", node, params, image, key)
    return compiled_in_strips(node, params, image, key, rows)


@functools.partial(jax.jit, static_argnums=(0, 4))
def compiled_in_strips(
    node: Node, params: Params, image: jax.Array, key: jax.Array | None, rows: int
) -> jax.Array:
    """What `run_in_strips` compiles."""
    if node.stochastic and key is None:
        raise TypeError(f"{node.name} draws noise: pass key=jax.random.key(seed)")
    for local, group in itertools.groupby(_flat(node), lambda n: n.reach is not None):
        part = Chain(tuple(group), node.name)
        if local:
            reach = part.reach
            assert reach is not None, "each of its nodes has one"
            strip = functools.partial(part.apply, params, key=None)
            image = in_strips(strip, image, reach, rows=rows, unit=part.block)
        else:
            image = part.apply(params, materialize(image), key)
    return image


def _each(given: Iterable[Any]) -> Iterator[Any]:
    """Arguments, of which a list or a tuple stands for what is in it."""
    for one in given:
        yield from one if isinstance(one, list | tuple) else (one,)


def _flat(node: Node) -> Iterator[Node]:
    """The nodes of chains within chains."""
    if not isinstance(node, Chain):
        yield node
        return
    for inner in node.nodes:
        yield from _flat(inner)


def run_batch(
    node: Node, params: Params, images: ArrayLike, key: jax.Array | None = None, start: Any = 0
) -> jax.Array:
    """Run on a batch: image i has the key `fold_in(key, start + i)`, whatever the batch size.

    Args:
        node: a stage, chain, gate or shuffle.
        params: leaves with one axis more than their spec are per image, the rest are shared.
        images: (N, H, W, 3) or (N, H, W).
        key: a root key, where anything draws noise.
        start: the global index of the first image.

    Raises:
        What `run` raises.

    Example:
        >>> import jax, jaxisp, numpy as np
        >>> node, images = jaxisp.stage("gaussian_noise"), np.full((4, 8, 8, 3), 0.5, np.float32)
        >>> noisy = jaxisp.run_batch(node, node.init(), images, jax.random.key(0))
        >>> last = jaxisp.run_batch(node, node.init(), images[3:], jax.random.key(0), start=3)
        >>> bool((noisy[3] == last[0]).all())
        True
    """
    _check_call("run_batch", node, params, images, key)
    shape, channels = np.shape(images), node.domain_in.channels
    if len(shape) not in {1: (3,), 3: (4,), None: (3, 4)}[channels]:
        wanted = {1: "(N, H, W)", 3: "(N, H, W, 3)", None: "(N, H, W) or (N, H, W, 3)"}[channels]
        raise TypeError(
            f"run_batch: {node.name!r} takes a batch, {node.domain_in.name} of shape {wanted}, got {shape}; "
            "jaxisp.run takes one image"
        )
    check_count({name: params[name] for name in node.init()}, shape[0])
    return compiled_batch(node, params, images, key, check_start(start, shape[0]))


@functools.partial(jax.jit, static_argnums=0)
def compiled_batch(
    node: Node, params: Params, images: jax.Array, key: jax.Array | None, start: Any
) -> jax.Array:
    """What `run_batch` compiles."""
    check_backend()
    params = {name: entry(params, name, type(own)) for name, own in node.init().items()}
    keys = None if key is None else sample_keys(key, sample_indices(start, len(images)))
    return over_batch(node, params, images, keys)


def over_batch(
    node: Node, params: Params, images: jax.Array, keys: jax.Array | None, extents: Extent | None = None
) -> jax.Array:
    """A node on each image of a batch, with a key each; parameters as in `run_batch`.

    With extents, (N,) each, the images are the top left of frames, as in `Node.__call__`.
    Where switches or orders are per image, a CPU takes the images one by one: as a batch, each would
    run every branch.
    """
    if 0 in images.shape[1:]:
        raise ValueError(f"{node.name}: pictures without pixels, of shape {images.shape[1:]}")
    axes = batch_axes(params)
    mesh = spread_over(images)
    if mesh is not None:
        if extents is not None:
            raise TypeError(f"{node.name}: pictures in larger frames are not spread over devices")
        return spread(mesh, functools.partial(over_batch, node), axes, params, images, keys)

    def one(params: Params, image: jax.Array, of_image: tuple[Any, Any]) -> jax.Array:
        key, extent = of_image
        return node(params, image, key=key, extent=extent)

    def together(*batch: Any) -> jax.Array:
        return jax.vmap(one, in_axes=(axes, 0, 0))(*batch)

    def in_turn(params: Params, images: jax.Array, of_images: Any) -> jax.Array:
        def at(i: jax.Array) -> jax.Array:
            own = jax.tree.map(
                lambda axis, v: v if axis is None else v[i], axes, params, is_leaf=lambda axis: axis is None
            )
            return one(own, images[i], jax.tree.map(lambda v: v[i], of_images))

        return lax.map(at, jnp.arange(len(images)))

    of_images = keys, extents
    switched = any(
        isinstance(own, Switch | Order) and 0 in jax.tree.leaves(axes[name]) for name, own in params.items()
    )
    if not switched or not len(images):
        size = group_size(len(images), images.shape[1] * images.shape[2], sum(1 for _ in node.stages()))
        if size < len(images) and jax.default_backend() == "cpu":
            return in_groups(together, size, axes, params, images, of_images)
        return together(params, images, of_images)
    if varying((params, images, keys)):
        # under vmap jax 0.10 lets a branch's constants vary as the switch does, and then refuses them
        return in_turn(params, images, of_images)
    return by_platform(params, images, of_images, cpu=in_turn, default=together)


def spread(
    mesh: jax.sharding.AbstractMesh,
    fn: Callable[..., jax.Array],
    axes: Any,
    params: Any,
    images: Any,
    keys: Any,
) -> jax.Array:
    """`fn(params, images, keys)`, each device with its own images; their axis is spread over the mesh.

    Parts of an image are gathered first, since stages read beyond them.
    """
    rows = PartitionSpec(jax.typeof(images).sharding.spec[0])
    specs = jax.tree.map(lambda a: PartitionSpec() if a is None else rows, axes, is_leaf=lambda a: a is None)
    in_specs = (specs, rows, None if keys is None else rows)
    given = jax.tree.map(
        lambda spec, x: jax.sharding.reshard(x, NamedSharding(mesh, spec)),
        in_specs,
        (params, images, keys),
        is_leaf=lambda x: isinstance(x, PartitionSpec),
    )
    return jax.shard_map(fn, mesh=mesh, in_specs=in_specs, out_specs=rows, check_vma=False)(*given)


def sample_indices(start: Any, count: int) -> jax.Array:
    """(count,) the global indices of a batch whose first sample has the index `start`.

    They are int32 in every mode of JAX: 64-bit integers would differ from `start` under strict promotion.
    """
    return jnp.asarray(start, jnp.int32) + jnp.arange(count, dtype=jnp.int32)


def sample_keys(key: jax.Array, indices: jax.Array) -> jax.Array:
    """One key per global sample index: the same bits whatever the batch size or device count."""
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, indices)
