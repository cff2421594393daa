"""Ctrl-C, SIGTERM and a lost terminal end the process within two seconds: one line, status 130, 143 or 129.

The main thread unwinds, so that nothing half-made is left. Compilers and solvers do not return to Python
for longer than that: a thread then ends the process. All outputs are whole or not there at any moment.

Extensions that are being imported do not unwind: what is raised in their beginning can end in SIGSEGV or
SIGABRT. The main thread is asked again until it is out of all imports.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from _thread import interrupt_main
from collections.abc import Iterator
from types import FrameType

LINE = "jaxisp: interrupted; files already written are complete"
_CURSOR = b"\r\x1b[?25h"
"""Shows the cursor, which a progress bar has hidden."""
GRACE = 1.2
"""Seconds that the main thread has."""


class Stopped(KeyboardInterrupt):
    """A signal asked the process to end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _Watch:
    """What the process knows of signals; there is one process, so there is one of these."""

    came: int | None = None
    deferred = False
    """Whether it came within an import, and is to come again."""
    grace = GRACE
    status: int | None = None
    on = False
    told = threading.Lock()
    errors = 2
    """Standard error, where a signal has not silenced it."""


_watch = _Watch()


_ENDING = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)  # Windows
]


def is_lost_terminal(number: int) -> bool:
    """Whether it is the signal of one: the system sends it, and the shell once more."""
    return signal.Signals(number).name == "SIGHUP"


def ending() -> list[signal.Signals]:
    """The signals that end a process; that of a lost terminal not where it is ignored, as under nohup."""
    return [n for n in _ENDING if not is_lost_terminal(n) or signal.getsignal(n) is not signal.SIG_IGN]


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Signals that come within are delivered after it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ending())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def watch() -> None:
    """Take what `ending` names from now on. For processes of our own, once, from the main thread."""
    if _watch.on or threading.current_thread() is not threading.main_thread():
        return
    _watch.on = True
    read, write = os.pipe()
    os.set_blocking(write, False)
    # the system's handler writes the number at once, whatever the main thread does
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    _watch.errors = os.dup(2)
    threading.Thread(target=_end, args=(read,), daemon=True, name="jaxisp-signals").start()
    for number in ending():  # the last: one may come at once, and is told
        signal.signal(number, _raise)


def allow(seconds: float = GRACE, status: int | None = None) -> None:
    """Give what is being done this long once a signal came, and end with this status instead of 128 + N."""
    _watch.grace, _watch.status = seconds, status


def came() -> int | None:
    """The signal that asked the process to end, if one did."""
    return _watch.came


def status_of(number: int) -> int:
    return 128 + number if _watch.status is None else _watch.status


def tell() -> None:
    """Print the one line, unless it was printed."""
    if not _watch.on:
        print(LINE, file=sys.stderr)
    elif _watch.told.acquire(blocking=False):
        with contextlib.suppress(OSError):  # the terminal may be gone
            os.write(_watch.errors, _CURSOR * os.isatty(_watch.errors) + LINE.encode() + b"\n")


def close() -> None:
    """Take no more signals: all is done. While Python ends they would kill it, as nobody takes them then."""
    if _watch.on:
        for number in ending():
            signal.signal(number, signal.SIG_IGN)


def leave(status: int) -> None:
    """End the process at once: what others registered for its end may wait for threads that compute."""
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def _raise(number: int, frame: FrameType | None) -> None:
    _watch.came = _watch.came or number
    if _imports(frame):
        _watch.deferred = True
        return
    if is_lost_terminal(number):
        signal.signal(number, signal.SIG_IGN)
    # what is raised within an import, a destructor or another thread is printed there, by C too
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    raise Stopped(number)


def _imports(frame: FrameType | None) -> bool:
    """Whether a module is being imported where this frame is."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _again(number: int) -> None:
    """Send it to the main thread, which may wait within the system."""
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)
    else:  # Windows
        interrupt_main(signal.Signals(number))


def _end(pipe: int) -> None:
    """Wait for a signal, then for the main thread, and end the process."""
    number = 0
    while number not in _ENDING:
        number = os.read(pipe, 1)[0]
    _watch.came = _watch.came or number
    until = time.monotonic() + _watch.grace
    while time.monotonic() < until:
        time.sleep(0.02)
        if _watch.deferred:
            _watch.deferred = False
            _again(number)
    tell()
    os._exit(status_of(number))
