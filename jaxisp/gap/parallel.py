"""Independent pieces of work on threads, and results that threads share.

A program for a few small pictures keeps one core busy for much of its time, and Python's lock is free then.
"""

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

from jaxisp.process import cores

_One = TypeVar("_One")
_Found = TypeVar("_Found")
MOST = 4
"""Threads: each holds pictures of its own."""


def parallel_map(function: Callable[[_One], _Found], items: Iterable[_One]) -> list[_Found]:
    """As `[function(i) for i in items]`, on as many threads as the process may use cores.

    The first item runs alone: two threads that came to a new program at once would both compile it.
    """
    items = list(items)
    count = min(cores.available(), MOST, len(items) - 1)
    if count < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        return [function(items[0]), *pool.map(function, items[1:])]


@contextlib.contextmanager
def in_background(work: Callable[[], object]) -> Iterator[None]:
    """Do this on a thread of its own meanwhile, and wait for it at the end."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(work)
        yield
        done.result()


class Memo(Generic[_Found]):
    """The results last used of a function, by what they depend on; threads may share it."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: OrderedDict[Hashable, _Found] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], _Found]) -> _Found:
        """The result that goes by this key, made where it is not known."""
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        made = make()
        with self._lock:
            self._known[key] = made
            while len(self._known) > self._most:
                self._known.popitem(last=False)
        return made
