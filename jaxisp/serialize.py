"""Pipelines, parameters and priors as plain tables for TOML, and back unchanged.

A node is `{stage = "jpeg", name = "...", options = {...}}`, `{gate = NODE}`, `{any_phase = NODE}`,
`{unprocessed = NODE, options = {...}}`, `{shuffle = [NODE, ...]}` or `{chain = [NODE, ...]}`.
A parameter is a number, an array, or one distribution:
`{log_uniform = [0.01, 0.1]}`. Reading runs no code: stages are looked up in the registry.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

import jaxisp.stages  # noqa: F401  (fills the registry)
from jaxisp.checks import check_params
from jaxisp.errors import InputError, short
from jaxisp.params import specs
from jaxisp.phase import AnyPhase
from jaxisp.pipeline import Chain, Gate, Node, Row, Shuffle, Stage, stage
from jaxisp.priors import DISTRIBUTIONS, Choice, arguments, check_prior, is_distribution, is_traced
from jaxisp.unprocess import Unprocessed

Table = dict[str, Any]
_KINDS = {kind: name for name, kind in DISTRIBUTIONS.items()}


def encode_node(node: Node) -> Table:
    """A node as a table."""
    if isinstance(node, Stage):
        table: Table = {"stage": node.fn.__name__}
        if node.name != node.fn.__name__:
            table["name"] = node.name
        return table | ({"options": {n: _plain(v) for n, v in node.static}} if node.static else {})
    if isinstance(node, AnyPhase):
        return {"any_phase": encode_node(node.node), "name": node.name}
    if isinstance(node, Unprocessed):
        kept = {} if node.preserve else {"options": {"preserve": False}}
        return {"unprocessed": encode_node(node.node), "name": node.name, **kept}
    if isinstance(node, Gate):
        return {"gate": encode_node(node.node), "name": node.name}
    assert isinstance(node, Row)
    kind = "chain" if isinstance(node, Chain) else "shuffle"
    return {kind: [encode_node(n) for n in node.nodes], "name": node.name}


def decode_node(table: Any) -> Node:
    """The node of a table. Raises InputError where a stage or an option is unknown."""
    if not isinstance(table, dict):
        raise InputError(f"a stage must be a table like {{stage = 'jpeg'}}, got {short(table)}")
    kinds = [k for k in _DECODERS if k in table]
    unknown = set(table) - {*_DECODERS, "name", "options"}
    if len(kinds) != 1 or unknown:
        raise InputError(f"a stage must have one of {', '.join(_DECODERS)}; got {short(sorted(table))}")
    for key, kind, what in (("stage", str, "text"), ("name", str, "text"), ("options", dict, "a table")):
        if key in table and not isinstance(table[key], kind):
            raise InputError(f"{key} must be {what}, got {short(table[key])}")
    try:
        return _DECODERS[kinds[0]](table)
    except RecursionError:
        raise InputError("stages nested too deeply") from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(str(error.args[0])) from None


def _decode_stage(table: Table) -> Node:
    return stage(table["stage"], name=table.get("name"), **table.get("options", {}))


def _decode_unprocessed(table: Table) -> Node:
    options = table.get("options", {})
    if set(options) - {"preserve"} or not isinstance(options.get("preserve", True), bool):
        raise ValueError(f"unprocessed takes the option preserve, true or false, got {short(options)}")
    inner = decode_node(table["unprocessed"])
    return Unprocessed(inner, str(table.get("name", "unprocessed")), options.get("preserve", True))


def _named(kind: Callable[..., Node], inner: Any, table: Table) -> Node:
    return kind(inner, table["name"]) if "name" in table else kind(inner)


_DECODERS: dict[str, Callable[[Table], Node]] = {
    "stage": _decode_stage,
    "gate": lambda t: _named(Gate, decode_node(t["gate"]), t),
    "shuffle": lambda t: _named(Shuffle, tuple(map(decode_node, t["shuffle"])), t),
    "chain": lambda t: _named(Chain, tuple(map(decode_node, t["chain"])), t),
    "unprocessed": lambda t: _decode_unprocessed(t),
    "any_phase": lambda t: _named(AnyPhase, decode_node(t["any_phase"]), t),
}


def encode_params(tree: dict[str, Any]) -> Table:
    """Parameters or priors by stage name as tables. Raises InputError where a number is traced."""
    if is_traced(tree):
        raise InputError("numbers that are traced cannot be written: take the recipe out of jit")
    return {
        name: {f: _encode_leaf(getattr(values, f)) for f in specs(type(values))}
        for name, values in tree.items()
    }


def decode_params(tables: Any, node: Node) -> dict[str, Any]:
    """The parameters or priors of a node; what the tables leave out keeps its default.

    Raises:
        InputError: an unknown stage or parameter, a value out of bounds, or a broken distribution.
    """
    tree = node.init()
    if not isinstance(tables, dict):
        raise InputError(f"params must be tables by stage name, got {short(tables)}")
    for name, table in tables.items():
        if name not in tree:
            raise InputError(f"params.{name}: the pipeline has no stage of that name; it has {sorted(tree)}")
        known = specs(type(tree[name]))
        if not isinstance(table, dict) or set(table) - set(known):
            raise InputError(f"params.{name}: takes {sorted(known)}, got {short(table)}")
        read = {field: _decode_leaf(f"{name}.{field}", value) for field, value in table.items()}
        tree[name] = dataclasses.replace(tree[name], **read)
    constants = {n: _constants(v) for n, v in tree.items()}
    check_params(constants, batched=False)
    return check_prior(tree)


def _constants(values: Any) -> Any:
    """The parameters with the default wherever a distribution stands."""
    return dataclasses.replace(
        values,
        **{f: s.default for f, s in specs(type(values)).items() if is_distribution(getattr(values, f))},
    )


def _encode_leaf(value: Any) -> Any:
    if not is_distribution(value):
        return _plain(np.asarray(value, np.float32))
    return {_KINDS[type(value)]: [float(_plain(a)) for a in arguments(value)]}


def _decode_leaf(path: str, value: Any) -> Any:
    try:
        if not isinstance(value, dict):
            return np.asarray(_numbers(value), np.float32)
        ((kind, arguments),) = value.items()
        numbers = [float(_numbers(a)) for a in arguments]
        if not all(map(math.isfinite, numbers)):
            raise ValueError("not finite")
        return Choice(tuple(numbers)) if kind == "choice" else DISTRIBUTIONS[kind](*numbers)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError):  # a TOML integer may have any size
        kinds = ", ".join(DISTRIBUTIONS)
        raise InputError(
            f"{path} = {short(value)}: give a number, an array, or one of {kinds} with its numbers"
        ) from None


def _numbers(value: Any) -> np.ndarray:
    """Numbers, or true and false; ValueError for texts and dates, of which NumPy would make numbers."""
    given = np.asarray(value)
    if given.dtype.kind not in "iufb" and given.dtype != object:  # of integers of any size
        raise ValueError
    return given


def _plain(value: Any) -> Any:
    """Nested lists of Python numbers; a float32 by its shortest decimal, which reads back the same."""
    if (isinstance(value, np.ndarray) and value.ndim) or isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return float(str(value)) if isinstance(value, np.floating | np.ndarray) else value
