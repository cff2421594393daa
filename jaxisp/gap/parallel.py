"""Points that have nothing to do with each other, looked at side by side.

A program for a few small pictures keeps one core busy for much of its time, and Python's lock is free then.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from jaxisp.process import cores

_One = TypeVar("_One")
_Found = TypeVar("_Found")
MOST = 4
"""Threads: each holds pictures of its own."""


def each(look: Callable[[_One], _Found], points: Iterable[_One]) -> list[_Found]:
    """As `[look(p) for p in points]`, on as many threads as the process may use cores.

    The first is looked at alone: two threads that came to a new program at once would both compile it.
    """
    points = list(points)
    count = min(cores.available(), MOST, len(points) - 1)
    if count < 2:
        return [look(point) for point in points]
    with ThreadPoolExecutor(count) as pool:
        return [look(points[0]), *pool.map(look, points[1:])]


@contextlib.contextmanager
def beside(work: Callable[[], object]) -> Iterator[None]:
    """Do this on a thread of its own meanwhile, and wait for it at the end."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(work)
        yield
        done.result()
