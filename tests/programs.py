"""Where the tests keep compiled programs: one worker, command or run compiles, the others load."""

import atexit
import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

from jaxisp.process.cache import cache_folder

_MOST = 4e9  # bytes
_SHARE = 50  # programs


def kept_programs() -> Path:
    """A folder of the user's cache, emptied where it has grown large; a temporary one with JAXISP_CACHE=off.

    JAX names a program by its text, its flags and the versions, the folder is named by the processor: what is
    found there is what would be compiled.
    """
    users = cache_folder()
    if users is None:
        folder = Path(tempfile.mkdtemp(prefix="jaxisp-tests-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    folder = users.with_name(f"tests-{users.name}")
    if folder.is_dir() and sum(entry.stat().st_size for entry in os.scandir(folder)) > _MOST:
        shutil.rmtree(folder, ignore_errors=True)  # most of it is of code that has changed since
    return folder


def share_contexts() -> None:
    """Lower a thread's programs into one MLIR context, and into a fresh one after every 50.

    JAX makes one for each program: a quarter of the time that a program of one operation takes, and half of
    the memory. The text of a program does not change. A context keeps what it has seen, hence the fresh ones.
    """
    from jax._src.interpreters import mlir

    make, local = mlir.make_ir_context, threading.local()

    def shared() -> Any:
        left, context = getattr(local, "kept", (0, None))
        if not left:
            left, context = _SHARE, make()
        local.kept = left - 1, context
        return context

    mlir.make_ir_context = shared
