"""Archives of strangers, file by file: nothing but plain files, inside one folder, of a bounded size."""

import contextlib
import os
import stat
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from jaxisp.errors import InputError, one_line, short
from jaxisp.io.files import MOST_NAME

MOST_FILES = 100_000
_MOST_PATH = 1000  # bytes of a name with its folders
_RATIO, _FREE = 4, 16 << 20  # pictures hardly compress
_CHUNK = 1 << 20

Member = tuple[str, IO[bytes]]


def unpack(path: Path, kind: str, folder: Path) -> None:
    """Unpack an archive into an empty folder; folders of it without files are left out.

    Args:
        path: of the archive.
        kind: "zip" or "tar", compressed in any way that Python knows.
        folder: is made; where something is wrong with the archive, part of it may be there.

    Raises:
        InputError: it is damaged, or names a file outside the folder, twice, or with a name that is none; it
            holds links or devices, more than `MOST_FILES` files, or more than four times its own size.
        OSError: the files cannot be written.
    """
    folder.mkdir()
    left, count = _RATIO * path.stat().st_size + _FREE, 0
    try:
        for name, source in (_zipped if kind == "zip" else _tarred)(path):
            count += 1
            if count > MOST_FILES:
                raise InputError(f"{path}: holds more than {MOST_FILES} files")
            with source, _made(folder, _parts(name, path)) as file:
                while chunk := source.read(_CHUNK):
                    left -= len(chunk)
                    if left < 0:
                        raise InputError(f"{path}: unpacks to more than {_RATIO} times its size")
                    with _writing():
                        file.write(chunk)
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise InputError(f"{path}: holds one name twice, or as a file and a folder") from error
    except InputError:
        raise
    except _NotWritten as error:
        raise error.why from error
    except Exception as error:  # parsers on arbitrary bytes, which also seek to places that there are not
        raise InputError(f"{path}: is a damaged archive ({one_line(error)})") from error


class _NotWritten(Exception):
    """What the system says of a file that is written, told apart from what it says of the archive."""

    def __init__(self, why: OSError) -> None:
        super().__init__(str(why))
        self.why = why


@contextlib.contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except (FileExistsError, NotADirectoryError, IsADirectoryError):
        raise
    except OSError as error:
        raise _NotWritten(error) from error


@contextlib.contextmanager
def _made(folder: Path, parts: tuple[str, ...]) -> Iterator[IO[bytes]]:
    """A new file of a folder, with the folders that its name has."""
    target = folder.joinpath(*parts)
    with _writing():
        target.parent.mkdir(parents=True, exist_ok=True)
        file = open(target, "xb")  # noqa: SIM115 (closing it may fail too)
    try:
        yield file
    finally:
        with _writing():
            file.close()


def _parts(name: str, path: Path) -> tuple[str, ...]:
    """A name's folders and file; InputError where it leads elsewhere, or is none."""
    parts = PurePosixPath(name).parts
    try:
        size = max(map(len, map(str.encode, parts)), default=MOST_NAME + 1)
    except UnicodeEncodeError:
        size = MOST_NAME + 1
    if ".." in parts or name.startswith(("/", "\\")) or "\\" in name or ":" in name or not name.isprintable():
        raise InputError(f"{path}: names {short(name)}, which may lead out of its folder")
    if size > MOST_NAME or len(name.encode()) > _MOST_PATH:
        raise InputError(f"{path}: names {short(name)}, which is too long, or no name")
    return parts


def _zipped(path: Path) -> Iterator[Member]:
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            mode = info.external_attr >> 16
            if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise InputError(f"{path}: holds {short(info.filename)}, a link or a device")
            if "\0" in info.orig_filename:  # `filename` ends there
                raise InputError(f"{path}: names {short(info.orig_filename)}, which has a NUL")
            if info.is_dir():
                _parts(info.filename, path)
            else:
                yield info.filename, archive.open(info)


def _tarred(path: Path) -> Iterator[Member]:
    with tarfile.open(path) as archive:
        for info in archive:
            if info.isdir():
                if os.path.normpath(info.name) != ".":
                    _parts(info.name, path)
                continue
            source = archive.extractfile(info) if info.isfile() else None
            if source is None:
                raise InputError(f"{path}: holds {short(info.name)}, a link or a device")
            yield info.name, source
