"""A small picture, its coordinates, and a stage run on it: what the tests of optics share."""

import re

import jax
import numpy as np
from numpy.typing import DTypeLike

from jaxisp.pipeline import run, stage
from jaxisp.testing import smooth_image

H, W = SHAPE = (21, 34)
CENTRE = np.array([(H - 1) / 2, (W - 1) / 2])


def picture(seed: int = 0, dtype: DTypeLike = np.float32, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return smooth_image((*shape, 3), seed).astype(dtype)


def apply(params, image: np.ndarray) -> np.ndarray:
    """Run the stage that takes these parameters: its name is their class's, in snake case."""
    node = stage(re.sub(r"(?<!^)(?=[A-Z])", "_", type(params).__name__).lower())
    return np.asarray(
        run(node, {node.name: jax.tree.map(lambda v: np.asarray(v, image.dtype), params)}, image)
    )


def offsets() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:H, :W].astype(float)
    return y - CENTRE[0], x - CENTRE[1]


def squared_radius() -> np.ndarray:
    y, x = offsets()
    return (y**2 + x**2) / (CENTRE**2).sum()
