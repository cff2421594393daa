"""Non-local means."""

from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad, square
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import RGB
from jaxisp.options import Count, Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register


@parameters
class NonlocalMeans:
    """How much is smoothed, and how alike patches must be."""

    luma: Leaf = param(1.0, (0.0, 1.0), "share", doc="of the filtered luma; 0 keeps it")
    chroma: Leaf = param(1.0, (0.0, 1.0), "share", doc="of the filtered Cb and Cr; 0 keeps them")
    likeness: Leaf = param(0.03, (1e-3, 0.5), "level", log=True, doc="difference of patches weighed exp(-1)")


@register(reach=lambda o: o["search"] + o["patch"])
def nonlocal_means(params: NonlocalMeans, image: RGB, *, search: Positive = 4, patch: Count = 1) -> RGB:
    """Average pixels whose surroundings look alike, in luma; chroma goes by the same weights.

    `y(p) = sum_q w(p, q) x(q) / sum_q w(p, q)` over a square of q, `w = exp(-d / likeness**2)`, d the mean
    square difference of the two patches of luma.

    Args:
        params: shares of luma and chroma; likeness in the unit of the image.
        image: (H, W, 3), any range.
        search: radius of the square of pixels that are averaged [px].
        patch: radius of the patches [px].

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Gradient: exact.

    Source: Buades, Coll & Morel 2005; by whole frames, a displacement at a time, as Darbon et al. 2008.
    """
    y, *chroma = rgb_to_ycbcr_planes(*planes(image))
    smooth_y, *smooth = nonlocal_planes((y, *chroma), y, params.likeness, search, patch)
    y = y + params.luma * (smooth_y - y)
    cb, cr = (c + params.chroma * (s - c) for c, s in zip(chroma, smooth))
    return interleaved(ycbcr_to_rgb_planes(y, cb, cr))


def nonlocal_planes(
    values: tuple[jax.Array, ...], guide: jax.Array, likeness: jax.Array | float, search: int, patch: int
) -> tuple[jax.Array, ...]:
    """Non-local means of (H, W) planes by the patches of a guide; see `nonlocal_means`."""
    margin = search + patch
    height, width = guide.shape
    centre, seen = pad(guide, patch), pad(guide, margin)
    around = [pad(v, search) for v in values]
    scale = -1 / jnp.square(jnp.asarray(likeness, guide.dtype))

    def add(sums: tuple[jax.Array, ...], step: jax.Array) -> tuple[tuple[jax.Array, ...], None]:
        moved = lax.dynamic_slice(seen, step, centre.shape)
        weight = jnp.exp(scale * _patch_means((centre - moved) ** 2, patch))
        total, *sums_of = sums
        own = [lax.dynamic_slice(v, step, (height, width)) for v in around]
        return (total + weight, *(s + weight * v for s, v in zip(sums_of, own))), None

    steps = jnp.asarray([(y + search, x + search) for y, x in square(search)], jnp.int32)
    zeros = tuple(jnp.zeros_like(guide) for _ in range(len(values) + 1))
    (total, *sums), _ = lax.scan(add, zeros, steps)
    return tuple(s / total for s in sums)


def _patch_means(plane: jax.Array, radius: int) -> jax.Array:
    """Means over squares, where they are whole."""
    size = 2 * radius + 1
    height, width = (n - 2 * radius for n in plane.shape)
    rows = reduce(jnp.add, [lax.slice_in_dim(plane, k, k + height, axis=0) for k in range(size)])
    both = reduce(jnp.add, [lax.slice_in_dim(rows, k, k + width, axis=1) for k in range(size)])
    return both / size**2
