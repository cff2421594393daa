"""What runs on whole pictures in strips of rows: a large picture takes no more memory than a strip."""

from collections.abc import Callable

import numpy as np

STRIP = 512
"""Rows at once, a multiple of the blocks of JPEG and of `jaxisp.fit.noise`."""
HALO = 16
"""Rows around a strip, such a multiple too."""


def strips(height: int) -> list[slice]:
    """The rows of each strip; all rows in one where a picture is not large."""
    step = STRIP if height > 2 * STRIP else height
    return [slice(top, min(top + step, height)) for top in range(0, height, step)]


def in_strips(function: Callable[..., np.ndarray], *images: np.ndarray) -> np.ndarray:
    """A function of whole pictures of one height, run on strips of them with their surroundings.

    Args:
        function: to an array of as many rows; looks at most `HALO` rows far.
    """
    height, out = len(images[0]), None
    for rows in strips(height):
        first, last = max(rows.start - HALO, 0), min(rows.stop + HALO, height)
        done = function(*(image[first:last] for image in images))
        if out is None:
            out = np.empty((height, *done.shape[1:]), done.dtype)
        out[rows] = done[rows.start - first : rows.stop - first]
    assert out is not None, "a picture has rows"
    return out
