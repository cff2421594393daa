"""What a stage function declares by its signature, and the registry of stages.

A stage is a pure function on ONE image, `fn([params,] image, *, [key,] **static) -> image`: `params` is
annotated with its class, `image` and the return with a domain, `key` makes it stochastic, other
keyword-only arguments are static options.
"""

import functools
import inspect
import re
import typing
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import jax

from jaxisp.domains import Domain

REGISTRY: dict[str, Callable[..., jax.Array]] = {}


def register(fn: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """Add a stage function to `REGISTRY` under its name, checking its signature; return it unchanged.

    A registered stage can be named in TOML, is listed by `jaxisp stages`, and gets every contract
    test. Users register their own in the same way; a notebook's cell that is run again replaces its own.
    """
    known = REGISTRY.get(fn.__name__, fn)
    if (known.__module__, known.__qualname__) != (fn.__module__, fn.__qualname__):
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
    checks: tuple[tuple[str, Callable[[Any], Any]], ...] = ()
    """By static option annotated as `Annotated[T, check]`: what raises ValueError where a value is none."""


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
    checks = tuple((n, hints[n].__metadata__[0]) for n in static if hasattr(hints.get(n), "__metadata__"))
    return Signature(
        hints.get("params"), "key" in arguments, tuple(static.items()), domain_in, domain_out, checks
    )


def sections(fn: Callable[..., Any]) -> dict[str, str]:
    """The named sections (Args, Returns, Gradient, Source, ...) of a docstring, and its "Summary"."""
    text = inspect.getdoc(fn) or ""
    parts = re.split(r"^(Args|Returns|Raises|Gradient|Source|Example):[ ]*", text, flags=re.MULTILINE)
    found = {"Summary": parts[0].strip().split("\n\n")[0]}
    for title, body in zip(parts[1::2], parts[2::2]):
        found[title] = inspect.cleandoc(body).strip()
    return {title: " ".join(body.split()) for title, body in found.items()}
