"""Cubic convolution (Keys 1981, a = -1/2), in NumPy or JAX."""

from typing import Any

import numpy as np


def _weights(t: Any) -> tuple[Any, ...]:
    """Of the samples at -1, 0, 1 and 2 for a place `t` in [0, 1) after the one at 0."""
    return (
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t * t * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2 - 1.5 * t)),
        t * t * (-0.5 + 0.5 * t),
    )


def sample(xp: Any, image: Any, positions: Any, axis: int) -> Any:
    """Cubic convolution along one axis, in NumPy or JAX; `xp` says which."""
    first = xp.floor(positions)
    t = (positions - first).reshape((1,) * axis + (-1,) + (1,) * (image.ndim - 1 - axis))
    weights = _weights(t)
    index = xp.clip(first, -4, image.shape[axis] + 4).astype(np.int32)
    taps = (xp.take(image, xp.clip(index + k - 1, 0, image.shape[axis] - 1), axis=axis) for k in range(4))
    return sum(w * tap for w, tap in zip(weights, taps))


def cubic(xp: Any, plane: Any, y: Any, x: Any) -> Any:
    """Cubic convolution of (H, W) at (h, w) places [px]; the border goes on."""
    h, w = plane.shape
    top, left = xp.floor(y), xp.floor(x)
    rows, columns = (
        xp.stack([xp.clip(start + k - 1, 0, n - 1).astype(np.int32) for k in range(4)])
        for start, n in ((top, h), (left, w))
    )
    read = xp.take(plane.reshape(-1), rows[:, None] * w + columns[None])  # (4, 4, ...) in one gather
    weights_y, weights_x = (xp.stack(_weights(t)) for t in (y - top, x - left))
    return (weights_y * (weights_x[None] * read).sum(1)).sum(0)
