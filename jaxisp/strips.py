"""Pipelines on large frames, strip of rows by strip: the same picture, with the memory of a strip.

A strip is computed with as many more rows around it as its stages look away from a pixel: their reach.
Stages that need the whole frame (position, statistics of the frame, noise) or whose reach is not known run
on the whole of it, between strips.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import jax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.strips import ROWS, in_strips
from jaxisp.pipeline import Chain, Gate, Node, Params, Row, Stage, group_by
from jaxisp.stages.demosaic.strips import reach as demosaic_reach

__all__ = ["REACH", "Chain", "parts", "reach", "run_in_strips"]

_POINTWISE = (
    "adc_quantization", "affine_exposure", "black_level", "clip", "color_matrix", "exposure",
    "gamma_compression", "gamma_expansion", "gray18_gamma", "green_imbalance", "highlight_rolloff",
    "hue_rotation", "inverse_s_curve", "linear_srgb_to_prophoto", "linear_srgb_to_xyz", "linearization",
    "mosaic", "mosaic_white_balance", "prophoto_eotf", "prophoto_oetf", "prophoto_to_linear_srgb",
    "rec709_eotf", "rec709_oetf", "rgb_to_ycbcr", "rounding", "s_curve", "saturation", "selective_color",
    "spline_curve", "srgb_eotf", "srgb_oetf", "tone_curve", "white_balance", "white_balance_temperature",
    "xyz_to_linear_srgb", "ycbcr_to_rgb", "zone_curve",
)  # fmt: skip
_DEMOSAICKERS = tuple(
    f"demosaic_{name}"
    for name in ("ahd", "bilinear", "edge_aware", "hamilton_adams", "hibbard", "malvar", "menon", "vng")
)
_ENCODERS = ("jpeg", "jpeg_file", "jpeg_photoshop", "jpeg_tables")
_BLOCK, _CELL = 16, 2  # rows: a strip of blocks or of a mosaic's cells begins where one does
_BLOCKS = 31
"""Of an encoder: to the far end of the next 16 x 16 block, from which chroma is interpolated."""

Reach = Callable[[Mapping[str, Any]], int | None]


def _demosaic(name: str, options: Mapping[str, Any]) -> int:
    return demosaic_reach(name, **options)


REACH: dict[str, Reach] = {
    **dict.fromkeys(_POINTWISE, lambda options: 0),
    **{name: functools.partial(_demosaic, name) for name in _DEMOSAICKERS},
    **dict.fromkeys(_ENCODERS, lambda options: _BLOCKS),
    "color_difference_median": lambda o: 2 * o["passes"],
    "median": lambda o: o["iterations"] * (2 if o["footprint"] == "5x5" else 1),
    "bilateral": lambda o: None if o["chroma_cell"] else o["iterations"] * (o["radius"] + o["chroma_radius"]),
    "optical_blur": lambda o: o["radius"],
    "unsharp_mask": lambda o: o["radius"],
}
"""By stage name: how far from a pixel its result depends on its input [px], given its static options; None
where they make it depend on the whole frame. Add a stage of your own that does not depend on position."""


def reach(node: Node) -> int | None:
    """How far from a pixel a node's result depends on its input [px]; None where that is not known."""
    if isinstance(node, Stage):
        known = REACH.get(node.fn.__name__)
        return None if known is None or node.stochastic else known(node.options)
    if isinstance(node, Gate):
        return reach(node.node)
    assert isinstance(node, Row)
    return _total(node.nodes)


def _total(nodes: Iterable[Node]) -> int | None:
    each = [reach(node) for node in nodes]
    return None if None in each else sum(filter(None, each))


@functools.partial(jax.jit, static_argnums=0, static_argnames="rows")
def run_in_strips(
    node: Node, params: Params, image: jax.Array, key: jax.Array | None = None, *, rows: int = ROWS
) -> jax.Array:
    """`run(node, params, image, key)` on a large frame, in less memory and less time.

    Args:
        node: a stage or a pipeline; as many of its stages as can run in strips.
        params: its parameters.
        image: (H, W, 3) or (H, W).
        key: where anything draws noise.
        rows: of a strip.

    Returns:
        What `run` returns, to rounding.
    """
    if node.stochastic and key is None:
        raise TypeError(f"{node.name} draws noise: pass key=jax.random.key(seed)")
    for local, group in itertools.groupby(_flat(node), lambda n: reach(n) is not None):
        part = Chain(tuple(group), node.name)
        if local:
            image = _in_strips(part, params, image, rows)
        else:
            image = part.apply(params, materialize(image), key)
    return image


def parts(nodes: Iterable[Node]) -> Iterator[tuple[tuple[Node, ...], int | None, int]]:
    """Nodes in a row, in groups that can run in strips together, each with its reach and the rows of a block.

    An encoder is alone: in the strips that its blocks need, other stages would do more over again. So is a
    node whose reach is not known.
    """
    for alone, group in itertools.groupby(nodes, lambda n: reach(n) is None or _encodes(n)):
        together = tuple(group)
        for some in [(n,) for n in together] if alone else [together]:
            yield some, _total(some), _BLOCK if _encodes(some[0]) else _CELL


def _encodes(node: Node) -> bool:
    return any(s.fn.__name__ in _ENCODERS for s in node.stages())


def _flat(node: Node) -> Iterator[Node]:
    """The nodes of chains within chains."""
    if not isinstance(node, Chain):
        yield node
        return
    for inner in node.nodes:
        yield from _flat(inner)


def _in_strips(part: Chain, params: Params, image: jax.Array, rows: int) -> jax.Array:
    far = _total(part.nodes)
    assert far is not None, "only these are put into a part"
    unit = _BLOCK if _encodes(part) else _CELL
    return in_strips(lambda strip: part.apply(params, strip, None), image, far, rows=rows, unit=unit)


group_by(parts)
