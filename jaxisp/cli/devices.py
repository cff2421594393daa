"""Options and set-up of the commands that use many devices or processes."""

import argparse
import contextlib
import os
import re
import sys
from typing import Any

from jaxisp.cli.common import positive
from jaxisp.errors import InputError
from jaxisp.process import cores

_MOST = 8


def add_devices(command: Any, parts: str) -> None:
    """`parts`: what is done with the parts of a CPU."""
    command.add_argument("--cpu-devices", type=positive, metavar="N", help=f"on a CPU, {parts}")
    command.add_argument(
        "--coordinator", metavar="HOST:PORT",
        help="address where several processes meet; auto: taken from Slurm, MPI or Kubernetes",
    )  # fmt: skip
    command.add_argument(
        "--processes", type=positive, metavar="N", help="number of processes, with --coordinator HOST:PORT"
    )
    command.add_argument("--process-id", type=int, metavar="I", help="rank of this process, from 0")


def use_cores(count: int | None = None) -> None:
    """Let JAX see the CPU as several devices, a core each (at most 8) unless a count is given: its
    convolutions use one core each. Before it computes."""
    if "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    with contextlib.suppress(RuntimeError):  # it computes already, in a program that calls this one
        jax.config.update("jax_num_cpu_devices", count or min(_MOST, cores.available()))


def join(arguments: argparse.Namespace) -> None:
    """Join the other processes, where there are any.

    Raises:
        InputError: they cannot be joined, or it is not said where.
    """
    if not arguments.coordinator:
        if arguments.processes or arguments.process_id is not None:
            raise InputError("--processes and --process-id need --coordinator HOST:PORT")
        return
    if arguments.coordinator != "auto" and not re.fullmatch(r".+:\d+", arguments.coordinator):
        raise InputError(f"--coordinator {arguments.coordinator}: expected HOST:PORT or auto")
    import jax

    sys.stdout.flush()
    sys.stdout = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what Gloo says of itself is no output of the command
    try:
        if arguments.coordinator == "auto":
            jax.distributed.initialize()
        else:
            jax.distributed.initialize(arguments.coordinator, arguments.processes, arguments.process_id)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"--coordinator {arguments.coordinator}: {error}") from None
