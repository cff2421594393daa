"""The command line: parse, call, print. JAX is imported by the commands that compute, not for --help."""

import argparse
import io
import os
import signal
import sys
from collections.abc import Sequence

from jaxisp import __version__
from jaxisp.cli import (
    adapt,
    calibrate,
    compare,
    data,
    degrade,
    demo,
    denoise,
    develop,
    diagnose,
    evaluate,
    fit,
    listings,
    recipe,
    train,
)
from jaxisp.cli.common import Parser, flush, warn
from jaxisp.errors import InputError, one_line
from jaxisp.process import signals
from jaxisp.process.cache import keep_compiled
from jaxisp.process.environment import check_environment, without_device

_MODULES = (
    demo, develop, fit, calibrate, recipe, degrade, train, adapt, denoise, evaluate, diagnose, compare, data,
    listings,
)  # fmt: skip
_NO_MEMORY = "RESOURCE_EXHAUSTED"  # as JAX tells it


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    top = Parser(
        prog="jaxisp", description="Simulate a camera's pipeline in JAX, and fit it to a real camera."
    )
    top.add_argument("--version", action="version", version=f"jaxisp {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for module in _MODULES:
        module.add_commands(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns:
        0 (done), 2 (the call or its input is unusable), 1 (it broke), 130 (Ctrl-C), 143 (SIGTERM), 129
        (SIGHUP).
    """
    if argv is None:  # the process is ours; another program that calls this has its own settings
        signals.watch()
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
    signals.allow()
    arguments = parser().parse_args(argv)
    try:
        if argv is None:
            check_environment()
            keep_compiled()
        status = int(arguments.run(arguments))
        flush()
        return status
    except InputError as error:
        warn(str(error))
        return 2
    except KeyboardInterrupt as stop:
        signals.tell()
        return signals.status_of(getattr(stop, "number", signal.SIGINT))
    except BrokenPipeError:
        return 1
    except OSError as error:
        if error.filename is None or signals.came():
            raise
        warn(f"{os.fsdecode(error.filename)}: cannot be used: {(error.strerror or str(error)).lower()}")
        return 2
    except Exception as error:
        if signals.came():
            raise
        if isinstance(error, MemoryError) or str(error).startswith(_NO_MEMORY):
            why = one_line(error).removeprefix(_NO_MEMORY).strip(": ")
            warn(f"not enough memory: {why or 'Python has none left'}")
            return 1
        if not (why := without_device()):
            raise
        warn(why)
        return 2
