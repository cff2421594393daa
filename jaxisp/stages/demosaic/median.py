"""The 3x3 median as a network, and the colour-difference median that removes false colour."""

from functools import reduce

import jax
import jax.numpy as jnp

from jaxisp.domains import CameraRGB
from jaxisp.numerics import materialize, planes
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import Pair, Planes
from jaxisp.windows import pad, square, views


def median_3x3(plane: jax.Array) -> jax.Array:
    """The median of the 3x3 window around every sample of (H, W); borders are reflected.

    Gradient: to the sample that is the median, in equal shares where several are (reverse mode only).
    """
    return materialize(_median_inside(pad(plane, 1)))


@jax.custom_vjp
def _median_inside(padded: jax.Array) -> jax.Array:
    """(H + 2, W + 2) to (H, W)."""
    window = views(padded, square(1), 1)
    columns = [_sort_three(window[i], window[i + 3], window[i + 6]) for i in range(3)]
    lows, middles, highs = zip(*columns, strict=True)
    return _middle(reduce(jnp.maximum, lows), _middle(*middles), reduce(jnp.minimum, highs))


def _median_forward(padded: jax.Array) -> tuple[jax.Array, Pair]:
    median = _median_inside(padded)
    return median, (padded, median)


def _median_backward(saved: Pair, cotangent: jax.Array) -> tuple[jax.Array]:
    """The adjoint, written as reads: each sample collects from the windows whose median it is."""
    padded, median = saved
    hits = reduce(jnp.add, [(v == median).astype(median.dtype) for v in views(padded, square(1), 1)])
    share, median = materialize((jnp.pad(cotangent / hits, 2), jnp.pad(median, 2)))
    windows = zip(views(share, square(1), 1), views(median, square(1), 1), strict=True)
    return (reduce(jnp.add, [jnp.where(padded == m, s, 0) for s, m in windows]),)


_median_inside.defvjp(_median_forward, _median_backward)


def _sort_three(a: jax.Array, b: jax.Array, c: jax.Array) -> Planes:
    a, b = jnp.minimum(a, b), jnp.maximum(a, b)
    b, c = jnp.minimum(b, c), jnp.maximum(b, c)
    return jnp.minimum(a, b), jnp.maximum(a, b), c


def _middle(a: jax.Array, b: jax.Array, c: jax.Array) -> jax.Array:
    return jnp.maximum(jnp.minimum(a, b), jnp.minimum(jnp.maximum(a, b), c))


def smooth_differences(rgb: Planes, passes: int) -> Planes:
    """`color_difference_median` on planes."""
    if passes < 0:
        raise ValueError(f"passes of the colour-difference median must be 0 or more, got {passes}")
    red, green, blue = rgb
    for _ in range(passes):
        red_green, blue_green = median_3x3(red - green), median_3x3(blue - green)
        red, blue = materialize((red_green + green, blue_green + green))
        from_red, from_blue = median_3x3(green - red), median_3x3(green - blue)
        green = materialize(0.5 * ((from_red + red) + (from_blue + blue)))
    return red, green, blue


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

    Gradient: exact: to the sample that is the median, in equal shares where several are
    (reverse mode only).

    Source: Hirakawa & Parks 2005, interpolation artifact reduction; Freeman 1988, US patent 4724395.
    """
    return jnp.stack(smooth_differences(planes(image), passes), axis=-1)  # type: ignore[arg-type]
