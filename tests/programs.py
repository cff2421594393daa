"""Where the tests keep compiled programs: one worker, command or run compiles, the others load."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from jaxisp.process.cache import cache_folder

_MOST = 4e9  # bytes


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
