"""What a static option may be, said beside its type: `cell: Annotated[int, at_least(2)] = 4`."""

import math
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from jaxisp.errors import InputError, meant, short

_KINDS: dict[Any, tuple[type, ...]] = {
    bool: (bool,), int: (int,), float: (float, int), str: (str,), type(None): (type(None),),
}  # fmt: skip


@dataclass(frozen=True)
class Limit:
    """A condition on an option's value, in words and as a test; names of which it must be one."""

    text: str
    holds: Callable[[Any], bool]
    names: tuple[str, ...] = ()


def one_of(*values: str) -> Limit:
    """One of some words."""
    return Limit(f"one of {', '.join(map(repr, values))}", lambda value: value in values, values)


def at_least(least: float) -> Limit:
    """That number or more."""
    return Limit(f"{least} or more", lambda value: bool(value >= least))


def between(least: float, most: float) -> Limit:
    """From one number to another, both included."""
    return Limit(f"from {least} to {most}", lambda value: bool(least <= value <= most))


def below(most: float) -> Limit:
    """Less than a number."""
    return Limit(f"below {most}", lambda value: bool(value < most))


positive = Limit("positive", lambda value: bool(value > 0))
even = Limit("even", lambda value: value % 2 == 0)


Positive = Annotated[int, at_least(1)]
Count = Annotated[int, at_least(0)]
Share = Annotated[float, between(0, 1)]


def check_option(name: str, hint: Any, value: Any) -> None:
    """Raise InputError where a value is not of the type that is annotated, or not within its limits.

    Annotations other than bool, int, float, text and None are not checked.
    """
    kind, *limits = typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else (hint,)
    options = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    if all(k in _KINDS for k in options):
        # a bool is an int elsewhere
        if not any(type(value) in _KINDS[k] for k in options):
            wanted = " or ".join("None" if k is type(None) else k.__name__ for k in options)
            raise InputError(f"{name} must be {wanted}, got {short(value)}")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{name} must be finite, got {short(value)}")
    for limit in limits:
        if isinstance(limit, Limit) and not limit.holds(value):
            hint = meant(value, limit.names) if isinstance(value, str) else ""
            raise InputError(f"{name} must be {limit.text}, got {short(value)}{hint}")
