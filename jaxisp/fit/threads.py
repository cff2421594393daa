"""What runs side by side: XLA's CPU code runs the small steps of one program one after another."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_MOST = 8
_POOL = ThreadPoolExecutor(min(len(os.sched_getaffinity(0)), _MOST), "jaxisp-fit")


def together(function: Callable[..., T], *arguments: Iterable[Any]) -> list[T]:
    """`map` on as many threads as there are cores, in the order of the arguments."""
    return list(_POOL.map(function, *arguments))


def ahead(function: Callable[[], T]) -> "Future[T]":
    """Begin a call that is wanted later."""
    return _POOL.submit(function)
