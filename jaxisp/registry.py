"""What a stage function declares by its signature, and the registry of stages.

A stage is a pure function on ONE image, `fn([params,] image, *, [key,] [extent,] **static) -> image`:
`params` is annotated with its class, `image` and the return with a domain, `key` makes it stochastic, with an
`extent` the picture may be a part of the image, other keyword-only arguments are static options.
"""

import functools
import importlib
import inspect
import re
import typing
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, overload
from weakref import WeakKeyDictionary

import jax

from jaxisp.domains import Domain
from jaxisp.errors import UnknownStage, meant

StageFunction = Callable[..., jax.Array]
Reach = int | None | Callable[[Mapping[str, Any]], int | None]
"""Pixels, or a function of the static options that gives them; None: the whole frame, or not known."""

_OWN = ("key", "extent")  # keyword arguments that are no options

REGISTRY: dict[str, StageFunction] = {}
"""Registered stage functions by name. `find_stage` sees to it that the package's own are there."""

Block = int | Callable[[Mapping[str, Any]], int]
"""Rows, or a function of the static options that gives them."""

CELL = 2
"""Rows of a Bayer mosaic's cell."""
LARGEST_CELL = 6
"""Of X-Trans."""


@dataclass(frozen=True)
class Locality:
    """How a stage may be cut into strips of rows: how far it looks, and where a strip may begin."""

    reach: Reach = None
    block: Block = CELL
    symmetric: bool = False


_LOCALITY: WeakKeyDictionary[StageFunction, Locality] = WeakKeyDictionary()


@overload
def register(fn: StageFunction, /) -> StageFunction: ...
@overload
def register(
    *, reach: Reach = None, block: Block = CELL, symmetric: bool = False
) -> Callable[[StageFunction], StageFunction]: ...
def register(
    fn: StageFunction | None = None,
    /,
    *,
    reach: Reach = None,
    block: Block = CELL,
    symmetric: bool = False,
) -> Any:
    """Add a stage function to `REGISTRY` under its name, checking its signature; return it unchanged.

    A registered stage can be named in TOML, is listed by `jaxisp stages`, and gets every contract
    test. Users register their own in the same way, as `@register` or `@register(reach=2)`; a notebook's
    cell that is run again replaces its own.

    Args:
        fn: the stage function.
        reach: how far from a pixel its result depends on the image [px], borders reflected, 0 for what is
            pointwise; or a function of the static options that gives this. Chains work on large frames in
            strips of rows with so many more around them. None, the default: the result depends on the whole
            frame or on a pixel's position, and the stage runs on the whole frame.
        block: rows of the blocks it works in, counted from the top: 2 for a Bayer mosaic's cells, 6 for those
            of X-Trans; or a function of the static options. A stage of larger blocks, as an encoder, runs in
            strips of its own.
        symmetric: True where one pass alone looks beyond a pixel, or a mirror image comes out as the mirror
            image of the result, to the bit: no sum in any pass but the last depends on its order. Pictures
            of many sizes then share a program, see `Node.margin`; so they do where the reach is 0, and where
            the stage takes an `extent`.

    Raises:
        TypeError: it is no stage function, or one that draws noise has a reach.
        ValueError: another stage has its name.

    Example:
        >>> import jaxisp
        >>> from jaxisp.domains import LinearRGB
        >>> def negative(image: LinearRGB) -> LinearRGB:
        ...     "One minus the image. Gradient: exact."
        ...     return 1 - image
        >>> jaxisp.register(reach=0)(negative) is jaxisp.stage("negative").fn
        True
    """
    if fn is None:
        return functools.partial(_register, locality=Locality(reach, block, symmetric))
    return _register(fn, Locality(reach, block, symmetric))


def _register(fn: StageFunction, locality: Locality) -> StageFunction:
    if not fn.__module__.startswith("jaxisp."):
        _load_stages()  # else it would depend on what was imported before whether the name is free
    known = REGISTRY.get(fn.__name__, fn)
    if (known.__module__, known.__qualname__) != (fn.__module__, fn.__qualname__):
        raise ValueError(f"a stage named {fn.__name__!r} is registered already")
    declared = signature(fn)
    if declared.stochastic and locality.reach is not None:
        raise TypeError(f"{fn.__name__}: noise depends on a pixel's position, so that it has no reach")
    REGISTRY[fn.__name__] = fn
    _LOCALITY[fn] = locality
    return fn


def find_stage(name: str) -> StageFunction:
    """A registered stage function, whatever was imported so far. Raises UnknownStage where there is none."""
    if not is_stage(name):
        hint = meant(name, REGISTRY) or "; `jaxisp stages` and jaxisp.STAGES have all"
        raise UnknownStage(f"no stage named {name!r}{hint}")
    return REGISTRY[name]


def is_stage(name: str) -> bool:
    """Whether a stage of that name is registered, whatever was imported so far."""
    if name not in REGISTRY:
        _load_stages()
    return name in REGISTRY


def _load_stages() -> None:
    importlib.import_module("jaxisp.stages")  # they import this module, and register themselves


def locality(fn: StageFunction) -> Locality:
    """What was said of a stage function when it was registered; of others nothing is known."""
    return _LOCALITY.get(fn, Locality())


@dataclass(frozen=True, eq=False)
class Signature:
    """What a stage function declares."""

    params: type | None
    stochastic: bool
    sized: bool
    """Whether it takes an `Extent`."""
    static: tuple[tuple[str, Hashable], ...]
    hints: Mapping[str, Any]
    """Annotations of the static options."""
    domain_in: Domain
    domain_out: Domain


@functools.cache
def signature(fn: StageFunction) -> Signature:
    """Read a stage function's declaration. Raises TypeError where it is not one."""
    hints = typing.get_type_hints(fn, include_extras=True)
    arguments = inspect.signature(fn).parameters
    positional = [n for n, a in arguments.items() if a.kind is not a.KEYWORD_ONLY]
    static = {n: a.default for n, a in arguments.items() if a.kind is a.KEYWORD_ONLY and n not in _OWN}
    if positional not in (["image"], ["params", "image"]):
        raise TypeError(f"{fn.__name__}: positional arguments must be ([params,] image), got {positional}")
    for name, default in static.items():
        if default is inspect.Parameter.empty:
            raise TypeError(f"{fn.__name__}: static option {name} needs a default")
    try:
        domain_in, domain_out = (hints[n].__metadata__[0] for n in ("image", "return"))
    except (KeyError, AttributeError):
        raise TypeError(
            f"{fn.__name__}: annotate image and return with a domain of jaxisp.domains, as "
            "(image: LinearRGB) -> LinearRGB"
        ) from None
    limits = {name: hints[name] for name in static if name in hints}
    return Signature(
        hints.get("params"),
        "key" in arguments,
        "extent" in arguments,
        tuple(static.items()),
        limits,
        domain_in,
        domain_out,
    )


def sections(fn: Callable[..., Any]) -> dict[str, str]:
    """The named sections (Args, Returns, Gradient, Source, ...) of a docstring, and its "Summary"."""
    text = inspect.getdoc(fn) or ""
    parts = re.split(r"^(Args|Returns|Raises|Gradient|Source|Example):[ ]*", text, flags=re.MULTILINE)
    found = {"Summary": parts[0].strip().split("\n\n")[0]}
    for title, body in zip(parts[1::2], parts[2::2]):
        found[title] = inspect.cleandoc(body).strip()
    return {title: " ".join(body.split()) for title, body in found.items()}
