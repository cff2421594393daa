"""Preparation of a given simulator's nodes: no switches, unique names, the file's own compression."""

import dataclasses
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxisp.camera import with_cfa
from jaxisp.cfa import shifted
from jaxisp.domains import CAMERA, ENCODED, MOSAIC, accepts
from jaxisp.errors import InputError
from jaxisp.gap.simulator.choices import encoder_of
from jaxisp.gap.simulator.effects import Effect
from jaxisp.gap.simulator.model import Coordinate, is_file
from jaxisp.io.jpeg import Jpeg
from jaxisp.params import specs
from jaxisp.phase import AnyPhase
from jaxisp.pipeline import Chain, Gate, Node, Params, Row, Shuffle, Stage
from jaxisp.priors import is_distribution
from jaxisp.recipe import Recipe
from jaxisp.unprocess import Unprocessed


def flat_nodes(nodes: Sequence[Node], recipe: Recipe) -> Iterator[Node]:
    """Iterate over the nodes that run, in order, without their switches.

    Raises:
        InputError: the recipe draws a switch or an order at random.
    """
    for node in nodes:
        own: Any = recipe.prior.get(node.name)
        if isinstance(node, Gate | Shuffle | AnyPhase) and any(
            is_distribution(v) for v in vars(own).values()
        ):
            raise InputError(
                f"recipe {recipe.name!r} draws {node.name!r} at random, so that it is several simulators; "
                "give one by a constant"
            )
        if isinstance(node, Gate):
            yield from flat_nodes((node.node,), recipe) if float(own.on) > 0.5 else ()
        elif isinstance(node, Shuffle):
            yield from flat_nodes([node.nodes[i] for i in np.argsort(own.priority)], recipe)
        elif isinstance(node, AnyPhase):
            start = float(own.row) > 0.5, float(own.column) > 0.5
            for inner in flat_nodes((node.node,), recipe):
                cfa = inner.options.get("cfa") if isinstance(inner, Stage) else None
                yield inner if cfa is None else with_cfa(inner, shifted(str(cfa), *start))
        elif isinstance(node, Row):
            yield from flat_nodes(node.nodes, recipe)
        elif isinstance(node, Unprocessed):
            raise InputError(
                f"recipe {recipe.name!r} has its mosaic within {node.name!r}, whose colours a diagnosis does "
                "not take apart; give a recipe whose mosaic stands by itself, as `phone` or `darmstadt`"
            )
        else:
            yield node


def makes_mosaic(node: Node) -> bool:
    """Whether the node turns light into a mosaic."""
    return node.domain_out == MOSAIC and node.domain_in != MOSAIC


def demosaics(node: Node) -> bool:
    """Whether the node turns a mosaic into camera RGB."""
    return node.domain_in == MOSAIC and node.domain_out == CAMERA


def check_recipe(nodes: Sequence[Node], recipe: Recipe) -> None:
    """Raise InputError unless the nodes turn encoded sRGB into one mosaic and back into encoded sRGB."""
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


def check_camera(camera: Recipe) -> None:
    """Raise InputError unless the camera turns a mosaic into encoded sRGB and demosaicks it once."""
    nodes = list(flat_nodes(camera.chain.nodes, camera))
    chain = Chain(tuple(nodes))
    times = sum(map(demosaics, nodes))
    if not accepts(chain.domain_in, MOSAIC) or chain.domain_out != ENCODED or times != 1:
        raise InputError(
            f"camera {camera.name!r} turns {chain.domain_in.name} into {chain.domain_out.name}, demosaicking "
            f"{times} times; a diagnosis needs mosaic into encoded sRGB, demosaicked once"
        )


def renamed(
    nodes: Sequence[Node], effects: Sequence[Effect], apart: Sequence[str] = ()
) -> tuple[list[Node], dict[str, str]]:
    """Rename nodes whose names collide with effects.

    A node with an effect's name is renamed if its function differs from the effect's, or if `apart` lists it.

    Returns:
        the nodes; new name by old name.
    """
    fns = {e.name: e.node.fn for e in effects if isinstance(e.node, Stage)}
    names, found = {}, []
    for node in nodes:
        if isinstance(node, Stage) and node.name in fns and not _acts_on(node, fns, apart):
            names[node.name] = f"own_{node.name}"
            node = dataclasses.replace(node, name=names[node.name])
        found.append(node)
    return found, names


def _acts_on(node: Stage, fns: Mapping[str, Callable[..., Any]], apart: Sequence[str]) -> bool:
    return node.fn is fns[node.name] and node.name not in apart


def on_own_stage(
    effect: Effect, params: Any, opened: Container[tuple[str, tuple[int, ...]]] = ()
) -> tuple[Coordinate, ...]:
    """Coordinates of an effect that acts on a stage of the simulator.

    They start at the stage's constants and stay within the bounds of its parameters. Constants that have no
    room to move are left out.

    Args:
        effect: the effect; the simulator has its node.
        params: parameters of that stage.
        opened: (field, index) of numbers that are fitted anyway.
    """
    found = []
    for m in effect.moves:
        if (m.field, m.index) in opened:
            continue
        value = float(np.asarray(getattr(params, m.field))[m.index])
        low, high = specs(type(params))[m.field].bounds
        low, high = max(m.low, low - value), min(m.high, high - value)
        room = max(high, -low)
        if room <= 0:
            continue
        step = float(np.copysign(min(abs(m.step), room), m.step))
        far = tuple(v for v in m.far if low <= v <= high)
        found.append(Coordinate(effect.name, dataclasses.replace(m, low=low, high=high, step=step, far=far)))
    return tuple(found)


def with_file(nodes: Sequence[Node], file: Jpeg | None) -> tuple[list[Node], Params]:
    """Replace the last compression of the nodes by the one that the files' header states.

    Without such a header, the nodes keep their own; rounding is added if they have none.

    Returns:
        the nodes; the parameters of the new compression.
    """
    encoder, tables = encoder_of(file)
    kept = list(nodes)
    if tables:
        while is_file(kept[-1]):
            if kept.pop().name.startswith("jpeg"):  # earlier compressions stay
                break
    if tables or not is_file(kept[-1]):
        kept.append(encoder)
    return kept, tables
