"""A mosaic that begins at any photosite of its pattern's cell: a traced phase, one compile for all four."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.extents import Extent, mirrored
from jaxisp.node import Around, Node, Params, entry, require_node
from jaxisp.params import Leaf, param, parameters

_BORDER = (1, 2)  # px before and after


@parameters
class CfaPhase:
    """Where in its pattern's cell a mosaic begins."""

    row: Leaf = param(0.0, (0.0, 1.0), "switch", doc="at the cell's second row above 0.5")
    column: Leaf = param(0.0, (0.0, 1.0), "switch", doc="at the cell's second column above 0.5")


@dataclass(frozen=True, repr=False)
class AnyPhase(Around):
    """What runs from a mosaic to demosaicking, with the pattern shifted by `params[NAME]`, a `CfaPhase`.

    The picture is moved against the pattern, within a border of reflected pixels, and moved back. At phase
    (0, 0) the pattern is that of the stages; at (0, 1) GRBG is RGGB.

    Example:
        >>> import jaxisp
        >>> chain = jaxisp.Chain((jaxisp.stage("mosaic"), jaxisp.stage("demosaic_bilinear")))
        >>> jaxisp.AnyPhase(chain).init()["cfa_phase"]
        CfaPhase(row=0, column=0)
    """

    node: Node
    name: str = "cfa_phase"

    def __post_init__(self) -> None:
        require_node(self.node, "AnyPhase")
        channels = self.node.domain_in.channels, self.node.domain_out.channels
        if channels != (3, 3) or not any("cfa" in s.options for s in self.node.stages()):
            raise ValueError(
                f"AnyPhase takes what runs from a mosaic to demosaicking; {self.node.name!r} takes "
                f"{self.node.domain_in.name} and gives {self.node.domain_out.name}"
            )

    @property
    def reach(self) -> int | None:
        return None  # where a strip begins is another phase

    @property
    def margin(self) -> int | None:
        inner = self.node.margin
        return None if inner is None else max(inner, _BORDER[1])

    def init(self) -> Params:
        return {self.name: CfaPhase(), **self.node.init()}

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        phase = entry(params, self.name, CfaPhase)
        row, column = (jnp.asarray(v > 0.5, jnp.int32) for v in (phase.row, phase.column))
        height, width, channels = image.shape
        none = jnp.zeros((), jnp.int32)
        # an even size, as the picture's own mostly is
        if extent is not None:
            image, extent = mirrored(image, extent), extent.grown(2)
        padded = jnp.pad(image, (_BORDER, _BORDER, (0, 0)), mode="reflect")
        moved = lax.dynamic_slice(padded, (1 - row, 1 - column, none), (height + 2, width + 2, channels))
        out = self.node.in_frame(params, moved, key, extent)
        return lax.dynamic_slice(out, (row, column, none), image.shape)
