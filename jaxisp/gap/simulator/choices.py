"""Choices of a simulator beside its coordinates: the demosaicker, and the grid of an earlier compression."""

import dataclasses

import numpy as np

from jaxisp.gap.simulator.model import (
    Model,
)
from jaxisp.pipeline import Chain, Stage, stage
from jaxisp.stages.choice import DEMOSAICKERS


def with_earlier_grid(model: Model, place: tuple[int, int]) -> Model:
    """The model whose earlier compression, if it is tried, began at this row and column."""
    name = "double_compression"
    row, column = (np.float32(v) for v in place)
    moved = dataclasses.replace(model.shared[name], row=row, column=column)
    return dataclasses.replace(model, shared=model.shared | {name: moved})


def with_choice(chain: Chain) -> Chain:
    """The chain with its demosaicking stage as a choice of all, so that another can be tried."""
    algorithms = {fn.__name__: name for name, fn in DEMOSAICKERS.items()}
    nodes = []
    for node in chain.nodes:
        if isinstance(node, Stage) and node.fn.__name__ in algorithms and set(dict(node.static)) <= {"cfa"}:
            node = stage("demosaicking", cfa=node.options["cfa"], algorithm=algorithms[node.fn.__name__])
        nodes.append(node)
    return Chain(tuple(nodes), chain.name)
