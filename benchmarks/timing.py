"""Fair timing: calls take turns, so that a busy moment and a warm cache fall on all alike."""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.machine import set_threads
from benchmarks.torch_peer import wait

SHORTEST = 5e-3
"""Seconds: shorter calls are repeated within a sample."""
WARM = 60e-3
"""Seconds for which a call runs before a sample of it."""
LONG = 0.3
"""Seconds: what takes longer is not run before it is sampled."""
LEAST_ROUNDS = 5


def seconds(call: Callable[[], Any]) -> float:
    """One call, its result waited for."""
    clock = time.perf_counter()
    finish(call)
    return time.perf_counter() - clock


def finish(call: Callable[[], Any]) -> None:
    """Call, and wait for the result, JAX's or torch's."""
    jax.block_until_ready(call())
    wait()


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
    alone = {name: min(seconds(call) for _ in range(3)) for name, call in calls.items()}
    clock = time.perf_counter()
    for done in range(rounds):
        if done >= LEAST_ROUNDS and time.perf_counter() - clock > budget:
            break
        for name, call in calls.items():
            samples[name].append(sample(call, alone[name], threads.get(name)))
    return samples


def sample(call: Callable[[], Any], expected: float, threads: int | None) -> float:
    """Mean seconds of some calls in a row, after some that do not count.

    Those wake the call's own threads, fill the caches with its data and outlast the threads of the call
    before, which wait busily for a while: the first call after another library's took up to twice as long.
    And a Linux that was idle puts both threads of a call on one core, until it has seen them busy for some
    tens of ms.
    """
    if threads is not None:
        set_threads(threads)
    repeats = max(1, round(SHORTEST / expected))
    clock = time.perf_counter()
    while expected < LONG and time.perf_counter() - clock < WARM:
        finish(call)
    clock = time.perf_counter()
    for _ in range(repeats):
        finish(call)
    spent = (time.perf_counter() - clock) / repeats
    if threads is not None:
        set_threads(None)
    return spent


def summary(samples: list[float]) -> dict[str, float]:
    """Median and interquartile range in ms."""
    low, median, high = 1e3 * np.percentile(samples, (25, 50, 75))
    return {"ms": round(median, 4), "iqr": round(high - low, 4)}
