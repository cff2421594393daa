"""The simulator under diagnosis: a base pipeline whose parameters are fitted, and every effect, off.

All effects are in it, each behind a switch; a point in the space of all moves, `z`, says what
is on. At z = 0 the picture is the base's, bit for bit.
"""

import dataclasses
import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

import jax
import numpy as np

from jaxisp.camera import with_cfa
from jaxisp.domains import CAMERA, ENCODED, MOSAIC
from jaxisp.gap.pairs.pairs import inner_steps
from jaxisp.gap.simulator.effects import EFFECTS, Effect, Move
from jaxisp.gap.simulator.remainder import FILE_NOISE, PICTURE_LIGHT
from jaxisp.gap.simulator.render import Kept, in_sets, render
from jaxisp.pipeline import Chain, Gate, Node, Params, Stage, Switch, stage
from jaxisp.stages.choice import HALVED, ChromaSubsampling
from jaxisp.stages.power import Gamma

KNOTS = 12
COMPANDING, EXPANSION = "companding", "expansion"
"""What may be done to the mosaic before it is demosaicked, and the node that undoes it."""
ROOTED = 0.98
"""The share of its error on linear values that demosaicking must leave on square roots to be taken for it."""
_FILE_STAGES = ("rounding", "jpeg", "jpeg_file", "jpeg_tables", "jpeg_photoshop", "adc_quantization")


@dataclasses.dataclass(frozen=True)
class Coordinate:
    """One move of one node."""

    node: str
    move: Move


@dataclasses.dataclass(frozen=True)
class Variant:
    """Parameters of the base that are chosen, not fitted: its demosaicker, say."""

    shared: Params
    per_pair: Params

    def take(self, which: Sequence[int]) -> "Variant":
        """The variant for some of the pairs."""
        return Variant(self.shared, _of_pairs(self.per_pair, which))


def _of_pairs(per_pair: Params, which: Sequence[int]) -> Params:
    index = np.asarray(which)
    return jax.tree.map(lambda a: a[index], per_pair)


@dataclasses.dataclass(frozen=True)
class Model:
    """A chain with its effects off, and what may move.

    Attributes:
        chain: mosaic, or scene, to encoded sRGB.
        base: coordinates of the base's own parameters.
        effects: coordinates by effect.
        shared: parameters at z = 0, the same for all pairs.
        per_pair: parameters with a leading axis over the pairs; they hold where both have a node.
        kept: what was rendered, shared with the models made of this one.
        tied: computes the parameters that follow from others; these are not coordinates.
    """

    chain: Chain
    base: tuple[Coordinate, ...]
    effects: dict[str, tuple[Coordinate, ...]]
    shared: Params
    per_pair: Params
    kept: Kept = dataclasses.field(default_factory=Kept, compare=False, repr=False)
    tied: Callable[[Params], Params] | None = None

    @functools.cached_property
    def key(self) -> Hashable:
        """What its pictures depend on beside z, light and keys, by value: equal models have equal keys."""
        params = (leaf for p in (self.shared, self.per_pair) for leaf in jax.tree.leaves(p))
        values = tuple(np.asarray(leaf).tobytes() for leaf in params)
        return self.chain, self.base, tuple(self.effects.items()), self.tied, values

    @functools.cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (*self.base, *(c for moves in self.effects.values() for c in moves))

    def indices(self, names: Iterable[str]) -> list[int]:
        """Where in z the moves of these effects are."""
        wanted = {c for name in names for c in self.effects[name]}
        return [i for i, c in enumerate(self.coordinates) if c in wanted]

    @property
    def base_indices(self) -> list[int]:
        return list(range(len(self.base)))

    def still(self, z: np.ndarray) -> np.ndarray:
        """The point with the effects off that are noise."""
        found = z.copy()
        found[self.indices(name for name in self.effects if EFFECTS[name].random)] = 0.0
        return found

    @functools.cached_property
    def ranges(self) -> np.ndarray:
        """(2, Z) the least and the largest z."""
        return np.array([[c.move.low for c in self.coordinates], [c.move.high for c in self.coordinates]])

    @functools.cached_property
    def usual(self) -> np.ndarray:
        """(Z,) where moves are believed to end beforehand."""
        return np.array([c.move.usual for c in self.coordinates])

    @functools.cached_property
    def precisions(self) -> np.ndarray:
        """(Z,) what is believed of the moves beforehand: one over the square of their spread."""
        return np.array([c.move.spread**-2 for c in self.coordinates])

    @functools.cached_property
    def steps(self) -> np.ndarray:
        """(Z,) the probes."""
        return np.array([c.move.step for c in self.coordinates])

    def params(self, z: np.ndarray) -> Params:
        """The shared parameters at a point; a node none of whose coordinates has moved is switched off."""
        changed: dict[str, dict[str, np.ndarray]] = {}
        on = set()
        for value, c in zip(z, self.coordinates):
            if value == 0:
                continue
            on.add(c.node)
            fields = changed.setdefault(c.node, {})
            if c.move.field not in fields:
                fields[c.move.field] = np.array(getattr(self.shared[c.node], c.move.field), np.float32)
            fields[c.move.field][c.move.index] = self.origin(c) + value
        params = dict(self.shared)
        for node, fields in changed.items():
            params[node] = dataclasses.replace(params[node], **fields)
        params = self.tied(params) if self.tied else params
        switches = {f"use_{name}" for name in self.effects} & set(params)
        return params | {s: Switch(on=np.float32(s.removeprefix("use_") in on)) for s in switches}

    def origin(self, c: Coordinate) -> float:
        """The parameter's value at z = 0."""
        if c.node in self.effects and f"use_{c.node}" in self.shared:
            return c.move.off
        return float(np.asarray(getattr(self.shared[c.node], c.move.field))[c.move.index])

    def probe(self, z: np.ndarray, i: int, step: float | None = None) -> tuple[np.ndarray, np.ndarray, float]:
        """Two points that differ in coordinate i, and by how much: z and one moved by its probe, to the side
        that its range allows, or one to either side where the move asks for both and no step is given."""
        (low, high), at = self.ranges[:, i], z[i]
        both = step is None and self.coordinates[i].move.both_sides
        if step is None:
            step = self.steps[i] if low <= at + self.steps[i] <= high else -self.steps[i]
        ahead, behind = z.copy(), z.copy()
        ahead[i] = at + step
        if both:
            behind[i] = np.clip(at - step, low, high)
        return behind, ahead, float(ahead[i] - behind[i])

    def render(self, z: np.ndarray, light: jax.Array, keys: jax.Array | None = None) -> np.ndarray:
        """(N, H, W, 3) encoded, clipped to [0, 1], of all pairs."""
        return np.clip(render(self.chain, self.params(z), self.per_pair, light, keys, self.kept), 0, 1)

    def in_steps(self, z: np.ndarray, light: jax.Array, keys: jax.Array | None = None) -> np.ndarray:
        """(N, h, w, 3) the same in 8-bit steps of Y'CbCr, the border cut off."""
        pictures = in_sets(self.chain, self.params(z), self.per_pair, light, keys, self.kept)
        return np.asarray(inner_steps(pictures, len(light)))

    def take(self, which: Sequence[int]) -> "Model":
        """The model of some of the pairs."""
        return dataclasses.replace(self, per_pair=_of_pairs(self.per_pair, which))

    def with_shared(self, shared: Params) -> "Model":
        """The model with other parameters at z = 0; the bounds of its coordinates stay."""
        return dataclasses.replace(self, shared=shared)

    def chosen(self, variant: Variant) -> "Model":
        """The model with a variant's parameters in place of its own."""
        per_pair = self.per_pair | variant.per_pair
        return dataclasses.replace(self, shared=self.shared | variant.shared, per_pair=per_pair)

    def moved(self, z: np.ndarray) -> "Model":
        """The model with z = 0 put where z is for the base's parameters (effects keep theirs)."""
        only_base = np.where(np.arange(len(z)) < len(self.base), z, 0)
        params = self.params(only_base)
        return dataclasses.replace(self, shared={name: params[name] for name in self.shared})


def build(
    base: Chain,
    params: Params,
    per_pair: Params,
    free: Sequence[Coordinate],
    effects: Sequence[Effect],
    *,
    keep_file: bool = False,
) -> Model:
    """Put every effect into a base pipeline, switched off.

    Args:
        base: mosaic, or scene, to encoded sRGB.
        params: the base's parameters.
        per_pair: those of them that differ from pair to pair, stacked.
        free: what of the base is fitted.
        effects: to be tried. One whose node is in the base acts on that node.
        keep_file: whether the rounding and compression at the end of the base stay.
    """
    nodes = list(base.nodes)
    while is_file(nodes[-1]) and not keep_file:
        nodes.pop()
    present = {name for n in nodes for name in n.names()}
    sites = _sites(nodes)
    cfa = next((str(s.options["cfa"]) for n in nodes for s in n.stages() if "cfa" in s.options), "RGGB")
    inserted: dict[int, list[Node]] = {}
    for effect in effects:
        if effect.name not in present:
            node = Gate(with_cfa(effect.node, cfa), f"use_{effect.name}")
            inserted.setdefault(sites[effect.site], []).append(node)
    merged = [n for i in range(len(nodes) + 1) for n in (*inserted.get(i, ()), *nodes[i : i + 1])]
    chain = Chain(tuple(merged), "diagnosed")
    coordinates = {e.name: tuple(Coordinate(e.name, m) for m in e.moves) for e in effects}
    shared = chain.init()
    for effect in effects:
        if effect.name not in present:
            shared[effect.name] = _off(shared[effect.name], effect.moves)
            shared[f"use_{effect.name}"] = Switch(on=np.float32(0))
    return Model(chain, tuple(free), coordinates, shared | dict(params), per_pair)


def _off(params: Any, moves: Sequence[Move]) -> Any:
    """An effect's parameters where it is absent, in the fields that it moves."""
    fields = {m.field: np.array(getattr(params, m.field), np.float32) for m in moves}
    for m in moves:
        fields[m.field][m.index] = m.off
    return dataclasses.replace(params, **fields)


def is_file(node: Node) -> bool:
    """Whether a node does what a file does: it rounds or compresses."""
    return isinstance(node, Stage) and node.fn.__name__ in _FILE_STAGES


def samples_chroma(node: Node) -> bool:
    """Whether a node halves the resolution of chroma, and is no effect that is switched."""
    return isinstance(node, Stage) and node.fn.__name__ == "chroma_subsampling"


def _sites(nodes: Sequence[Node]) -> dict[str, int]:
    """Before which node of the base each site is; those of pictures alone where it has no mosaic.

    What a file does comes last. It samples the chroma of what effects have made.
    """
    names = [n.name for n in nodes]
    end = len(nodes)
    while end > 1 and (is_file(nodes[end - 1]) or samples_chroma(nodes[end - 1])):
        end -= 1
    last = nodes[end - 1]
    clipped = isinstance(last, Stage) and last.fn.__name__ == "clip"
    after = {"encoded": end - clipped - (last.name == FILE_NOISE), "output": end}
    if PICTURE_LIGHT in names:  # light is seen in the picture itself, and so is the lens beside a RAW
        light = names.index(PICTURE_LIGHT) + 1
        after["linear"] = light
        if not any(n.domain_out == MOSAIC != n.domain_in for n in nodes):
            after["scene"] = light
    if not any(MOSAIC in (n.domain_in, n.domain_out) for n in nodes):
        return {"scene": 0, "linear": 0, "camera": 0} | after
    mosaic = next(i for i, n in enumerate(nodes) if n.domain_in == MOSAIC or n.domain_out == MOSAIC)
    if nodes[mosaic].domain_out == MOSAIC and nodes[mosaic].domain_in != MOSAIC:
        scene, mosaic = 0, mosaic + 1
    else:
        scene = -1
    camera = next(i for i, n in enumerate(nodes) if n.domain_in == MOSAIC and n.domain_out == CAMERA) + 1
    if EXPANSION in nodes[camera].names():  # a part of demosaicking
        camera += 1
    encoded = next(i for i, n in enumerate(nodes) if n.domain_out == ENCODED and i >= camera)
    before = {
        "scene": camera if scene < 0 else scene,
        "mosaic": mosaic,
        "camera": camera,
        "linear": encoded,
    }
    return before | after


def plain_camera(
    cfa: str, algorithm: str = "malvar", subsampling: str = "4:4:4", *, warped: bool = False
) -> tuple[Chain, Params]:
    """The base that is fitted where no camera is given: black level, white balance, demosaicking, of square
    roots if that is switched on, the correction of the lens, where RAW files state it, one colour matrix,
    sRGB, one tone curve, and the chroma sampling that the file states."""
    nodes = [
        Stage(stage("black_level").fn, "black_level_offset"),
        stage("mosaic_white_balance", cfa=cfa),
        Gate(Stage(stage("gamma_compression").fn, COMPANDING)),
        stage("demosaicking", cfa=cfa, algorithm=algorithm),
        Gate(Stage(stage("gamma_expansion").fn, EXPANSION)),
        Stage(stage("white_balance").fn, "later_balance"),  # some balance before demosaicking, some after
        *([stage("rectilinear_warp")] if warped else []),
        stage("color_matrix"),
        stage("srgb_oetf"),
        Stage(stage("spline_curve").fn, "tone_curve"),
    ]
    shares = HALVED.get(subsampling)
    if shares:
        nodes.append(stage("chroma_subsampling"))
    chain = Chain(tuple(nodes), "plain")
    params = chain.init() | rooted(False)
    if shares:
        horizontal, vertical = (np.float32(s) for s in shares)
        params["chroma_subsampling"] = ChromaSubsampling(horizontal=horizontal, vertical=vertical)
    return chain, params


def rooted(on: bool) -> Params:
    """Whether the plain camera demosaicks square roots, as some do."""
    gates = {f"use_{name}": Switch(on=np.float32(on)) for name in (COMPANDING, EXPANSION)}
    return gates | {name: Gamma(gamma=np.float32(2)) for name in (COMPANDING, EXPANSION)}


def plain_freedom() -> list[Coordinate]:
    """What of `plain_camera` is fitted."""
    matrix = [
        Coordinate("color_matrix", Move("matrix", 0.02, -4, 4, (i, j))) for i in range(3) for j in range(3)
    ]
    curve = [Coordinate("tone_curve", Move("offsets", 0.02, -0.6, 0.6, (i,))) for i in range(KNOTS)]
    return [Coordinate("black_level_offset", Move("offset", 0.002, -0.1, 0.1)), *matrix, *curve]


MIXING = "mixing"
"""The node that takes what the sensor saw back to the clean picture's colours."""
