"""Small files that the tests of jaxisp.io write for themselves."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.io.dng import write_dng

XYZ_TO_CAMERA = np.array([[0.6461, -0.1164, -0.0857], [-0.3825, 1.1597, 0.2534], [-0.0416, 0.154, 0.6039]])
NEUTRAL = (0.5, 1.0, 0.625)
BLACK = (64.0, 65.0, 66.0, 70.0)
WHITE = 1023


def mosaic(height: int = 52, width: int = 70, seed: int = 0) -> np.ndarray:
    """Noise over a ramp, in units of the file."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(60, 1000, width)[None] + rng.normal(0, 10, (height, width))
    return np.clip(ramp, 40, WHITE).astype(np.uint16)


def dng(path: Path, pixels: np.ndarray | None = None, **options: Any) -> Path:
    """A valid DNG; `options` go to write_dng."""
    settings: dict[str, Any] = {
        "cfa": "RGGB",
        "black": BLACK,
        "white": WHITE,
        "color_matrix": XYZ_TO_CAMERA,
        "as_shot_neutral": NEUTRAL,
    }
    return write_dng(path, mosaic() if pixels is None else pixels, **{**settings, **options})
