"""What the commands share: common options and printing."""

import argparse
import difflib
import io
import json
import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from jaxisp.errors import InputError, printable


class Parser(argparse.ArgumentParser):
    """Mistakes in a call are told in one line, with what may have been meant."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, printable(f"{self.prog}: {message}; see {self.prog} --help") + "\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuses what it does not know here, where the options of the command are known."""
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = [name for action in self._actions for name in action.option_strings]
            close = difflib.get_close_matches(unknown[0].split("=")[0], options, 1)
            self.error(f"unknown: {unknown[0]}" + (f" (is it {close[0]}?)" if close else ""))
        return known, unknown


def add_command(
    commands: Any, name: str, run: Any, help: str, *, draws: bool = False
) -> argparse.ArgumentParser:
    """A subcommand with the options that all have; what draws nothing takes a seed, and does not show it."""
    command: argparse.ArgumentParser = commands.add_parser(name, help=help, description=help)
    told = "random seed (default 0)" if draws else argparse.SUPPRESS
    command.add_argument("--seed", type=seed, default=0, help=told)
    command.add_argument("--json", action="store_true", help="print JSON and nothing else")
    command.set_defaults(run=run)
    return command


def positive(text: str) -> int:
    """argparse type: a positive integer."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value


def names(text: str) -> list[str]:
    """argparse type: names by commas, with or without blanks."""
    return [name for name in map(str.strip, text.split(",")) if name]


def seed(text: str) -> int:
    """argparse type: an integer that makes a key of its own."""
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to {2**32 - 1}")
    return value


def say(text: Any = "") -> None:
    """A line on standard output; all that is printed for people goes through this, `warn` or a table."""
    with _printing():
        print(printable(str(text)))


@contextmanager
def _printing() -> Iterator[None]:
    """Told in one line where standard output is on a full disk; who reads it may have gone without a word."""
    try:
        yield
    except OSError as error:
        from jaxisp.io.files import reason  # loads JAX

        with open(os.devnull, "wb") as nothing:  # what is still buffered would fail again at the end
            os.dup2(nothing.fileno(), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError(f"standard output: cannot be written: {reason(error)}") from error


def flush() -> None:
    """Print what is still buffered."""
    with _printing():
        sys.stdout.flush()


def warn(text: str) -> None:
    """A line on standard error."""
    print(f"jaxisp: {' '.join(printable(text).split())}", file=sys.stderr)


def print_json(value: Any) -> None:
    with _printing():
        print(json.dumps(value, allow_nan=False))


def print_table(headers: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """A table on standard output: as wide as a terminal, and whole elsewhere."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text  # in which brackets are brackets

    table = Table(*headers, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*(Text(printable(str(cell))) for cell in row))
    text = io.StringIO()
    Console(file=text, width=terminal_width() or _WIDEST).print(table)
    for line in text.getvalue().splitlines():
        say(line.rstrip())


def report_failures(failed: Iterable[tuple[str, str]]) -> int:
    """List inputs that could not be used on standard error, a line each; the exit status."""
    reasons = [reason for _, reason in failed]
    for reason in reasons:
        warn(reason)
    return 2 if reasons else 0


_WIDEST = 10_000
"""Columns of a table that is not for a terminal."""


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; None where it is none, so that lines stay whole."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


QUIET = 10.0
"""Seconds that a command is silent off a terminal: a quick one, or one whose input is refused, stays so."""


@contextmanager
def progress(label: str) -> Iterator[Any]:
    """`tick(done, total, text)` on standard error: a bar on a terminal, elsewhere a line for each phase."""
    with _bar(label) if sys.stderr.isatty() else _lines(label) as tick:
        yield tick


@contextmanager
def _bar(label: str) -> Iterator[Any]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    described = TextColumn("{task.description}", markup=False)
    columns = (described, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=None)

        def tick(done: int, total: int, text: str = "") -> None:
            bar.update(task, completed=done, total=total, description=printable(f"{label} {text}".strip()))

        yield tick


@contextmanager
def _lines(label: str) -> Iterator[Any]:
    begun, lock = time.monotonic(), threading.Lock()
    now, told = "", ""

    def tell() -> None:
        nonlocal told
        with lock:
            phase = re.sub(r"[-\d.]+", "", now)  # counts and objectives within it are no phase of their own
            if phase and phase != told:
                told = phase
                warn(f"{label}: {now}")

    def tick(done: int, total: int, text: str = "") -> None:
        nonlocal now
        now = text
        if time.monotonic() - begun >= QUIET:
            tell()

    timer = threading.Timer(QUIET, tell)  # a long phase may have begun before
    timer.daemon = True
    timer.start()
    try:
        yield tick
    finally:
        timer.cancel()
