"""The nodes that pipelines are built of, and the simplest: a stage with its options and a name."""

import math
import zlib
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp import shown
from jaxisp.arrays.dtypes import given_and_exact, in_dtype
from jaxisp.arrays.extents import Extent, mirrored
from jaxisp.arrays.varying import alike
from jaxisp.checks import check_key, check_known
from jaxisp.domains import Domain
from jaxisp.errors import meant, short
from jaxisp.options import check_option
from jaxisp.params import specs
from jaxisp.registry import CELL, Signature, find_stage, is_stage, locality, signature

Params = dict[str, Any]


def entry(params: Any, name: str, kind: type) -> Any:
    """The parameters that go by a name. Raises TypeError, in words, where they are missing or others."""
    if not isinstance(params, dict):
        shown = type(params).__name__
        raise TypeError(
            f"params must be a dict by stage name, as {{{name!r}: {kind.__name__}()}}, got {shown}"
        )
    if name not in params:
        there = f"it has {', '.join(map(repr, sorted(params)))}" if params else "it is empty"
        raise TypeError(f"params lacks {name!r}, a {kind.__name__}: {there}; init() of a pipeline gives all")
    if not isinstance(params[name], kind):
        got = "a number or an array" if hasattr(params[name], "dtype") else type(params[name]).__name__
        raise TypeError(f"params[{name!r}] must be a {kind.__name__}, got {got}")
    return params[name]


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

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        raise NotImplementedError

    @property
    def stochastic(self) -> bool:
        return any(signature(s.fn).stochastic for s in self.stages())

    @property
    def reach(self) -> int | None:
        """How far from a pixel the result depends on the image [px], as its stages were registered; None
        where it may depend on the whole frame, or on a pixel's position."""
        raise NotImplementedError

    @property
    def margin(self) -> int | None:
        """How many rows, or columns, a frame needs beyond a picture that does not fill them [px], so that the
        picture comes out as it would alone; None where it does not, in whatever frame."""
        return None

    @property
    def block(self) -> int:
        """Rows after which all blocks that its stages work in begin together."""
        return math.lcm(CELL, *(s.block for s in self.stages()))

    def check(self, params: Params) -> None:
        """Raise InputError where a parameter of a stage here is NaN or out of its bounds, as far as the host
        knows; TypeError where it is missing or of another kind."""
        check_known({name: entry(params, name, type(own)) for name, own in self.init().items()})

    def __repr__(self) -> str:
        return shown.node_text(self)

    def _repr_html_(self) -> str:
        return shown.node_html(self)

    def __call__(
        self,
        params: Params,
        image: jax.Array,
        *,
        key: jax.Array | None = None,
        extent: Extent | None = None,
    ) -> jax.Array:
        """Run on one image. `params` may hold entries of stages that are not here.

        With an extent the image is the top left of a frame, and the rest of the result has no meaning. The
        frame has to be larger by `margin`, or as large, along each axis.

        Raises:
            InputError: a parameter is NaN or out of its bounds; of traced ones nothing is known.
            TypeError: a key is missing, or parameters or image are of another kind; or a stage's result would
                depend on the frame.
        """
        if extent is not None and self.margin is None:
            raise TypeError(f"{self.name} depends on the size of its frame: give the picture alone")
        if self.stochastic and key is None:
            raise TypeError(f"{self.name} draws noise: pass key=jax.random.key(seed)")
        if key is not None:
            check_key(self.name, key)
        self.check(params)
        # a stage's branches and loops need them alike
        return self.in_frame(*alike((params, image, key, extent)))

    def in_frame(self, params: Params, image: jax.Array, key: jax.Array | None, extent: Any) -> jax.Array:
        """`apply`, whose extent a node of a user's own may not take: it gets none where there is none."""
        frame = () if extent is None else (extent,)
        return self.apply(params, image, key, *frame)


def require_node(node: Any, what: str) -> None:
    """Raise TypeError, in words, where something else is given in the place of a stage or a pipeline."""
    if isinstance(node, Node):
        return
    if isinstance(node, str) and is_stage(node):
        advice = f"{node!r}: stage({node!r})?"
    elif isinstance(node, str):
        advice = f"{node!r}: stage(NAME) is one, and jaxisp.recipes.find_recipe(NAME).chain"
    elif isinstance(getattr(node, "chain", None), Node):  # a recipe, which is above this module
        advice = f"a {type(node).__name__}: give its .chain"
    elif isinstance(node, list | tuple) and node and all(isinstance(n, Node) for n in node):
        advice = f"a {type(node).__name__} of {len(node)}: Chain((...)) makes one of several"
    else:
        advice = f"{short(node)}, expected what stage(...) makes"
    raise TypeError(f"{what} takes stages and pipelines, got {advice}")


def require_name(name: Any, what: str) -> None:
    """Raise TypeError, in words, where something else is given in the place of a name."""
    if not isinstance(name, str):
        raise TypeError(f"the name of a {what} is text, got {short(name)}")


@dataclass(frozen=True, repr=False)
class Around(Node):
    """A node around another, whose domains and stages are its own; it adds one entry to the parameters."""

    node: Node

    @property
    def domain_in(self) -> Domain:
        return self.node.domain_in

    @property
    def domain_out(self) -> Domain:
        return self.node.domain_out

    def stages(self) -> Iterator["Stage"]:
        return self.node.stages()

    def names(self) -> Iterator[str]:
        yield self.name
        yield from self.node.names()


@dataclass(frozen=True, repr=False)
class Stage(Node):
    """A stage function with its static options bound and a name. Build it with `stage`.

    The result has the image's dtype. Images of half precision are computed in float32 and rounded at the end;
    parameters take the dtype that is computed in.

    Example:
        >>> import jaxisp
        >>> isinstance(jaxisp.stage("unsharp_mask"), jaxisp.Stage)
        True
    """

    fn: Callable[..., jax.Array]
    name: str
    static: tuple[tuple[str, Hashable], ...] = ()

    def __post_init__(self) -> None:
        declared = signature(self.fn)
        require_name(self.name, "stage")
        for option, value in self.static:
            if option not in dict(declared.static):
                raise TypeError(f"{self.fn.__name__} has no option {option!r}" + _has(declared, option))
            if option in declared.hints:
                check_option(f"{self.fn.__name__}: option {option}", declared.hints[option], value)

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

    @property
    def reach(self) -> int | None:
        known = locality(self.fn).reach
        return known(self.options) if callable(known) else known

    @property
    def block(self) -> int:
        known = locality(self.fn).block
        return known(self.options) if callable(known) else known

    @property
    def margin(self) -> int | None:
        if signature(self.fn).sized:
            return 0
        return self.reach if locality(self.fn).symmetric or not self.reach else None

    def stages(self) -> Iterator["Stage"]:
        yield self

    def names(self) -> Iterator[str]:
        yield self.name

    def init(self) -> Params:
        cls = signature(self.fn).params
        return {} if cls is None else {self.name: cls()}

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        declared = signature(self.fn)
        self._check_image(image)
        arguments: dict[str, Any] = dict(self.static)
        if declared.sized:
            arguments["extent"] = extent
        elif extent is not None and self.reach:
            image = mirrored(image, extent)
        if declared.stochastic:
            assert key is not None, "__call__ has checked it"
            arguments["key"] = jax.random.fold_in(key, zlib.crc32(self.name.encode()) & 0x7FFFFFFF)
        dtype, exact = given_and_exact(image)
        inputs: tuple[Any, ...] = (image,) if dtype == exact else (lax.convert_element_type(image, exact),)
        if declared.params is not None:
            inputs = (in_dtype(entry(params, self.name, declared.params), exact), *inputs)
        out = self.fn(*inputs, **arguments)
        return out if dtype == exact else lax.convert_element_type(out, dtype)

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
        InputError: no stage of that name (a KeyError too); an option of another type, or not within its
            limits.
        TypeError: no function, no such option.

    Example:
        >>> import jaxisp
        >>> sensor = jaxisp.stage("mosaic", cfa="RGGB", name="sensor")
        >>> sensor.name, sensor.options["cfa"], sensor.domain_out.name
        ('sensor', 'RGGB', 'mosaic')
    """
    if isinstance(fn, str):
        fn = find_stage(fn)
    if isinstance(fn, Node) or not callable(fn):
        got = (
            f"{type(fn).__name__} {fn.name!r}, which is a node already" if isinstance(fn, Node) else repr(fn)
        )
        raise TypeError(f"stage takes a stage function or a registered name, got {got}")
    known = dict(signature(fn).static)
    given = {n: _frozen(v) for n, v in sorted(static.items())}
    Stage(fn, name or fn.__name__, tuple(given.items()))  # checks them, those that equal the default too
    return Stage(fn, name or fn.__name__, tuple((n, v) for n, v in given.items() if v != known[n]))


def _has(declared: Signature, option: str) -> str:
    """What a stage has in place of an unknown option."""
    if declared.params is not None and option in specs(declared.params):
        return f": it is a parameter, {declared.params.__name__}({option}=...), which is passed when it runs"
    known = sorted(dict(declared.static))
    return meant(option, known) or f"; it has {known or 'none'}"


def _frozen(value: Any) -> Hashable:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(_frozen(v) for v in value) if isinstance(value, list | tuple) else value
