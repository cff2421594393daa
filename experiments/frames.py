"""Pictures in larger frames: what keeps its bits, what does not, and what a frame costs.

python -m experiments.frames products   # a product of matrices, and the same with rows and columns of zeros
python -m experiments.frames stages     # stages that look beyond a pixel, in a mirrored frame
python -m experiments.frames time       # CPU seconds of a picture alone and in a frame
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.extents import Extent, mirrored
from jaxisp.pipeline import Chain, stage
from jaxisp.recipe import Recipe
from jaxisp.stages import STAGES
from jaxisp.testing import Subject

SIZES = (
    (12, 20), (16, 24), (20, 32), (33, 40), (40, 64), (50, 97), (64, 128), (100, 160), (128, 200), (130, 256),
    (200, 256), (250, 400), (300, 512),
)  # fmt: skip
"""Cells along a side of a picture, and of its frame."""


def products() -> None:
    """As the blur of the bilateral grid was: of 20 bins of 3 planes along the rows, of one plane."""
    rng = np.random.default_rng(0)
    times = jax.jit(partial(jnp.matmul, precision=lax.Precision.HIGHEST))
    for n, larger in SIZES:
        differ = []
        for rows in (60, 1):
            a, b = (rng.random(shape, np.float32) for shape in ((rows * n, n), (n, n + 2)))
            wide = [np.zeros(shape, np.float32) for shape in ((rows * larger, larger), (larger, larger + 2))]
            wide[0][: rows * n, :n], wide[1][:n, : n + 2] = a, b
            differ.append(np.mean(times(a, b) != times(*wide)[: rows * n, : n + 2]))
        print(f"{n} of {larger}: {differ[0]:.0%} and {differ[1]:.0%} differ", flush=True)


def stages() -> None:
    """How many values differ, and by how much at most, by stage."""
    for name in sorted(STAGES):
        node = stage(name)
        if not node.reach or node.margin == 0:
            continue
        framed = jax.jit(lambda p, x, extent, node=node: node(p, mirrored(x, extent)))
        subject, worst = Subject(node, (46, 62)), (0.0, 0.0)
        for seed, (height, width) in enumerate([(46, 62), (33, 47)]):
            image, params = subject.image(seed)[:height, :width], subject.params(seed=seed)
            frame = np.pad(image, [(0, 96 - height), (0, 112 - width), (0, 0)][: image.ndim])
            whole = framed(params, frame, Extent(jnp.int32(height), jnp.int32(width)))
            apart = np.abs(np.asarray(jax.jit(node)(params, image)) - whole[:height, :width])
            worst = max(worst[0], float(np.mean(apart > 0))), max(worst[1], float(apart.max()))
        print(f"{name}: {worst[0]:.1%} differ, by up to {worst[1]:.1g}", flush=True)
        jax.clear_caches()


def cost() -> None:
    """Noise to JPEG, a later call."""
    names = (
        "srgb_eotf",
        "mosaic",
        "shot_read_noise",
        "demosaic_hibbard",
        "median",
        "unsharp_mask",
        "srgb_oetf",
        "jpeg",
    )
    recipe, key = Recipe(Chain(tuple(map(stage, names)), "camera"), {}), jax.random.key(0)
    for height, width in ((300, 400), (600, 700), (1356, 2040)):
        image = np.random.default_rng(0).random((1, height, width, 3), np.float32)
        frame = np.pad(image, [(0, 0), (0, 24), (0, 24), (0, 0)])
        alone = _seconds(lambda image=image: recipe.degrade(key, image))
        framed = _seconds(lambda frame=frame, size=(height, width): recipe.degrade(key, frame, sizes=[size]))
        print(f"{height} x {width}: alone {alone:.3f} s, in a frame {framed:.3f} s", flush=True)
        jax.clear_caches()


def _seconds(fn: Callable[[], Any]) -> float:
    jax.block_until_ready(fn())
    each = []
    for _ in range(5):
        start = time.process_time()
        jax.block_until_ready(fn())
        each.append(time.process_time() - start)
    return float(np.median(each))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("products", "stages", "time"))
    {"products": products, "stages": stages, "time": cost}[parser.parse_args().what]()


if __name__ == "__main__":
    main()
