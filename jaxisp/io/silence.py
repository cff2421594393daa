"""Keeping back what C libraries write to standard error beside the one line that says what is wrong."""

import contextlib
import os
import threading
from collections.abc import Iterator

from jaxisp.process import signals

_LOCK = threading.Lock()
_STDERR = 2
_users = 0
_kept: int | None = None


@contextlib.contextmanager
def silent_libraries() -> Iterator[None]:
    """Within it nothing reaches file descriptor 2; whoever leaves last, of several threads, opens it again.

    Python's own `sys.stderr` writes there too: nothing is printed within it.
    """
    _enter()
    try:
        yield
    finally:
        _leave()


def _enter() -> None:
    global _users, _kept
    with _LOCK:
        _users += 1
        if _users > 1:
            return
        with contextlib.suppress(OSError):  # closed: then nothing is written either
            kept = os.dup(_STDERR)
            with open(os.devnull, "wb") as nothing:
                os.dup2(nothing.fileno(), _STDERR)
            _kept = kept


def _leave() -> None:
    global _users, _kept
    with _LOCK:
        _users -= 1
        if _users or _kept is None:
            return
        if signals.came() is None:  # one has closed it for good
            os.dup2(_kept, _STDERR)
        os.close(_kept)
        _kept = None
