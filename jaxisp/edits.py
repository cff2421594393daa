"""Edits of pipelines: insert, replace, leave out, other options. Each returns a new chain.

A name is that of a node at any depth. A gate goes with the node in it: what is inserted beside that node
stands outside of the gate, and a gate around nothing is left out.
"""

import dataclasses
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from jaxisp.errors import InputError, meant, short
from jaxisp.node import Node, Stage, stage

Edit = Callable[[Node], tuple[Node, ...] | None]
"""What takes a node's place; None: the node stays, and what is in it is edited."""
C = TypeVar("C", bound=Node)


def by_stage(who: str, stages: Any, named: Mapping[str, Any]) -> dict[str, Any]:
    """What `override` was given, as one dict and by name."""
    if stages is not None and not isinstance(stages, Mapping):
        raise InputError(f"{who!r}: override takes dicts by stage, as median={{...}}, got {short(stages)}")
    if twice := sorted(set(stages or {}) & set(named)):
        raise InputError(f"{who!r}: override was given {twice[0]} twice")
    return {str(name): values for name, values in (stages or {}).items()} | dict(named)


def insert(chain: C, nodes: tuple[Node, ...], before: str | None, after: str | None) -> C:
    """The chain with nodes beside the one of a name."""
    if (before is None) == (after is None) or not nodes:
        raise InputError(
            f"{chain.name!r}: insert takes stages and one of before= and after=, the name of a stage"
        )
    name = before if before is not None else after
    assert name is not None
    _require(chain, name)

    def beside(node: Node) -> tuple[Node, ...] | None:
        if name not in (node.name, _gated(node)):
            return None
        return (*nodes, node) if before is not None else (node, *nodes)

    return _edited(chain, beside)


def replace(chain: C, name: str, new: Node) -> C:
    """The chain with another node in the place of the one of that name."""
    _require(chain, name)
    return _edited(chain, lambda node: (new,) if node.name == name else None)


def without(chain: C, *names: str) -> C:
    """The chain less the nodes of those names."""
    for name in names:
        _require(chain, name)
    return _edited(chain, lambda node: () if node.name in names else None)


def with_options(chain: C, options: Mapping[str, Mapping[str, Any]]) -> C:
    """The chain with other static options, by the names of its stages."""
    for name in options:
        _require(chain, name)

    def with_own(node: Node) -> tuple[Node, ...] | None:
        if node.name not in options:
            return None
        if not isinstance(node, Stage):
            raise InputError(f"{chain.name}: {node.name} has no options, only stages have")
        return (stage(node.fn, name=node.name, **{**dict(node.static), **options[node.name]}),)

    return _edited(chain, with_own)


def _edited(chain: C, edit: Edit) -> C:
    # the chain's own name is that of no node in it
    return dataclasses.replace(chain, nodes=_each(chain.nodes, edit))  # type: ignore[type-var, attr-defined]


def _each(nodes: tuple[Node, ...], edit: Edit) -> tuple[Node, ...]:
    return tuple(new for node in nodes for new in _new(node, edit))


def _new(node: Any, edit: Edit) -> tuple[Node, ...]:
    new = edit(node)
    if new is not None:
        return new
    inner = getattr(node, "nodes", None)
    if inner is not None:
        own = _each(inner, edit)
        return (node if same(own, inner) else dataclasses.replace(node, nodes=own),) if own else ()
    held = getattr(node, "node", None)
    if held is None:
        return (node,)
    own = _new(held, edit)
    if same(own, (held,)):
        return (node,)
    name = "" if node.name == f"use_{held.name}" else node.name
    return tuple(dataclasses.replace(node, node=n, name=name) for n in own)


def same(nodes: tuple[Node, ...], others: tuple[Node, ...]) -> bool:
    """Whether these are the very nodes; equal chains may have other names."""
    return len(nodes) == len(others) and all(map(operator.is_, nodes, others))


def _gated(node: Any) -> str | None:
    """The name of the node that a gate holds."""
    return getattr(getattr(node, "node", None), "name", None)


def _all(node: Any) -> Iterator[str]:
    yield node.name
    for inner in getattr(node, "nodes", ()) or filter(None, [getattr(node, "node", None)]):
        yield from _all(inner)


def _require(chain: Any, name: str) -> None:
    known = [found for node in chain.nodes for found in _all(node)]
    if name not in known:
        own = getattr(name, "name", None)  # of a stage that was given itself
        hint = f"; give its name, {own!r}" if own in known else meant(str(name), known)
        raise InputError(f"{chain.name!r} has no stage {short(name)}{hint or f'; it has {known}'}")
