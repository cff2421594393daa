"""One writer to a folder: locks that the system frees when a process dies."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from jaxisp.errors import InputError
from jaxisp.io.files import PathLike, output_folder, writing


@contextlib.contextmanager
def locked(
    folder: PathLike,
    *,
    name: str = ".lock",
    shared: bool = False,
    wait: bool = False,
    doing: str = "writing",
) -> Iterator[None]:
    """Make a folder and keep others out of it; the system frees the lock when the process dies.

    Args:
        folder: made where it is missing.
        name: of the lock file in it.
        shared: with others that share it, not with one that wants it alone.
        wait: until the other process is done, for what takes no time.
        doing: what the other process is doing, for the error.

    Raises:
        InputError: another process holds it, or the folder cannot be written.
    """
    path = output_folder(folder) / name
    kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    with _lock_file(path, kind, doing):
        try:
            yield
        finally:
            if not shared:  # another that shares it may still hold this very file
                with contextlib.suppress(OSError):
                    path.unlink()


def _lock_file(path: Path, kind: int, doing: str) -> IO[bytes]:
    """A file that is locked and still has its name: its holder before may have removed it meanwhile."""
    while True:
        with writing(path):
            file = path.open("wb")
        try:
            fcntl.flock(file, kind)
        except BlockingIOError as error:
            file.close()
            raise InputError(f"{path.parent}: another process is {doing} into this folder") from error
        except OSError:  # a file system without locks: each file is still whole
            return file
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        file.close()
