"""What runs side by side: XLA's CPU code runs the small steps of one program one after another."""

import functools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_MOST = 8


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """One for the process, begun when it is first wanted."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ThreadPoolExecutor(min(cores, _MOST), "jaxisp-fit")


def together(function: Callable[..., T], *arguments: Iterable[Any]) -> list[T]:
    """`map` on as many threads as there are cores, in the order of the arguments."""
    return list(_pool().map(function, *arguments))


def ahead(function: Callable[[], T]) -> "Future[T]":
    """Begin a call that is wanted later."""
    return _pool().submit(function)
