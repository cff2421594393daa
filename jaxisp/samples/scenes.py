"""Scenes for the reference phone: photographs that come with scikit-image, as linear light.

All are in the public domain or CC0 and need no download: Eileen Collins (NASA), a cup of coffee (Rachel
Michetti), the cat Chelsea (Stefan van der Walt), a Falcon 9 on its pad (SpaceX).
"""

from collections.abc import Iterator

import numpy as np
from PIL import Image

_NAMES = ("astronaut", "coffee", "chelsea", "rocket")


def scene_names() -> tuple[str, ...]:
    """The names of the photographs, in the order of `scenes`."""
    return _NAMES


def scenes(size: int | tuple[int, int]) -> Iterator[np.ndarray]:
    """Every photograph as a scene of that size; see `scene`."""
    return (scene(name, size) for name in _NAMES)


def scene(
    name: str, size: int | tuple[int, int], window: tuple[float, float, float] = (0.5, 0.5, 1.0)
) -> np.ndarray:
    """A photograph as linear light, cut to the shape wanted and reduced by averaging areas.

    Args:
        name: one of `scene_names()`.
        size: (rows, columns) of the result, or one number for a square.
        window: what to take: where its centre may go, from 0 (top, left) to 1, and its size as a share of
            the largest that fits.

    Returns:
        (H, W, 3) float32, linear sRGB in [0, 1].

    Raises:
        ValueError: no such photograph, or it has fewer pixels than wanted.

    Example:
        >>> scene("coffee", (40, 60)).shape
        (40, 60, 3)
    """
    height, width = (size, size) if isinstance(size, int) else size
    linear = photograph(name)
    rows, columns = linear.shape[:2]
    share = window[2] * min(rows / height, columns / width)
    if share < 1:
        raise ValueError(f"scene {name!r}: {height}x{width} px are more than the photograph has there")
    cut = share * height, share * width
    top, left = ((n - c) * at for n, c, at in zip((rows, columns), cut, window))
    box = (left, top, min(left + cut[1], columns), min(top + cut[0], rows))
    planes = (Image.fromarray(np.ascontiguousarray(linear[..., c])) for c in range(3))
    return np.stack([np.asarray(p.resize((width, height), Image.Resampling.BOX, box)) for p in planes], -1)


def photograph(name: str) -> np.ndarray:
    """(H, W, 3) float32: a photograph of `scene_names()`, with the sRGB curve undone."""
    if name not in _NAMES:
        raise ValueError(f"scene {name!r} is not one of {', '.join(_NAMES)}")
    from skimage import data  # slow to import

    encoded = getattr(data, name)().astype(np.float32) / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
