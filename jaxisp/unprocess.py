"""What runs in a camera's own colours: one draw of matrix and gains, undone before and done again after."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp import cfa as filters
from jaxisp.arrays.extents import Extent
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.safe_math import clip
from jaxisp.color import apply_matrix
from jaxisp.domains import LINEAR, MOSAIC, Domain
from jaxisp.node import Around, Node, Params, Stage, entry
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import Row

XYZ_TO_CAMERA = np.array(
    [
        [[1.0234, -0.2969, -0.2266], [-0.5625, 1.6328, -0.0469], [-0.0703, 0.2188, 0.6406]],
        [[0.4913, -0.0541, -0.0202], [-0.6130, 1.3513, 0.2906], [-0.1564, 0.2151, 0.7183]],
        [[0.8380, -0.2630, -0.0639], [-0.2887, 1.0725, 0.2496], [-0.0627, 0.1427, 0.5438]],
        [[0.6596, -0.2079, -0.0562], [-0.4782, 1.3016, 0.1933], [-0.0970, 0.1581, 0.5181]],
    ]
)
"""(4, 3, 3) of the four cameras of the Darmstadt Noise Dataset, as Brooks et al. 2019 publish them."""
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
INFLECTION = 0.9
"""Mean level from which highlights are kept."""


@parameters
class CameraColors:
    """A camera's matrix, as a mean of four, its white balance and its brightening."""

    weights: Leaf = param((0.25,) * 4, (0.0, 1.0), "1", doc="of the four cameras; only their ratios count")
    red: Leaf = param(2.1, (0.5, 4.0), "1", doc="gain of red that balances white")
    blue: Leaf = param(1.7, (0.5, 4.0), "1", doc="gain of blue that balances white")
    dimming: Leaf = param(0.8, (0.2, 2.0), "1", doc="inverse of the gain that brightens")


@dataclass(frozen=True, repr=False)
class Unprocessed(Around):
    """What runs from a mosaic to demosaicking, in the colours of a camera: `params[NAME]`, `CameraColors`.

    Before it: `c = M x`, M the mean of the published matrices with rows that sum to 1; `c g`, g the inverse
    gains; clipped to [0, 1]. Where `preserve`, gains fade to 1 towards white, as `max(m + (1 - m) g, g)`,
    `m = (max(mean(c) - 0.9, 0) / 0.1)**2`, so that clipped highlights stay bright. Just before demosaicking
    the gains are applied and the mosaic is clipped to [0, 1], after it the inverse of M.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", sections 3.2 to 3.4.

    Example:
        >>> import jaxisp
        >>> chain = jaxisp.Chain((jaxisp.stage("mosaic"), jaxisp.stage("demosaic_bilinear")))
        >>> list(jaxisp.Unprocessed(chain).names())
        ['unprocessed', 'mosaic', 'demosaic_bilinear']
    """

    node: Node
    name: str = "unprocessed"
    preserve: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.node, Row) or len(self._split) != 2:
            got = " ".join(repr(self.node).split())
            raise TypeError(f"Unprocessed takes a chain from a mosaic to one demosaicking stage, got {got}")

    @property
    def _split(self) -> tuple[tuple[Node, ...], ...]:
        """The nodes up to demosaicking, and from there on."""
        nodes = getattr(self.node, "nodes", ())
        at = [
            i
            for i, n in enumerate(nodes)
            if isinstance(n, Stage) and n.domain_in == MOSAIC and n.domain_out.channels == 3
        ]
        return (nodes[: at[0]], nodes[at[0] :]) if len(at) == 1 and at[0] > 0 else ()

    @property
    def domain_out(self) -> Domain:
        return LINEAR

    @property
    def reach(self) -> int | None:
        return None  # gains go by the place in the cell, which a strip would shift

    @property
    def margin(self) -> int | None:
        return self.node.margin

    def init(self) -> Params:
        return {self.name: CameraColors(), **self.node.init()}

    def apply(
        self, params: Params, image: jax.Array, key: jax.Array | None, extent: Extent | None = None
    ) -> jax.Array:
        colors = entry(params, self.name, CameraColors)
        matrix = camera_matrix(colors.weights)
        gains = jnp.stack([1 / colors.red, jnp.ones_like(colors.red), 1 / colors.blue]) * colors.dimming
        raw, developed = self._split
        seen = clip(_dimmed(apply_matrix(matrix, image), gains.astype(image.dtype), self.preserve), 0, 1)
        for node in raw:
            seen = node.in_frame(params, seen, key, extent)
        assert isinstance(developed[0], Stage)
        masks = filters.masks((seen.shape[0], seen.shape[1]), str(developed[0].options["cfa"]))
        seen = clip(seen * filters.select(masks, *(1 / gains).astype(seen.dtype)), 0, 1)
        for node in developed:
            seen = node.in_frame(params, seen, key, extent)
        return apply_matrix(jnp.linalg.inv(matrix), seen)


def camera_matrix(weights: jax.Array) -> jax.Array:
    """(3, 3) linear sRGB to camera RGB, rows summing to 1, by the weights of the four cameras."""
    total = jnp.maximum(weights.sum(), 1e-6)
    each = jnp.asarray(XYZ_TO_CAMERA @ SRGB_TO_XYZ, weights.dtype)
    mixed = (jnp.where(weights.sum() > 1e-6, weights / total, 0.25)[:, None, None] * each).sum(0)
    return mixed / mixed.sum(1, keepdims=True)


def _dimmed(image: jax.Array, gains: jax.Array, preserve: bool) -> jax.Array:
    channels = planes(image)
    if not preserve:
        return interleaved([c * g for c, g in zip(channels, gains)])
    grey = sum(channels[1:], channels[0]) / 3
    mask = (jnp.maximum(grey - INFLECTION, 0) / (1 - INFLECTION)) ** 2
    return interleaved([c * jnp.maximum(mask + (1 - mask) * g, g) for c, g in zip(channels, gains)])
