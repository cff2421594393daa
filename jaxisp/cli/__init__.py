"""The command line: parse, call, print. JAX is imported by the commands that compute, not for --help."""

import argparse
import sys
from collections.abc import Sequence

from jaxisp import __version__
from jaxisp.cli import data, degrade, demo, denoise, develop, diagnose, evaluate, fit, listings, recipe, train
from jaxisp.cli.common import Parser
from jaxisp.errors import InputError
from jaxisp.process.cache import keep_compiled

_MODULES = (demo, develop, fit, recipe, degrade, train, denoise, evaluate, diagnose, data, listings)


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
    """Run a command. Returns 0 (done), 2 (the call or its input is unusable) or 1 (it broke)."""
    arguments = parser().parse_args(argv)
    try:
        if argv is None:  # the process is ours; another program that calls this has its own settings
            keep_compiled()
        return int(arguments.run(arguments))
    except InputError as error:
        print(f"jaxisp: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("jaxisp: interrupted; files already written are complete", file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 1
