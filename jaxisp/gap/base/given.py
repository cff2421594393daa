"""A simulator that is given is the base of clean+noisy pairs. Its stages and its constants are believed.

What a recipe draws anew for each image it leaves open: these numbers are what they are in the real camera, as
far as the recipe can draw them, and are fitted within the range of their priors.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxisp.camera import with_cfa
from jaxisp.gap.base.given_chain import (
    check_recipe,
    demosaics,
    flat_nodes,
    makes_mosaic,
    on_own_stage,
    renamed,
    with_file,
)
from jaxisp.gap.base.plain_clean import read_out
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.simulator.choices import with_choice
from jaxisp.gap.simulator.effects import Effect, Move
from jaxisp.gap.simulator.model import Coordinate, Model, build, is_file
from jaxisp.gap.simulator.render import Kept, render
from jaxisp.io.jpeg import Jpeg
from jaxisp.params import specs
from jaxisp.pipeline import Chain, Node, Params, Stage, stage
from jaxisp.priors import Bernoulli, Choice, LogUniform, is_distribution
from jaxisp.recipe import Recipe

_QUANTILES = (0.02, 0.08, 0.22, 0.5, 0.7, 0.85, 0.95)
_LEAST = {"shot": 1e-4, "read": 4e-3, "std": 4e-3}
"""Noise of which a quarter is a step that can be seen."""


@dataclasses.dataclass(frozen=True)
class Open:
    """A number that is fitted: entry `index` of a field of a node, drawn from `law` by the recipe."""

    node: str
    field: str
    index: tuple[int, ...]
    law: Any

    @property
    def steady(self) -> bool:
        """Whether every value of its range is meant, not some levels only."""
        return not isinstance(self.law, Choice | Bernoulli)

    @property
    def levels(self) -> list[float]:
        """Values to try, rising."""
        if isinstance(self.law, Choice):
            return sorted(self.law.values)
        if isinstance(self.law, Bernoulli):
            return [0.0, 1.0]
        drawn = np.asarray(self.law.sample(jax.random.key(0), (1001,)), float)
        return [float(v) for v in np.quantile(drawn, _QUANTILES)]

    @property
    def median(self) -> float:
        return self.levels[len(self.levels) // 2]

    def placed(self, params: Params, value: float) -> Params:
        """The parameters with this number set."""
        field = np.array(getattr(params[self.node], self.field), np.float32)
        field[self.index] = value
        return params | {self.node: dataclasses.replace(params[self.node], **{self.field: field})}

    def coordinate(self, params: Params) -> Coordinate:
        """How it may move from where it is."""
        value = float(np.asarray(getattr(params[self.node], self.field))[self.index])
        low, high = self.law.support
        step = 0.25 * max(abs(value), 0.0 if isinstance(self.law, LogUniform) else 0.05 * (high - low))
        return Coordinate(self.node, Move(self.field, step, low - value, high - value, self.index))


@dataclasses.dataclass(frozen=True)
class GivenBase:
    """A simulator, from linear light to the file.

    Attributes:
        about: what it is, for the report.
        chain: its nodes.
        params: its constants, and the medians of what it draws.
        open: what is fitted to the statistics.
        mean: what is fitted besides, near where it is.
        absorbed: effects that its open numbers absorb.
    """

    about: str
    chain: Chain
    params: Params
    open: tuple[Open, ...] = ()
    mean: tuple[Coordinate, ...] = ()
    absorbed: tuple[str, ...] = ()

    @property
    def fitted(self) -> set[str]:
        """The nodes that have something open."""
        return {o.node for o in self.open} | {c.node for c in self.mean}

    @property
    def still(self) -> Chain:
        """Without noise and file."""
        nodes = [n for n in self.chain.nodes if not n.stochastic]
        while is_file(nodes[-1]):
            nodes.pop()
        return Chain(tuple(nodes), self.chain.name)

    def noise_free(self, light: jax.Array) -> np.ndarray:
        """(N, H, W, 3) pictures of light (N, H, W, 3) without noise and file, Y'CbCr in 8-bit steps."""
        own = {name: self.params[name] for name in self.still.init()}
        pictures = render(self.still, own, {}, light, None, Kept())
        return to_steps(np.clip(pictures, 0, 1))

    def free(self, params: Params) -> tuple[Coordinate, ...]:
        """What is fitted, from where it is."""
        return (*(o.coordinate(params) for o in self.open if o.steady), *self.mean)

    def whole_model(self, effects: Sequence[Effect]) -> tuple[Model, list[str], list[str]]:
        """The base with every effect in it, off.

        Returns:
            the model; the names of the effects that can be tried; of those that what is open absorbs.
        """
        present = {s.name for s in self.chain.stages()}
        tried: list[Effect] = []
        absorbed: list[Effect] = []
        on_own: dict[str, tuple[Coordinate, ...]] = {}
        for e in effects:
            if e.name in present:
                on_own[e.name] = self._moves(e)
            elif e.name == "noise_level" and self._noise_moves():
                on_own[e.name] = self._noise_moves()
            elif e.site == "demosaic":
                continue  # the simulator's own algorithm is not a known one
            taken = e.name in self.absorbed or on_own.get(e.name) == ()
            (absorbed if taken else tried).append(e)
        inserted = [e for e in tried if e.name not in on_own or e.name in present]
        free = self.free(self.params)
        model = build(self.chain, self.params, {}, free, inserted, keep_file=True)
        moving = {e.name: on_own[e.name] if e.name in on_own else model.effects[e.name] for e in tried}
        chain = read_out(model.chain, self._last_of_sensor())
        model = dataclasses.replace(model, chain=chain, effects=moving)
        return model, [e.name for e in tried], [e.name for e in absorbed]

    def rebased(self, model: Model, z: np.ndarray) -> Model:
        """The model with the base's z put into its parameters, the bounds moved along."""
        moved = model.moved(z)
        return dataclasses.replace(moved, base=self.free(moved.shared))

    def _moves(self, effect: Effect) -> tuple[Coordinate, ...]:
        """How an effect acts that the simulator has as a stage, beside what of it is open."""
        opened = {(o.field, o.index) for o in self.open if o.node == effect.name}
        return on_own_stage(effect, self.params[effect.name], opened)

    def _noise_moves(self) -> tuple[Coordinate, ...]:
        """The sensor's noise stronger or weaker than the simulator's constants have it."""
        opened = {(o.node, o.field) for o in self.open}
        found = []
        for node in self._sensor():
            own = self.params.get(node.name)
            for field in ("shot", "read", "std") if node.stochastic and own is not None else ():
                if not hasattr(own, field) or (node.name, field) in opened:
                    continue
                value, (_, most) = float(getattr(own, field)), specs(type(own))[field].bounds
                step = 0.25 * max(value, _LEAST[field])
                found.append(Coordinate(node.name, Move(field, step, -value, most - value)))
        return tuple(found)

    def _sensor(self) -> list[Node]:
        """The nodes from the mosaic up to where it is demosaicked."""
        nodes = self.chain.nodes
        first = next(i for i, n in enumerate(nodes) if makes_mosaic(n))
        last = next(i for i, n in enumerate(nodes) if demosaics(n))
        return list(nodes[first:last])

    def _last_of_sensor(self) -> str:
        """The node after which the sensor is read."""
        nodes = self._sensor()
        return next((n.name for n in reversed(nodes) if n.stochastic), nodes[0].name)


def of_recipe(recipe: Recipe, effects: Sequence[Effect], cfa: str, file: Jpeg | None) -> GivenBase:
    """A recipe as the base.

    The colour filter array is that of the pictures: which photosite comes first depends on where they were
    cut. What the header of the files states replaces the recipe's last compression.

    Args:
        recipe: encoded sRGB to encoded sRGB, with a mosaic and its demosaicking.
        effects: whose names are theirs.
        cfa: the pattern of the pictures.
        file: whose header is believed; None where the pictures are not JPEGs.

    Raises:
        InputError: it is not such a recipe, or it draws which stages run, or in which order.
    """
    nodes = [with_cfa(n, cfa) for n in flat_nodes(recipe.chain.nodes, recipe)]
    check_recipe(nodes, recipe)
    nodes, names = renamed(nodes, effects)
    if isinstance(nodes[0], Stage) and nodes[0].fn.__name__ == "srgb_eotf":
        nodes = nodes[1:]  # the light is linear already
    else:
        nodes = [stage("srgb_oetf", name="encoded"), *nodes]
    nodes, tables = with_file(nodes, file)
    chain = with_choice(Chain(tuple(nodes), recipe.name))
    params, opened = believed(recipe, names, chain.init())
    return GivenBase(f"recipe {recipe.name}", chain, params | tables, opened)


def believed(recipe: Recipe, names: Mapping[str, str], params: Params) -> tuple[Params, tuple[Open, ...]]:
    """A recipe's constants and medians in place of a chain's defaults, and what it leaves open; `names` are
    those of nodes that go by another there."""
    opened = []
    for name, values in recipe.prior.items():
        own = names.get(name, name)
        if own in params:
            params, found = _believed(params, own, values)
            opened += found
    return params, tuple(opened)


def _believed(params: Params, node: str, prior: Any) -> tuple[Params, list[Open]]:
    """A node's constants, and what it leaves open at its median."""
    opened = []
    for field in specs(type(prior)):
        value = getattr(prior, field)
        if not is_distribution(value):
            own = dataclasses.replace(params[node], **{field: np.asarray(value, np.float32)})
            params = params | {node: own}
            continue
        for index in np.ndindex(np.shape(getattr(params[node], field))):
            opened.append(Open(node, field, index, value))
            params = opened[-1].placed(params, opened[-1].median)
    return params, opened
