"""Points that have nothing to do with each other, looked at side by side.

A program for a few small pictures keeps one core busy for much of its time, and Python's lock is free then.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_One = TypeVar("_One")
_Found = TypeVar("_Found")
_MOST = 4
"""Each holds pictures of its own."""


def each(look: Callable[[_One], _Found], points: Iterable[_One]) -> list[_Found]:
    """As `[look(p) for p in points]`, on as many threads as the process may use cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores == 1:
        return [look(point) for point in points]
    with ThreadPoolExecutor(min(cores, _MOST)) as pool:
        return list(pool.map(look, points))
