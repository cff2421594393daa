"""A given simulator's nodes, made ready to be a base: no switches, names of their own, the file's end."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from jaxisp.domains import CAMERA, ENCODED, MOSAIC, accepts
from jaxisp.errors import InputError
from jaxisp.gap.base.plain_clean import encoder_of
from jaxisp.gap.simulator.effects import Effect
from jaxisp.gap.simulator.model import is_file
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Gate, Node, Params, Row, Shuffle, Stage
from jaxisp.priors import is_distribution
from jaxisp.recipe import Recipe


def flat_nodes(nodes: Sequence[Node], recipe: Recipe) -> Iterator[Node]:
    """The nodes that run, in order, with no switch about them."""
    for node in nodes:
        own: Any = recipe.prior.get(node.name)
        if isinstance(node, Gate | Shuffle) and any(is_distribution(v) for v in vars(own).values()):
            raise InputError(
                f"recipe {recipe.name!r} draws {node.name!r} at random, so that it is several simulators; "
                "give one by a constant"
            )
        if isinstance(node, Gate):
            yield from flat_nodes((node.node,), recipe) if float(own.on) > 0.5 else ()
        elif isinstance(node, Shuffle):
            yield from flat_nodes([node.nodes[i] for i in np.argsort(own.priority)], recipe)
        elif isinstance(node, Row):
            yield from flat_nodes(node.nodes, recipe)
        else:
            yield node


def makes_mosaic(node: Node) -> bool:
    """Whether it takes light to a mosaic."""
    return node.domain_out == MOSAIC and node.domain_in != MOSAIC


def demosaics(node: Node) -> bool:
    """Whether it takes a mosaic to camera RGB."""
    return node.domain_in == MOSAIC and node.domain_out == CAMERA


def check_recipe(nodes: Sequence[Node], recipe: Recipe) -> None:
    """Raise InputError unless nodes take encoded sRGB through one mosaic back to encoded sRGB."""
    counts = [sum(map(kind, nodes)) for kind in (makes_mosaic, demosaics)]
    if counts != [1, 1]:
        raise InputError(
            f"recipe {recipe.name!r} has {counts[0]} stages that make a mosaic and {counts[1]} that "
            "demosaick it; a diagnosis needs one of each, as `phone` and `phone-bilinear` have"
        )
    chain = Chain(tuple(nodes))
    if not accepts(chain.domain_in, ENCODED) or chain.domain_out != ENCODED:
        raise InputError(
            f"recipe {recipe.name!r} turns {chain.domain_in.name} into {chain.domain_out.name}; a diagnosis "
            "needs encoded sRGB into encoded sRGB"
        )


def renamed(nodes: Sequence[Node], effects: Sequence[Effect]) -> tuple[list[Node], dict[str, str]]:
    """The nodes, those renamed that have an effect's name and are another stage; and new names by old."""
    fns = {e.name: e.node.fn for e in effects if isinstance(e.node, Stage)}
    names, found = {}, []
    for node in nodes:
        if isinstance(node, Stage) and node.name in fns and node.fn is not fns[node.name]:
            names[node.name] = f"own_{node.name}"
            node = dataclasses.replace(node, name=names[node.name])
        found.append(node)
    return found, names


def with_file(nodes: Sequence[Node], file: Jpeg | None) -> tuple[list[Node], Params]:
    """The nodes with what the files' header states as the last compression."""
    encoder, tables = encoder_of(file)
    kept = list(nodes)
    if tables:
        while is_file(kept[-1]):
            if kept.pop().name.startswith("jpeg"):  # one before the last is an effect that is modelled
                break
    if tables or not is_file(kept[-1]):
        kept.append(encoder)
    return kept, tables
