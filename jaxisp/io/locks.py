"""One writer to a folder: locks that the system frees when a process dies."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from jaxisp.errors import InputError
from jaxisp.io.files import PathLike, kind_of, output_folder, writing

LOCK = ".lock"
_OURS = b"jaxisp works here, or was killed here. To be deleted when none does.\n"


@contextlib.contextmanager
def locked(
    folder: PathLike,
    *,
    name: str = LOCK,
    shared: bool = False,
    wait: bool = False,
    doing: str = "writing",
) -> Iterator[None]:
    """Make a folder and keep others out of it; the system frees the lock when the process dies.

    The lock file is deleted afterwards where it says that it is ours; an empty one is used and stays.

    Args:
        folder: made where it is missing.
        name: of the lock file in it.
        shared: with others that share it, not with one that wants it alone.
        wait: until the other process is done, for what takes no time.
        doing: what the other process is doing, for the error.

    Raises:
        InputError: another process holds it, the folder cannot be written, or something else than a lock
            has its name; or, at the end, folder or lock were removed meanwhile.
    """
    path = output_folder(folder) / name
    kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    lock = _lock(path, kind, doing)
    try:
        yield
        if not _has_its_name(path, lock):
            raise InputError(
                f"{path}: was removed, or its folder was, while this was {doing} there: files may be missing"
            )
    finally:
        with contextlib.suppress(OSError):
            if shared:  # another may still hold this very file
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _has_its_name(path, lock) and _content(lock) == _OURS:
                path.unlink()
        os.close(lock)


def _lock(path: Path, kind: int, doing: str) -> int:
    """A file that is locked and still has its name: its holder before may have removed it meanwhile."""
    while True:
        with writing(path):
            lock = _opened(path)
        if lock is None:
            continue
        try:
            _check_ours(path, lock)
            fcntl.flock(lock, kind)
        except BlockingIOError as error:
            os.close(lock)
            raise InputError(f"{path.parent}: another process is {doing} into this folder") from error
        except OSError:  # a file system without locks: each file is still whole
            return lock
        except BaseException:
            os.close(lock)
            raise
        if _has_its_name(path, lock):
            return lock
        os.close(lock)


def _has_its_name(path: Path, lock: int) -> bool:
    """Whether the lock file still stands there, and not that of another process."""
    try:
        return os.path.samestat(os.fstat(lock), os.lstat(path))
    except OSError:
        return False


def _opened(path: Path) -> int | None:
    """The lock file, made where it is missing; None where it was removed meanwhile.

    What is no plain file is not opened, and no link is followed.
    """
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
    with contextlib.suppress(FileExistsError):
        made = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
        os.write(made, _OURS)
        return made
    try:
        if kind := kind_of(os.lstat(path).st_mode):
            raise InputError(f"{path}: is {kind}, where a lock has to be; move it away")
        return os.open(path, flags)
    except FileNotFoundError:
        return None


def _check_ours(path: Path, lock: int) -> None:
    status = os.fstat(lock)
    if kind_of(status.st_mode) or status.st_nlink > 1 or _content(lock) not in (b"", _OURS):
        raise InputError(f"{path}: is a file of another program, where a lock has to be; move it away")


def _content(lock: int) -> bytes:
    return os.pread(lock, len(_OURS) + 1, 0)
