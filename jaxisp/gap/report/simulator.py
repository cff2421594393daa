"""The simulator with the causes that were found: a recipe to train on, or a camera to develop with."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxisp.camera import FROM_FILE
from jaxisp.cfa import is_xtrans
from jaxisp.gap.case import Case
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG
from jaxisp.gap.simulator.model import Model, samples_chroma
from jaxisp.node import Node
from jaxisp.params import specs
from jaxisp.pipeline import Chain, Gate, Params, Stage, stage
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, HALVED, Demosaicking

NAME = "diagnosed"


def simulator_of(case: Case, point: Point, causes: Sequence[str]) -> Recipe | None:
    """The base with its effects as they are at a point, and the encoder that the files' headers state.

    Of RAW+JPEG pairs it is a camera, mosaic to encoded sRGB; what RAW files state is taken from each. Of
    others it takes and returns encoded sRGB. What is off is left out, and nothing is drawn but noise. What
    pictures have of their own is left out too: the exposure of a clean one, the lens tags of a DNG.

    Args:
        case: the pairs and their base.
        point: the base alone, or with the causes.
        causes: names of the effects that were found.

    Returns:
        the recipe; None where a reference stands for the base.
    """
    if case.reference_gap is not None:
        return None
    model, (encoder, tables) = point.model, case.encoder or (None, {})
    own, stated, apart = _of_files(model, case.from_file)
    if encoder and encoder.options.get("subsampling") in HALVED:  # it samples chroma itself
        apart |= {n.name for n in [n for n in model.chain.nodes if samples_chroma(n)][-1:]}
    params = model.params(point.z) | own | tables
    nodes = [_plain(node, params) for node in model.chain.nodes if not apart & {*node.names()}]
    light = [] if case.kind == RAW_JPEG else [stage("srgb_eotf", name="light")]
    chain = Chain((*light, *filter(None, nodes), *filter(None, [encoder])), NAME)
    found = f"with {', '.join(causes)}" if causes else "without any effect besides"
    kind = case.kind if case.kind == CLEAN_NOISY else case.kind.upper()
    return Recipe(
        chain,
        {name: _within(params[name]) for name in chain.init() if name in params},
        f"{case.given or 'a plain camera'}, {found}; fitted to {len(case.split.fit)} {kind} pairs",
        {"causes": list(causes), **({"from_file": stated} if stated else {})},
    )


def _of_files(model: Model, from_file: Sequence[str]) -> tuple[Params, list[str], set[str]]:
    """What differs from pair to pair: parameters, of the first pair; those that a file states; what of it no
    camera has by itself."""
    params: Params = {}
    stated, apart = [], set()
    for name, values in model.per_pair.items():
        params[name] = jax.tree.map(lambda leaf: leaf[0], values)
        of_file = name in from_file and isinstance(values, FROM_FILE)
        neutral = isinstance(values, WhiteBalance) and np.allclose(values.gains, 1)
        if neutral or not (of_file or _alike(values)):
            apart.add(name)
        elif of_file:
            stated.append(name)
    return params, stated, apart


def _alike(values: Any) -> bool:
    return all(np.allclose(leaf, leaf[:1]) for leaf in jax.tree.leaves(values))


def _plain(node: Node, params: Params) -> Node | None:
    """A node without its switch, None where that is off; of a choice of Bayer demosaickers the chosen one."""
    if isinstance(node, Gate):
        return node.node if float(params[node.name].on) > 0.5 else None
    own = params.get(node.name)
    if not (isinstance(node, Stage) and isinstance(own, Demosaicking)):
        return node
    cfa, alone = str(node.options["cfa"]), str(node.options["algorithm"])
    if is_xtrans(cfa):
        return node
    shares = dict(zip(DEMOSAICKERS, np.asarray(own.shares)))
    taken = [name for name, share in shares.items() if share] or [alone]
    if len(taken) > 1 or shares[taken[0]] not in (0, 1):
        return node
    return stage(DEMOSAICKERS[taken[0]], cfa=cfa)


def _within(params: Any) -> Any:
    """Parameters without what rounding put beyond a bound."""
    fields = {
        name: np.clip(getattr(params, name), *spec.bounds) for name, spec in specs(type(params)).items()
    }
    return dataclasses.replace(params, **fields)
