"""Choices of a simulator beside its coordinates: the demosaicker, the grid of an earlier compression, the
file's encoder, and whether its chroma sampling is in it."""

import dataclasses

import numpy as np

from jaxisp.encoder import encoder_of as stated_encoder
from jaxisp.gap.simulator.model import Model, samples_chroma
from jaxisp.io import Jpeg
from jaxisp.pipeline import Chain, Node, Params, Stage, stage
from jaxisp.stages.choice import DEMOSAICKERS, HALVED, ChromaSubsampling


def with_earlier_grid(model: Model, place: tuple[int, int]) -> Model:
    """The model whose earlier compression, if it is tried, began at this row and column."""
    name = "double_compression"
    row, column = (np.float32(v) for v in place)
    moved = dataclasses.replace(model.shared[name], row=row, column=column)
    return dataclasses.replace(model, shared=model.shared | {name: moved})


def unsampled(model: Model, file: Jpeg | None) -> Model:
    """The model less the chroma sampling that stands for this file's: what the file is made of."""
    if file is None or file.subsampling not in HALVED:
        return model
    last = next((n.name for n in reversed(model.chain.nodes) if samples_chroma(n)), None)
    if last is None:
        return model
    whole = ChromaSubsampling(horizontal=np.float32(0), vertical=np.float32(0))
    return model.with_shared(model.shared | {last: whole})


def encoder_of(file: Jpeg | None) -> tuple[Stage, Params]:
    """The encoder that the file's header states, and its parameters; rounding if it is not modelled."""
    return stated_encoder(file, "file") or (stage("rounding"), {})


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
    if "partner" in options:  # a mix of two: others can have a share, too
        return stage(node.fn, name=node.name, cfa=node.options["cfa"], algorithm=node.options["algorithm"])
    if options or name not in algorithms:
        return node
    return stage("demosaicking", cfa=node.options["cfa"], algorithm=algorithms[name])
