"""A given simulator as the base of clean+noisy pairs; its stages and constants are kept.

Parameters that a recipe draws at random for each image are open: their values for the real camera are
unknown. They are fitted within the range of their priors.
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
"""Least noise amplitude for the step size of a fit; a quarter of it is a visible step."""


@dataclasses.dataclass(frozen=True)
class Open:
    """A fitted number: entry `index` of a field of a node, which the recipe draws from `law`."""

    node: str
    field: str
    index: tuple[int, ...]
    law: Any

    @property
    def steady(self) -> bool:
        """Whether the law is continuous rather than a choice among levels."""
        return not isinstance(self.law, Choice | Bernoulli)

    @property
    def levels(self) -> list[float]:
        """Values to try, in increasing order."""
        if isinstance(self.law, Choice):
            return sorted(self.law.values)
        if isinstance(self.law, Bernoulli):
            return [0.0, 1.0]
        drawn = np.asarray(self.law.sample(jax.random.key(0), (1001,)), float)
        return [float(v) for v in np.quantile(drawn, _QUANTILES)]

    @property
    def median(self) -> float:
        """The middle level."""
        return self.levels[len(self.levels) // 2]

    def placed(self, params: Params, value: float) -> Params:
        """The parameters with this number set."""
        field = np.array(getattr(params[self.node], self.field), np.float32)
        field[self.index] = value
        return params | {self.node: dataclasses.replace(params[self.node], **{self.field: field})}

    def coordinate(self, params: Params) -> Coordinate:
        """The coordinate of this number, with its range relative to the present value."""
        value = float(np.asarray(getattr(params[self.node], self.field))[self.index])
        low, high = self.law.support
        step = 0.25 * max(abs(value), 0.0 if isinstance(self.law, LogUniform) else 0.05 * (high - low))
        return Coordinate(self.node, Move(self.field, step, low - value, high - value, self.index))


@dataclasses.dataclass(frozen=True)
class GivenBase:
    """A given simulator, from linear light to the file.

    Attributes:
        about: description for the report.
        chain: its nodes.
        params: its constants, and the medians of its priors.
        open: numbers that are fitted to the statistics.
        mean: further coordinates of the mean that are fitted, near their present values.
        absorbed: names of effects that its open numbers absorb.
    """

    about: str
    chain: Chain
    params: Params
    open: tuple[Open, ...] = ()
    mean: tuple[Coordinate, ...] = ()
    absorbed: tuple[str, ...] = ()

    @property
    def fitted(self) -> set[str]:
        """Names of the nodes with fitted parameters."""
        return {o.node for o in self.open} | {c.node for c in self.mean}

    @property
    def still(self) -> Chain:
        """The chain without noise and file compression."""
        nodes = [n for n in self.chain.nodes if not n.stochastic]
        while is_file(nodes[-1]):
            nodes.pop()
        return Chain(tuple(nodes), self.chain.name)

    def noise_free(self, light: jax.Array) -> np.ndarray:
        """Render light (N, H, W, 3) without noise and file: (N, H, W, 3) Y'CbCr in 8-bit steps."""
        own = {name: self.params[name] for name in self.still.init()}
        pictures = render(self.still, own, {}, light, None, Kept())
        return to_steps(np.clip(pictures, 0, 1))

    def free(self, params: Params) -> tuple[Coordinate, ...]:
        """Coordinates that are fitted, relative to these parameters."""
        return (*(o.coordinate(params) for o in self.open if o.steady), *self.mean)

    def whole_model(self, effects: Sequence[Effect]) -> tuple[Model, list[str], list[str]]:
        """Build the base with every effect, switched off.

        Returns:
            the model; the names of effects that can be tried; the names of effects that open numbers absorb.
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
                continue  # the simulator has an unknown algorithm of its own
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
        """Move the base's z into the parameters and shift the bounds accordingly."""
        moved = model.moved(z)
        return dataclasses.replace(moved, base=self.free(moved.shared))

    def _moves(self, effect: Effect) -> tuple[Coordinate, ...]:
        """Coordinates of an effect that the simulator has as a stage, apart from its open numbers."""
        opened = {(o.field, o.index) for o in self.open if o.node == effect.name}
        return on_own_stage(effect, self.params[effect.name], opened)

    def _noise_moves(self) -> tuple[Coordinate, ...]:
        """Coordinates that make the sensor's noise stronger or weaker than the simulator's constants."""
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
        """The nodes from the mosaic up to demosaicking, which is excluded."""
        nodes = self.chain.nodes
        first = next(i for i, n in enumerate(nodes) if makes_mosaic(n))
        last = next(i for i, n in enumerate(nodes) if demosaics(n))
        return list(nodes[first:last])

    def _last_of_sensor(self) -> str:
        """Name of the last random node of the sensor, or of its first node; the readout follows it."""
        nodes = self._sensor()
        return next((n.name for n in reversed(nodes) if n.stochastic), nodes[0].name)


def of_recipe(recipe: Recipe, effects: Sequence[Effect], cfa: str, file: Jpeg | None) -> GivenBase:
    """Build the base from a recipe.

    The Bayer pattern is that of the pictures, since it depends on their crop. The compression that the files'
    headers state replaces the recipe's last compression.

    Args:
        recipe: from encoded sRGB to encoded sRGB, with a mosaic and its demosaicking.
        effects: the effects; their names are reserved.
        cfa: Bayer pattern of the pictures.
        file: a JPEG with the header to use; None if the pictures are not JPEGs.

    Raises:
        InputError: the recipe does not have this form, or it draws its stages or their order at random.
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
    """Replace a chain's default parameters by a recipe's constants and the medians of its priors.

    Args:
        recipe: the recipe.
        names: new name by old name of nodes that are renamed in the chain.
        params: the chain's default parameters.

    Returns:
        the parameters; the open numbers.
    """
    opened = []
    for name, values in recipe.prior.items():
        own = names.get(name, name)
        if own in params:
            params, found = _believed(params, own, values)
            opened += found
    return params, tuple(opened)


def _believed(params: Params, node: str, prior: Any) -> tuple[Params, list[Open]]:
    """Like `believed`, for the prior of one node."""
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
