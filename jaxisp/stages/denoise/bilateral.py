"""Bilateral filtering of luma and chroma."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import store, store_off_cpu
from jaxisp.arrays.extents import Extent, mirrored
from jaxisp.arrays.linear import inner_product, linear_call
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.platforms import by_platform
from jaxisp.arrays.safe_math import nearest_int
from jaxisp.arrays.stencils import edge_counts, pad
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.arrays.varying import alike
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import RGB
from jaxisp.options import Positive, at_least, even
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.denoise.grid import grid_planes

Planes = tuple[jax.Array, ...]

# taps of a fused kernel, on a CPU and elsewhere: more is slower to compile, elsewhere also to run
_FORWARD_TAPS, _BACKWARD_TAPS = (10, 40), (10, 20)
_FEW_TAPS = 20  # up to so many are one kernel, and it pays to look the neighbours' rows up as they are read
_EXP2 = (1.0000000754549, 0.6931471880262, 0.2402210748531, 0.0555035711422, 0.0096760319183, 0.0013390863364)
"""2**x on [-0.5, 0.5], interpolated at Chebyshev nodes, lowest power first."""


@parameters
class Bilateral:
    """Widths in space and in value for luma and chroma, and the curve that luma is compared on."""

    luma_sigma_space: Leaf = param(1.5, (0.3, 5.0), "px", log=True, doc="spatial width for luma")
    luma_sigma_range: Leaf = param(
        0.05, (0.005, 1.0), "level", log=True, doc="luma difference, after guide_gamma, that still averages"
    )
    chroma_sigma_space: Leaf = param(3.0, (0.3, 40.0), "px", log=True, doc="spatial width for chroma")
    chroma_sigma_range: Leaf = param(
        0.1, (0.005, 1.0), "level", log=True, doc="difference of the filtered luma that still averages chroma"
    )
    guide_gamma: Leaf = param(
        1.0, (0.1, 2.0), "1", log=True, doc="power of luma before it is compared; below 1 spares shadows"
    )


def _reach(options: Mapping[str, Any]) -> int | None:
    """None on a grid, which has a place of its own in the frame."""
    if options["chroma_cell"]:
        return None
    return int(options["iterations"] * (options["radius"] + options["chroma_radius"]))


@register(reach=_reach)
def bilateral(
    params: Bilateral,
    image: RGB,
    *,
    radius: Positive = 5,
    chroma_radius: Positive = 5,
    chroma_cell: Annotated[int, at_least(0), even] = 0,
    chroma_bins: Annotated[int, at_least(2)] = 32,
    iterations: Positive = 1,
    extent: Extent | None = None,
) -> RGB:
    """Smooth luma and chroma where luma is alike, and keep its edges.

    `Y' = joint(Y; guide Y**gamma)`, `Cb', Cr' = joint(Cb, Cr; guide Y')`, with the weights of
    `bilateral_planes`. Chroma follows the filtered luma, uncompressed. The power is odd about black:
    `sign(Y) (|Y| + 1e-4)**gamma`, less its value at 0.

    Args:
        params: sigma_space in px, sigma_range in the unit of the image (luma: of its power).
        image: (H, W, 3), any range.
        radius: of the disc for luma [px]. It cuts the Gaussian; 3 times sigma_space keeps it whole,
            and with a far larger sigma_space the disc is flat.
        chroma_radius: the same for chroma.
        chroma_cell: 0, or the side of a cell [px] of a bilateral grid that chroma is filtered on instead: as
            fast at any width, and right (`grid_planes`) from a chroma_sigma_space of 1.5 cells up.
        chroma_bins: of that grid, over the range of the filtered luma.
        iterations: how often the whole is repeated.
        extent: of the picture, where the image is a larger frame.

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Raises:
        ValueError: chroma_cell is odd or negative, or there are fewer than 2 bins.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; Tomasi & Manduchi 1998; Petschnigg et al. 2004 (joint);
        Chen, Paris & Durand 2007 (grid).
    """
    if chroma_cell < 0 or chroma_cell % 2 or chroma_bins < 2:
        raise ValueError(
            "bilateral: chroma_cell must be even and chroma_bins at least 2, "
            f"got {chroma_cell} and {chroma_bins}"
        )
    y, cb, cr = store(rgb_to_ycbcr_planes(*planes(image)))
    beyond = store
    if extent is not None:
        # anew before each pass: where neighbours are mirrored their sum may come out otherwise, and what is
        # beyond the picture is not what the pass before gave there. A picture alone is stored at the same
        # places, so that the same is rounded
        beyond = partial(mirrored, extent=extent)
        room = max(radius, chroma_cell - 1 if chroma_cell else chroma_radius)
        y, cb, cr = (beyond(jnp.pad(plane, (0, room))) for plane in (y, cb, cr))
    widths = params.chroma_sigma_space, params.chroma_sigma_range
    for i in range(iterations):
        if i:
            cb, cr = beyond(cb), beyond(cr)
        guide = _compressed(y, params.guide_gamma)
        y = beyond(bilateral_plane(y, guide, params.luma_sigma_space, params.luma_sigma_range, radius))
        if chroma_cell:
            cb, cr = grid_planes((cb, cr), y, *widths, chroma_cell, chroma_bins, extent)
        else:
            cb, cr = bilateral_planes((cb, cr), y, *widths, chroma_radius)
    height, width = image.shape[:2]
    return interleaved(ycbcr_to_rgb_planes(*store([plane[:height, :width] for plane in (y, cb, cr)])))


def _compressed(y: jax.Array, gamma: jax.Array) -> jax.Array:
    """An odd power of luma with a finite slope at black."""
    toe = 1e-4
    # not `**`, which takes 3 times as long
    rise = jnp.exp(gamma * jnp.log(jnp.abs(y) + toe)) - jnp.exp(gamma * float(np.log(toe)))
    return jnp.where(y < 0, -rise, rise)


def bilateral_plane(
    plane: jax.Array, guide: jax.Array, sigma_space: Any, sigma_range: Any, radius: int
) -> jax.Array:
    """Bilateral filter of one plane: `bilateral_planes` of a single one.

    With the plane as its own guide: `cv2.bilateralFilter(plane, 2 * radius + 1, sigma_range, sigma_space)`.
    """
    return bilateral_planes((plane,), guide, sigma_space, sigma_range, radius)[0]


def bilateral_planes(
    planes: Planes, guide: jax.Array, sigma_space: Any, sigma_range: Any, radius: int
) -> Planes:
    """Joint bilateral filter: planes averaged with weights that fall with distance and guide difference.

    `out_p = sum_q w_pq v_q / sum_q w_pq` over the disc `|p - q| <= radius`, with
    `w_pq = exp(-|p - q|^2 / (2 sigma_space^2) - (g_p - g_q)^2 / (2 sigma_range^2))`.

    Args:
        planes: (H, W) each; the weights are shared.
        guide: (H, W).
        sigma_space: [px], positive.
        sigma_range: in the unit of the guide, positive.
        radius: of the disc [px].

    Returns:
        The filtered planes. Borders are reflected.

    Gradient: exact, to planes, guide and both sigmas, in both modes.
    """
    dtype = guide.dtype
    return _bilateral(
        tuple(planes), guide, jnp.asarray(sigma_space, dtype), jnp.asarray(sigma_range, dtype), radius
    )


@partial(jax.custom_jvp, nondiff_argnums=(4,))
def _bilateral(
    planes: Planes, guide: jax.Array, sigma_space: jax.Array, sigma_range: jax.Array, radius: int
) -> Planes:
    return _in_strips((planes, guide), sigma_space, sigma_range, radius)[0]


@_bilateral.defjvp
def _bilateral_jvp(radius: int, primals: Any, tangents: Any) -> tuple[Planes, Planes]:
    planes, guide, sigma_space, sigma_range = primals
    out, norm = _in_strips((planes, guide), sigma_space, sigma_range, radius)
    saved = (*primals, out, norm)
    return out, linear_call(partial(_tangent, radius), partial(_cotangent, radius), saved, tangents)


def _in_strips(
    frame: tuple[Planes, jax.Array], sigma_space: jax.Array, sigma_range: jax.Array, radius: int
) -> tuple[Planes, jax.Array]:
    return in_strips_on_cpu(partial(_filtered, radius), frame, radius, (sigma_space, sigma_range))


def _filtered(
    radius: int, frame: tuple[Planes, jax.Array], sigma_space: jax.Array, sigma_range: jax.Array
) -> tuple[Planes, jax.Array]:
    """The filtered planes and the sum of the weights."""
    planes, guide = frame
    weight = _weight(sigma_space, sigma_range)

    def terms(near: Planes, squared: jax.Array) -> Planes:
        w, _ = weight(guide, near[0], squared)
        return (w, *(w * v for v in near[1:]))

    start = (jnp.ones_like(guide), *planes)
    norm, *sums = _over_disc(terms, start, (guide, *planes), radius, _FORWARD_TAPS)
    return tuple(s / norm for s in sums), norm


def _tangent(radius: int, saved: Any, change: Any) -> Planes:
    """How the output moves with planes, guide and sigmas."""
    planes, guide, sigma_space, sigma_range, out, norm = saved
    d_planes, d_guide, d_space, d_range = change
    weight, n = _weight(sigma_space, sigma_range), len(planes)
    by_space, by_range, by_guide = d_space / sigma_space**3, d_range / sigma_range**3, 1 / sigma_range**2

    def terms(near: Planes, squared: jax.Array) -> Planes:
        w, d = weight(guide, near[0], squared)
        rate = by_space * squared + d * (by_range * d - by_guide * (near[1] - d_guide))
        moved = zip(near[2 : 2 + n], near[2 + n :], out)
        return tuple(w * (change + rate * (v - o)) for v, change, o in moved)

    sums = _over_disc(terms, d_planes, (guide, d_guide, *planes, *d_planes), radius, _BACKWARD_TAPS)
    return tuple(s / norm for s in sums)


def _cotangent(radius: int, saved: Any, cotangent: Planes) -> tuple[Planes, jax.Array, Any, Any]:
    """The transpose of `_tangent`, written as reads: autodiff would scatter 4 times for each tap."""
    planes, guide, sigma_space, sigma_range, out, norm = saved
    frame = (planes, guide, out, norm, cotangent, edge_counts(guide.shape, guide.dtype))
    by_plane, d_guide, d_space = in_strips_on_cpu(
        partial(_collected, radius), frame, radius, (sigma_space, sigma_range)
    )
    d_guide /= sigma_range**2
    # scaling guide and sigma_range together changes nothing (Euler), nor does an offset of the guide
    d_range = -inner_product(guide - guide.mean(), d_guide) / sigma_range
    return by_plane, d_guide, d_space.sum() / sigma_space**3, d_range


def _collected(
    radius: int, frame: Any, sigma_space: jax.Array, sigma_range: jax.Array
) -> tuple[Planes, jax.Array, jax.Array]:
    """What planes and guide get, and by rows what sigma_space does; both sigmas' own factors are left out."""
    # stored anew, or XLA would share the forward pass's weights by storing one plane for each tap
    planes, guide, out, norm, cotangent, counts = store(frame)
    weight, n = _weight(sigma_space, sigma_range), len(planes)
    given = tuple(c / norm for c in cotangent)
    mirrored = tuple(counts * c for c in given)
    offset = sum(c * o for c, o in zip(given, out))
    shared = sum(c * o for c, o in zip(mirrored, out))
    share = 1 / counts

    def terms(near: Planes, squared: jax.Array) -> Planes:
        w, d = weight(guide, near[0], squared)
        value, come = near[1 : 1 + n], near[1 + n : 1 + 2 * n]
        centre = w * (sum(c * v for c, v in zip(given, value)) - offset)  # this pixel averages the near one
        edge = w * (sum(v * c for v, c in zip(planes, come)) - near[-1])  # the near one averages this pixel
        return (*(w * c for c in come), d * (centre + share * edge), squared * centre)

    zero = jnp.zeros_like(guide)
    near = (guide, *planes, *mirrored, shared)
    *by_plane, d_guide, d_space = _over_disc(terms, (*mirrored, zero, zero), near, radius, _BACKWARD_TAPS)
    by_rows = jnp.matmul(d_space, jnp.ones(d_space.shape[1], d_space.dtype), precision=lax.Precision.HIGHEST)
    return tuple(share * t for t in by_plane), d_guide, by_rows


def _weight(sigma_space: jax.Array, sigma_range: jax.Array) -> Callable[..., tuple[jax.Array, jax.Array]]:
    """A function of (guide, near guide, squared distance): the weight and the guide difference."""
    to_bits = -0.5 / math.log(2)
    space, range_ = to_bits / sigma_space**2, to_bits / sigma_range**2

    def weight(guide: jax.Array, near: jax.Array, squared: jax.Array) -> tuple[jax.Array, jax.Array]:
        d = near - guide
        return _exp2(space * squared + range_ * d * d), d

    return weight


@jax.custom_jvp
def _exp2(x: jax.Array) -> jax.Array:
    """2**x of x <= 0; in float32 a polynomial, within 3e-7.

    XLA will not compute its own exp twice, so that with several sums it stores the weight of each tap.
    """
    if x.dtype != jnp.float32:
        return jnp.exp2(x)
    x = jnp.maximum(x, -125.0)
    whole = nearest_int(x)
    rest, part = x - whole.astype(x.dtype), jnp.full_like(x, _EXP2[-1])
    for coefficient in _EXP2[-2::-1]:
        part = part * rest + coefficient
    # the whole number is added to the exponent
    bits = lax.bitcast_convert_type(part, jnp.int32) + (whole << 23)
    return lax.bitcast_convert_type(bits, jnp.float32)


@_exp2.defjvp
def _exp2_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    y = _exp2(*primals)
    return y, math.log(2) * y * tangents[0]


def _over_disc(
    terms: Callable[[Planes, jax.Array], Planes],
    start: Planes,
    near: Planes,
    radius: int,
    most: tuple[int, int],
) -> Planes:
    """Add `terms(moved planes, squared distance)` to `start` over a disc without its centre.

    One tap is traced, and called: the compiler puts calls in line. `most` are the taps of a kernel, on a CPU
    and elsewhere. A CPU has one kernel in a loop, so that one is compiled.
    """
    span, shape = range(-radius, radius + 1), near[0].shape
    taps = np.asarray([(y, x) for y in span for x in span if 0 < y * y + x * x <= radius * radius])
    padded = tuple(pad(x, radius, whole=len(taps) > _FEW_TAPS) for x in near)
    # unsigned, or each index is tested for its sign
    table = (taps + radius).astype(np.uint32), (taps**2).sum(1).astype(near[0].dtype)

    @jax.jit
    def tap(total: Planes, padded: Planes, place: jax.Array, squared: jax.Array) -> Planes:
        moved = tuple(lax.dynamic_slice(x, tuple(place), shape) for x in padded)
        return tuple(t + more for t, more in zip(total, _paired(terms(moved, squared))))

    def kernel(total: Planes, some: Any) -> Planes:
        for place, squared in zip(*some):
            total = tap(total, padded, place, squared)
        return total

    def looped(total: Planes) -> Planes:
        rest = len(taps) % most[0] if len(taps) > _FEW_TAPS else len(taps)
        total = kernel(total, [column[:rest] for column in table])
        loop = [column[rest:].reshape(-1, most[0], *column.shape[1:]) for column in table]
        return lax.scan(lambda total, some: (kernel(total, some), None), total, loop)[0]

    def unrolled(total: Planes) -> Planes:
        for i in range(0, len(taps), most[1]):
            total = store_off_cpu(kernel(total, [column[i : i + most[1]] for column in table]))
        return total

    total = by_platform(alike(_paired(start), padded), cpu=looped, default=unrolled)
    return _parted(store(total), len(start))


def _paired(planes: Planes) -> Planes:
    """Two by two as complex planes: XLA's CPU code would compute the weights anew for each array of sums."""
    if planes[0].dtype not in (jnp.float32, jnp.float64):
        return planes
    whole = [lax.complex(a, b) for a, b in zip(planes[::2], planes[1::2])]
    return (*whole, *planes[2 * len(whole) :])


def _parted(paired: Planes, count: int) -> Planes:
    """The planes that `_paired` put together."""
    if len(paired) == count:
        return paired
    planes = [part for x in paired[: count // 2] for part in (lax.real(x), lax.imag(x))]
    return (*planes, *paired[count // 2 :])
