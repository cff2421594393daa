"""The simulator of clean+noisy pairs with the causes that were found, as a recipe to train on."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.case import Case
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.simulator.effects import CLEAN_NOISY
from jaxisp.node import Node
from jaxisp.params import specs
from jaxisp.pipeline import Chain, Gate, Params, stage
from jaxisp.recipe import Recipe

NAME = "diagnosed"


def simulator_of(case: Case, point: Point, causes: Sequence[str]) -> Recipe | None:
    """The base with its effects as they are at a point: encoded sRGB to encoded sRGB.

    What is off is left out, and nothing is drawn but noise. The exposure that each clean picture of the pairs
    had is left out too: it is for photographs as bright as the camera's own.

    Args:
        case: the pairs and their base.
        point: the base alone, or with the causes.
        causes: names of the effects that were found.

    Returns:
        the recipe; None for pairs whose simulator starts from a RAW or another JPEG, and where a reference
        stands for the base.
    """
    if case.kind != CLEAN_NOISY or case.reference_gap is not None:
        return None
    params = point.model.params(point.z)
    nodes = [_on(node, params) for node in point.model.chain.nodes]
    chain = Chain((stage("srgb_eotf", name="light"), *filter(None, nodes)), NAME)
    added = f"with {', '.join(causes)}" if causes else "without any effect besides"
    return Recipe(
        chain,
        {name: _within(params[name]) for name in chain.init() if name in params},
        f"{case.given or 'a plain camera'}, fitted to {len(case.split.fit)} clean+noisy pairs, {added}",
        {"causes": list(causes)},
    )


def _on(node: Node, params: Params) -> Node | None:
    """A node without its switch; None where that is off."""
    if not isinstance(node, Gate):
        return node
    return node.node if float(params[node.name].on) > 0.5 else None


def _within(params: Any) -> Any:
    """Parameters without what rounding put beyond a bound."""
    fields = {
        name: np.clip(getattr(params, name), *spec.bounds) for name, spec in specs(type(params)).items()
    }
    return dataclasses.replace(params, **fields)
