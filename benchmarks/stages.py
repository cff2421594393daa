"""Time every stage on one batch: compile, forward, and gradient to parameters and image.

    make bench                                # all stages
    python -m benchmarks.stages jpeg median   # some, printed only

Rounds are interleaved over the stages, so that a busy moment hits all alike; medians are reported
with the interquartile range. Machine and versions are in the JSON.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.machine import load, machine
from benchmarks.report import write_performance
from benchmarks.timing import seconds
from jaxisp.pipeline import Stage, run_batch, stage
from jaxisp.stages import STAGES

BATCH, SIDE, ROUNDS = 32, 80, 9
RESULTS = Path("benchmarks/results/stages.json")
PAGE = Path("docs/results/performance.md")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help="default: all, which is written")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    arguments = parser.parse_args()
    names = arguments.stages or sorted(STAGES)
    cases = {
        f"{name} {what}": prepare(stage(name), what) for name in names for what in ("forward", "gradient")
    }
    busy = [load()]
    compiled = {name: timed(call) for name, call in cases.items()}
    samples: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(ROUNDS):
        for name, call in cases.items():
            samples[name].append(timed(call))
    results = {name: summary(compiled[name], times) for name, times in samples.items()}
    show(names, results)
    if not arguments.stages:
        found = {"machine": machine(), "load": [*busy, load()], "milliseconds": results}
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")
        peers = arguments.out.with_name("peers.json")
        write_performance(arguments.report, peers=peers, stages=arguments.out)


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
    return 1e3 * seconds(call)


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


if __name__ == "__main__":
    main()
