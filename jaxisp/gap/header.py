"""What the header of a RAW file says of its lens."""

import numpy as np

from jaxisp.io import Raw
from jaxisp.io.opcodes import optical_centre
from jaxisp.stages.optics import RectilinearWarp


def stated_warp(
    raw: Raw, start: tuple[int, int] = (0, 0), shape: tuple[int, int] | None = None
) -> RectilinearWarp | None:
    """The correction of the lens that a RAW file states, for a part of its mosaic; None where it states none.

    Args:
        raw: the file.
        start: row and column of the part's first pixel.
        shape: of the part; to the mosaic's end unless given.
    """
    if raw.warp is None:
        return None
    top, left, bottom, right = raw.active_area
    centre, farthest = optical_centre(raw.warp.center, (bottom - top, right - left))
    first = np.add(raw.crop[:2], start)
    size = np.maximum(np.subtract(shape or np.subtract(raw.mosaic.shape, start), 1), 1)
    polynomials = np.broadcast_to(raw.warp.coefficients[:3], (3, 6)).astype(np.float32)
    return RectilinearWarp(
        radial=polynomials[:, :4] - np.eye(1, 4, dtype=np.float32),
        tangential=polynomials[:, 4:],
        centre=np.float32((centre - first) / size),
        farthest=np.float32(2 * max(farthest, 1.0) / np.hypot(*size)),
    )
