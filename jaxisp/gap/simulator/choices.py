"""Choices of a simulator beside its coordinates: the demosaicker, and the grid of an earlier compression."""

import dataclasses

import numpy as np

from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Chain, Node, Stage, stage
from jaxisp.stages.choice import DEMOSAICKERS


def with_earlier_grid(model: Model, place: tuple[int, int]) -> Model:
    """The model whose earlier compression, if it is tried, began at this row and column."""
    name = "double_compression"
    row, column = (np.float32(v) for v in place)
    moved = dataclasses.replace(model.shared[name], row=row, column=column)
    return dataclasses.replace(model, shared=model.shared | {name: moved})


def with_choice(chain: Chain) -> Chain:
    """The chain with its demosaicking stage as a choice of all, so that another can be tried."""
    return Chain(tuple(_as_choice(node) for node in chain.nodes), chain.name)


def _as_choice(node: Node) -> Node:
    if not isinstance(node, Stage):
        return node
    name, options = node.fn.__name__, {k: v for k, v in node.static if k != "cfa"}
    if (name, options) == ("demosaic_ahd", {"delta": 1, "variant": "libraw"}):
        name, options = DEMOSAICKERS["ahd-libraw"].__name__, {}
    algorithms = {fn.__name__: algorithm for algorithm, fn in DEMOSAICKERS.items()}
    if options or name not in algorithms:
        return node
    return stage("demosaicking", cfa=node.options["cfa"], algorithm=algorithms[name])
