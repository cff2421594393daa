"""Fair timing: calls take turns, so that a busy moment and a warm cache fall on all alike."""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.machine import set_threads

SHORTEST = 3e-3
"""Seconds: shorter calls are repeated within a sample."""
LEAST_ROUNDS = 5


def seconds(call: Callable[[], Any]) -> float:
    """One call, its result waited for."""
    clock = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - clock


def interleaved(
    calls: dict[str, Callable[[], Any]],
    rounds: int,
    budget: float,
    threads: dict[str, int | None] | None = None,
) -> dict[str, list[float]]:
    """Samples of each call in seconds, one a round, all calls in turn.

    Args:
        calls: warm already.
        rounds: how many at most.
        budget: seconds after which no further round is begun, once there are `LEAST_ROUNDS`.
        threads: for calls that need OpenCV and torch at a certain number of threads.
    """
    threads = threads or {}
    samples: dict[str, list[float]] = {name: [] for name in calls}
    repeats = {name: max(1, round(SHORTEST / seconds(call))) for name, call in calls.items()}
    clock = time.perf_counter()
    for done in range(rounds):
        if done >= LEAST_ROUNDS and time.perf_counter() - clock > budget:
            break
        for name, call in calls.items():
            samples[name].append(sample(call, repeats[name], threads.get(name)))
    return samples


def sample(call: Callable[[], Any], repeats: int, threads: int | None) -> float:
    """Mean seconds of some calls in a row, after as many that do not count.

    Those make the pool of threads anew, and outlast the threads of another library, which wait busily.
    A single long call is not preceded by another.
    """
    if threads is not None:
        set_threads(threads)
    for _ in range(repeats if repeats > 1 or threads is not None else 0):
        call()
    clock = time.perf_counter()
    for _ in range(repeats):
        jax.block_until_ready(call())
    spent = (time.perf_counter() - clock) / repeats
    if threads is not None:
        set_threads(None)
    return spent


def summary(samples: list[float]) -> dict[str, float]:
    """Median and interquartile range in ms."""
    low, median, high = 1e3 * np.percentile(samples, (25, 50, 75))
    return {"ms": round(median, 4), "iqr": round(high - low, 4)}
