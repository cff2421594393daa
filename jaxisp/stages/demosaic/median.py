"""The 3x3 median as a network, and the colour-difference median that removes false colour."""

from functools import partial, reduce

import jax
import jax.numpy as jnp

from jaxisp.domains import CameraRGB
from jaxisp.numerics import materialize, planes
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import Pair, Planes
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear
from jaxisp.striping import in_strips_on_cpu
from jaxisp.windows import pad, square, views


def median_3x3(plane: jax.Array) -> jax.Array:
    """The median of the 3x3 window around every sample of (H, W); borders are reflected.

    Gradient: to the sample that is the median, in equal shares where several are.
    """
    return piecewise_linear(_evaluate, _share, mirrored(_share, _collect, plane.shape))(plane)


def _evaluate(plane: jax.Array) -> tuple[jax.Array, Pair]:
    """The medians, and what tells which samples they are."""
    median = materialize(in_strips_on_cpu(_medians, plane, 1))
    return median, (plane, median)


def _medians(plane: jax.Array) -> jax.Array:
    window = views(pad(plane, 1), square(1), 1)
    columns = [_sort_three(window[i], window[i + 3], window[i + 6]) for i in range(3)]
    lows, middles, highs = zip(*columns, strict=True)
    return _middle(reduce(_high, lows), _middle(*middles), reduce(_low, highs))


def _is_median(plane: jax.Array, median: jax.Array) -> list[jax.Array]:
    return [view == median for view in views(pad(plane, 1), square(1), 1)]


def _share(plane: jax.Array, median: jax.Array, tangent: jax.Array) -> jax.Array:
    """The mean of the tangents of the samples that are the median."""
    hits = _is_median(plane, median)
    near = views(pad(tangent, 1), square(1), 1)
    total = reduce(jnp.add, [jnp.where(hit, t, 0) for hit, t in zip(hits, near, strict=True)])
    return total / reduce(jnp.add, [hit.astype(total.dtype) for hit in hits])


def _collect(plane: jax.Array, median: jax.Array, cotangent: jax.Array) -> jax.Array:
    """The adjoint of `_share`: each sample collects from the windows whose median it is."""
    hits = reduce(jnp.add, [hit.astype(cotangent.dtype) for hit in _is_median(plane, median)])
    shares, medians = (pad(p, 1) for p in materialize((cotangent / hits, median)))
    windows = zip(views(shares, square(1), 1), views(medians, square(1), 1), strict=True)
    return reduce(jnp.add, [jnp.where(plane == m, s, 0) for s, m in windows])


def _low(a: jax.Array, b: jax.Array) -> jax.Array:
    # one instruction; jnp.minimum takes several to pass on NaN
    return jnp.where(a < b, a, b)


def _high(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.where(a < b, b, a)


def _sort_three(a: jax.Array, b: jax.Array, c: jax.Array) -> Planes:
    a, b = _low(a, b), _high(a, b)
    b, c = _low(b, c), _high(b, c)
    return _low(a, b), _high(a, b), c


def _middle(a: jax.Array, b: jax.Array, c: jax.Array) -> jax.Array:
    return _high(_low(a, b), _low(_high(a, b), c))


def smooth_differences(rgb: Planes, passes: int) -> Planes:
    """`color_difference_median` on planes.

    With d = med(R - G), the new R is d + G, so that med(G - R) is -med(d), and the pass changes green by
    half the sum of d - med(d) over red and blue: all is told by the two differences.
    """
    if passes < 0:
        raise ValueError(f"passes of the colour-difference median must be 0 or more, got {passes}")
    if passes == 0:
        return rgb
    return in_strips_on_cpu(partial(_smooth_differences, passes), rgb, 2 * passes)


def _smooth_differences(passes: int, rgb: Planes) -> Planes:
    red, green, blue = rgb
    median = jax.vmap(median_3x3)  # both at once: half the kernels
    differences = materialize(jnp.stack([red - green, blue - green]))
    for _ in range(passes):
        once = median(differences)
        change = once - median(once)
        more_green = 0.5 * (change[0] + change[1])
        green, differences = materialize((green + more_green, once - more_green))
    return green + differences[0], green, green + differences[1]


@register
def color_difference_median(image: CameraRGB, *, passes: int = 1) -> CameraRGB:
    """Take away isolated false colour after demosaicking: 3x3 medians of the colour differences.

    A pass is `R = med(R - G) + G`, `B = med(B - G) + G`, then with these
    `G = (med(G - R) + R + med(G - B) + B) / 2`.

    Args:
        image: (H, W, 3) camera RGB, any range.
        passes: how many times.

    Returns:
        (H, W, 3) camera RGB. Measured samples change too. Borders are reflected.

    Raises:
        ValueError: passes is negative.

    Gradient: exact: to the sample that is the median, in equal shares where several are.

    Source: Hirakawa & Parks 2005, interpolation artifact reduction; Freeman 1988, US patent 4724395.
    """
    return jnp.stack(smooth_differences(planes(image), passes), axis=-1)  # type: ignore[arg-type]
