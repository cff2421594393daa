"""Environment variables of JAX and XLA: told in one line where they do not let a command compute."""

import os
import subprocess
import sys

from jaxisp.errors import InputError, one_line

_BLAS = "OPENBLAS_NUM_THREADS"
_LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"
_FLAGS = "XLA_FLAGS"
_READ_FLAGS = "from jaxlib import xla_client; print('here', flush=True); xla_client.CompileOptions()"
_LONGEST = 60
"""Seconds: a check that takes longer has found nothing."""


def one_blas_thread() -> None:
    """Let NumPy's and SciPy's OpenBLAS compute on one thread, unless the variable says otherwise.

    Its threads wait by spinning: for small products that takes up to fifty times as long on a busy machine,
    and results depend on the number of threads. Called before NumPy is imported, or for processes that are
    spawned.
    """
    os.environ.setdefault(_BLAS, "1")


def no_false_errors() -> None:
    """Keep XLA's log to what ends the process, unless the variable says otherwise.

    Of each kept program that it loads it reports features of the processor as errors, which they are not.
    Called before JAX is imported: it reads the variable then.
    """
    os.environ.setdefault(_LOG_LEVEL, "3")


def check_environment() -> None:
    """Import JAX. Called once, before a command computes.

    Raises:
        InputError: JAX or XLA refuses what one of its environment variables says.
    """
    _check_flags()
    no_false_errors()
    try:
        import jax  # noqa: F401
    except ValueError as error:  # of its settings: it names the variable
        raise InputError(f"JAX refuses an environment variable: {one_line(error)}") from None


def _check_flags() -> None:
    """XLA ends the process where it reads flags that it does not know: another process reads them first."""
    if not os.environ.get(_FLAGS, "").strip():
        return
    try:
        # -P: a folder in which one works may hold modules of any name
        done = subprocess.run(
            [sys.executable, "-P", "-c", _READ_FLAGS], capture_output=True, text=True, timeout=_LONGEST
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    if done.returncode and done.stdout:
        # a line of XLA's log: "F1129 10:22:32.551611 383 parse_flags_from_env.cc:234] Unknown flag ..."
        said = " ".join(line.rpartition("] ")[2] for line in done.stderr.splitlines()[:1])
        raise InputError(f"XLA refuses {_FLAGS}={os.environ[_FLAGS].strip()}: {said[:200]}")


def without_device() -> str:
    """Why JAX has no device to compute on; "" where it has one, or has not been imported."""
    if "jax" not in sys.modules:
        return ""
    import jax

    try:
        jax.devices()
    except Exception as error:  # a name that it does not know is an AssertionError in some versions
        chosen = os.environ.get("JAX_PLATFORMS", "")
        return f"JAX finds no device to compute on (JAX_PLATFORMS={chosen}): {one_line(error)}".rstrip(": ")
    return ""
