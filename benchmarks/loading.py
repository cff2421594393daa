"""How fast training loops are fed: images a second of each way in, and how long the device waits.

    python -m benchmarks.loading [--out FILE.json]

The device's idle share is what is left of a step's time when the same step on batches that are on the device
already is taken off: 1 - (time with batches there) / (time with the loader).
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.machine import machine
from jaxisp.data import Batches, CleanImages, CleanPatches, DegradedBatches, ShardSource, degrade_shards
from jaxisp.data.sources import degrade_key
from jaxisp.data.work import Work
from jaxisp.io import write_png
from jaxisp.recipes import RECIPES

BATCH, SIZE, STEPS, ROUNDS = 32, 80, 6, 5


def photographs(count: int = 4) -> CleanImages:
    """Noise over waves: what is shown does not change the times."""
    rng, images = np.random.default_rng(0), []
    for i in range(count):
        y, x = np.mgrid[:480, :640]
        waves = 0.5 + 0.4 * np.sin(x / (9 + i))[..., None] * np.cos(y / 13)[..., None]
        images.append(np.uint16(65535 * np.clip(waves + rng.normal(0, 0.05, (480, 640, 3)), 0, 1)))
    return CleanImages(tuple(map(str, range(count))), tuple(images))


@jax.jit
def light_step(total: jax.Array, noisy: jax.Array, clean: jax.Array) -> jax.Array:
    """Stands for a network that takes next to no time: the hardest to feed."""
    return total + jnp.abs(noisy - clean).mean()


def per_step(pairs: Iterator[Any], steps: int = STEPS) -> float:
    """Seconds a step."""
    total = light_step(jnp.zeros(()), *next(pairs))
    total.block_until_ready()
    clock = time.perf_counter()
    for _ in range(steps):
        total = light_step(total, *next(pairs))
    total.block_until_ready()
    return (time.perf_counter() - clock) / steps


def ways(folder: Path) -> dict[str, Callable[[], Iterator[Any]]]:
    """Each way to come by (noisy, clean) batches."""
    source, recipe, key = CleanPatches(photographs(), SIZE), RECIPES["phone"](), degrade_key(0)
    clean = jax.device_put(source.batch(range(BATCH)))
    grain_source = DegradedBatches(source, recipe, batch=BATCH, epochs=10**6)
    loader = Batches(source, recipe, batch=BATCH)
    shards = _shards(folder, source)

    def on_device() -> Iterator[Any]:
        while True:
            yield recipe.degrade(key, clean, 0)[0], clean

    def plain() -> Iterator[Any]:
        for first in range(0, 10**9, BATCH):
            batch = source.batch(range(first, first + BATCH))
            yield recipe.degrade(key, batch, first)[0], batch

    def from_grain() -> Iterator[Any]:
        for i in range(10**6):
            yield tuple(grain_source[i].values())

    def from_shards() -> Iterator[Any]:
        order = np.random.default_rng(0).integers(len(shards), size=(10**4, BATCH))
        for chosen in order:
            samples = [shards[i] for i in chosen]
            yield tuple(np.stack([s[k] for s in samples]) for k in ("noisy", "clean"))

    return {
        "clean patches on the device already": on_device,
        "Batches: cut ahead in a thread": lambda: loader,
        "patches and recipe.degrade, in turn": plain,
        "DegradedBatches, as grain reads it": from_grain,
        "ShardSource: degraded before": from_shards,
    }


def _shards(folder: Path, source: CleanPatches) -> ShardSource:
    for i, image in enumerate(source.batch(range(BATCH))):
        write_png(folder / f"{i}.png", image)
    degrade_shards(Work([folder], RECIPES["phone"](), count=1), folder / "shards", 1)
    return ShardSource(folder / "shards")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = {name: make() for name, make in ways(Path(folder)).items()}
        times: dict[str, list[float]] = {name: [] for name in found}
        for _ in range(ROUNDS):
            for name, pairs in found.items():
                times[name].append(per_step(pairs))
    median = {name: float(np.median(values)) for name, values in times.items()}
    there = median["clean patches on the device already"]
    cutting = time_of_cutting()
    rows = {
        name: {
            "images_per_second": round(BATCH / seconds, 1),
            "ms": round(1e3 * seconds, 2),
            "idle_share": round(max(0.0, 1 - there / seconds), 3),
        }
        for name, seconds in median.items()
    }
    result = {"batch": BATCH, "patch": SIZE, "recipe": "phone", "cutting_ms": cutting, "rows": rows}
    print(json.dumps(result, indent=1))
    if arguments.out:
        arguments.out.write_text(json.dumps({**result, "machine": machine()}, indent=1) + "\n")


def time_of_cutting() -> float:
    """Milliseconds to cut a batch of patches on the host."""
    source = CleanPatches(photographs(), SIZE)
    clock = time.perf_counter()
    for i in range(10):
        source.batch(range(i * BATCH, (i + 1) * BATCH))
    return round(100 * (time.perf_counter() - clock), 2)


if __name__ == "__main__":
    main()
