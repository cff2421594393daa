"""Time every stage on one batch: compile, forward, and gradient to parameters and image.

    make bench                              # all stages
    python -m benchmarks.stages jpeg bilateral --out benchmarks/results/stages.json

Rounds are interleaved over the stages, so that a busy moment hits all alike; medians are reported
with the interquartile range. Machine and versions are in the JSON.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxisp.pipeline import Stage, run_batch, stage
from jaxisp.stages import STAGES

BATCH, SIDE, ROUNDS = 32, 80, 9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help="default: all")
    parser.add_argument("--out", type=Path, help="also write JSON here")
    arguments = parser.parse_args()
    names = arguments.stages or sorted(STAGES)
    cases = {
        f"{name} {what}": prepare(stage(name), what) for name in names for what in ("forward", "gradient")
    }
    compiled = {name: timed(call) for name, call in cases.items()}
    samples: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(ROUNDS):
        for name, call in cases.items():
            samples[name].append(timed(call))
    results = {name: summary(compiled[name], times) for name, times in samples.items()}
    show(names, results)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps({"machine": machine(), "milliseconds": results}, indent=1))


def prepare(case: Stage, what: str) -> Callable[[], Any]:
    """A call without arguments that runs the stage on the batch, once warm."""
    rng = np.random.default_rng(0)
    shape = (BATCH, SIDE, SIDE) if case.domain_in.channels == 1 else (BATCH, SIDE, SIDE, 3)
    images = jax.device_put(rng.uniform(0.02, 0.98, shape).astype(np.float32))
    params, key = jax.device_put(case.init()), jax.random.key(0)
    if what == "forward":
        return lambda: run_batch(case, params, images, key)
    gradient = jax.jit(jax.grad(lambda p, x: jnp.sum(run_batch(case, p, x, key) ** 2), argnums=(0, 1)))
    return lambda: gradient(params, images)


def timed(call: Callable[[], Any]) -> float:
    clock = time.perf_counter()
    jax.block_until_ready(call())
    return 1e3 * (time.perf_counter() - clock)


def summary(first: float, times: list[float]) -> dict[str, float]:
    low, median, high = np.percentile(times, (25, 50, 75))
    return {"first": round(first, 1), "median": round(median, 3), "iqr": round(high - low, 3)}


def show(names: list[str], results: dict[str, dict[str, float]]) -> None:
    title = f"batch of {BATCH} at {SIDE}x{SIDE}, ms, medians of {ROUNDS}"
    table = Table(
        "stage", "forward", "gradient", "gradient / forward", "first gradient call", title=title, box=None
    )
    for name in names:
        forward, gradient = results[f"{name} forward"], results[f"{name} gradient"]
        ratio = gradient["median"] / forward["median"]
        table.add_row(
            name,
            f"{forward['median']:.2f}",
            f"{gradient['median']:.2f}",
            f"{ratio:.1f}",
            f"{gradient['first'] / 1e3:.1f} s",
        )
    Console(width=120).print(table)


def machine() -> dict[str, Any]:
    return {
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "cores": os.cpu_count(),
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jax.lib.__version__,
        "numpy": np.__version__,
    }


if __name__ == "__main__":
    main()
