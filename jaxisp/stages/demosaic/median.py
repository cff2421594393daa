"""The colour-difference median, which removes false colour."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.domains import CameraRGB
from jaxisp.options import Count
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import Planes
from jaxisp.stages.denoise.median import median_plane


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

    def median(both: jax.Array) -> jax.Array:  # at once: half the kernels
        return jax.vmap(lambda plane: median_plane(plane, "3x3"))(both)

    differences = materialize(jnp.stack([red - green, blue - green]))
    for _ in range(passes):
        once = median(differences)
        change = once - median(once)
        more_green = 0.5 * (change[0] + change[1])
        green, differences = materialize((green + more_green, once - more_green[None]))
    return green + differences[0], green, green + differences[1]


@register(reach=lambda o: 2 * o["passes"], symmetric=True)
def color_difference_median(image: CameraRGB, *, passes: Count = 1) -> CameraRGB:
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
    red, green, blue = planes(image)
    return interleaved(smooth_differences((red, green, blue), passes))
