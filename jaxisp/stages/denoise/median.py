"""Median filtering of luma and chroma."""

from functools import partial, reduce
from typing import Annotated, Any

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import edge_counts, pad, views
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import RGB
from jaxisp.options import Positive, one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.denoise.networks import MEDIANS

Offsets = tuple[tuple[int, int], ...]
_LARGE = 8  # times the usual: up to that three planes leave a CPU with less than 32 MB of scratch


@partial(jax.custom_jvp, nondiff_argnums=(1, 2))
def median_plane(plane: jax.Array, footprint: str, step: int = 1) -> jax.Array:
    """Median filter of an (H, W) plane, borders reflected.

    Args:
        plane: (H, W).
        footprint: "3x3", "5x5", or "cross" (a pixel and its 4 neighbours).
        step: how far apart the pixels of the footprint are [px]; 2 keeps to one colour of a mosaic.

    Returns:
        (H, W). Equal to `scipy.ndimage.median_filter(..., mode="mirror")`.

    Gradient: exact where the median is one pixel: it goes there. Pixels tied with it share it equally.
    """
    network, offsets = MEDIANS[footprint]
    reach = _reach(_apart(offsets, step))
    return materialize(in_strips_on_cpu(partial(network, step=step), plane, reach, large=_LARGE))


@median_plane.defjvp
def _median_jvp(footprint: str, step: int, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (plane,), (change,) = primals, tangents
    out = median_plane(plane, footprint, step)
    offsets = _apart(MEDIANS[footprint][1], step)
    return out, linear_call(partial(_tangent, offsets), partial(_cotangent, offsets), (plane, out), change)


def _tangent(offsets: Offsets, saved: Any, change: jax.Array) -> jax.Array:
    """The mean change of the pixels that are equal to the median."""
    plane, out = saved
    near, changes = (_near(x, offsets) for x in (plane, change))
    equal = [value == out for value in near]
    total = reduce(jnp.add, [jnp.where(e, c, 0) for e, c in zip(equal, changes)])
    return total / _count(equal, out.dtype)


def _cotangent(offsets: Offsets, saved: Any, cotangent: jax.Array) -> jax.Array:
    plane, out = saved
    counts, inverse = (edge_counts(plane.shape, plane.dtype, edge) for edge in (2, 0.5))
    frame = (plane, out, counts * cotangent)
    return inverse * in_strips_on_cpu(partial(_collected, offsets), frame, 2 * _reach(offsets))


def _collected(offsets: Offsets, frame: Any) -> jax.Array:
    """The transpose as reads: each pixel asks its neighbours' medians whether they are equal to it."""
    plane, out, cotangent = frame
    equal = [value == out for value in _near(plane, offsets)]
    share, out = materialize((cotangent / _count(equal, out.dtype), out))
    medians, shares = (_near(x, offsets) for x in (out, share))
    return reduce(jnp.add, [jnp.where(plane == m, s, 0) for m, s in zip(medians, shares)])


def _apart(offsets: Offsets, step: int) -> Offsets:
    return tuple((step * dy, step * dx) for dy, dx in offsets)


def _reach(offsets: Offsets) -> int:
    return max(dy for dy, _ in offsets)


def _near(plane: jax.Array, offsets: Offsets) -> list[jax.Array]:
    reach = _reach(offsets)
    return views(pad(plane, reach), offsets, reach)


def _count(equal: list[jax.Array], dtype: jnp.dtype) -> jax.Array:
    return reduce(jnp.add, [e.astype(dtype) for e in equal])


@parameters
class Median:
    """How much of the filtered image is taken."""

    strength: Leaf = param(1.0, (0.0, 1.0), "1", doc="0 keeps the image, 1 is the median")


@register(reach=lambda o: o["iterations"] * _reach(MEDIANS[o["footprint"]][1]), symmetric=True)
def median(
    params: Median,
    image: RGB,
    *,
    footprint: Annotated[str, one_of(*MEDIANS)] = "3x3",
    luma: bool = True,
    chroma: bool = True,
    iterations: Positive = 1,
) -> RGB:
    """Replace luma and chroma by the median of a neighbourhood: removes specks, keeps edges.

    `y = x + strength * (median(x) - x)` on luma and on both chroma planes.

    Args:
        params: strength.
        image: (H, W, 3), any range.
        footprint: "3x3", "5x5", or "cross" (a pixel and its 4 neighbours).
        luma: whether luma is filtered.
        chroma: whether chroma is filtered.
        iterations: how often the whole is repeated.

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Raises:
        ValueError: an unknown footprint.

    Gradient: exact; pixels tied for the median share it equally.

    Source: Jaroensri et al. 2019, section 3; Tukey 1977; networks: Smith 1996, Batcher 1968.
    """
    if footprint not in MEDIANS:
        raise ValueError(f"median: footprint {footprint!r} is none of {', '.join(MEDIANS)}")
    parts = list(rgb_to_ycbcr_planes(*planes(image)))
    for _ in range(iterations):
        for i, wanted in enumerate((luma, chroma, chroma)):
            if wanted:
                filtered = median_plane(parts[i], footprint)
                parts[i] = parts[i] + params.strength * (filtered - parts[i])
    return interleaved(ycbcr_to_rgb_planes(*parts))
