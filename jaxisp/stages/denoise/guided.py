"""The guided filter."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import filter_rows_columns
from jaxisp.color import luma
from jaxisp.domains import RGB
from jaxisp.options import Positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register


@parameters
class GuidedFilter:
    """How much is smoothed, and what counts as an edge."""

    strength: Leaf = param(1.0, (0.0, 1.0), "share", doc="of the filtered picture; 0 keeps the image")
    edge: Leaf = param(0.03, (1e-3, 1.0), "level", log=True, doc="deviation in a window that is half kept")


@register(reach=lambda o: 2 * o["radius"])
def guided_filter(params: GuidedFilter, image: RGB, *, radius: Positive = 4) -> RGB:
    """Replace each window of every channel by a line of luma, and average the lines over the windows.

    In a window `a = cov(I, p) / (var(I) + edge**2)` and `b = mean(p) - a mean(I)`, I luma and p the channel;
    the result is `mean(a) I + mean(b)`, a share `strength` of it.

    Args:
        params: strength; edge in the unit of the image.
        image: (H, W, 3), any range.
        radius: of the square windows [px].

    Returns:
        (H, W, 3) in the domain of the image. Borders are reflected.

    Gradient: exact.

    Source: He, Sun & Tang 2010, "Guided image filtering".
    """
    guide = luma(*planes(image))
    smoothed = interleaved([guided_plane(p, guide, params.edge, radius) for p in planes(image)])
    return image + params.strength * (smoothed - image)


def guided_plane(plane: jax.Array, guide: jax.Array, edge: jax.Array | float, radius: int) -> jax.Array:
    """The guided filter of one (H, W) plane; see `guided_filter`."""
    taps = (1 / (2 * radius + 1),) * (2 * radius + 1)

    def mean(x: jax.Array) -> jax.Array:
        return materialize(filter_rows_columns(x, taps, taps))

    # about the middle of the range: a variance that is a difference of squares loses digits otherwise
    centred = guide - 0.5
    of_guide, of_plane = mean(centred), mean(plane)
    variance = jnp.maximum(mean(centred * centred) - of_guide * of_guide, 0)
    slope = (mean(centred * plane) - of_guide * of_plane) / (variance + edge * edge)
    return mean(slope) * centred + mean(of_plane - slope * of_guide)
