"""`python -m jaxisp`, and the command `jaxisp`."""

import gc
import os
import sys

from jaxisp.process import signals


def _open_streams() -> None:
    """Where standard streams were closed, what is opened next has their numbers, and gets what is printed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


def main() -> int:
    """Run the command line as a process of its own."""
    try:
        with signals.held():
            _open_streams()
            signals.watch()  # before all that takes time to import
        gc.set_threshold(100_000, 20, 50)  # tracing makes millions of small objects that stay: a fifth of it
        from jaxisp.process.environment import one_blas_thread

        one_blas_thread()
        from jaxisp.cli import main as command

        status = command()
        signals.close()
    except BaseException:
        if signals.came() is None:
            signals.close()
            raise
        status = 1
    number = signals.came()
    if number is not None and status:
        signals.tell()  # whatever the signal became on its way through libraries, a damaged file too
        signals.leave(signals.status_of(number))
    return status


if __name__ == "__main__":
    raise SystemExit(main())
