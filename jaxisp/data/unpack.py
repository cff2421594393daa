"""Archives of strangers, file by file: nothing but plain files, inside one folder, of a bounded size."""

import bz2
import contextlib
import gzip
import io
import lzma
import os
import stat
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO, Any, Self

from jaxisp.errors import InputError, one_line, short
from jaxisp.io.files import MOST_NAME, open_input

MOST_FILES = 100_000
"""Of an archive, with its folders."""
_MOST_PATH = 1000  # bytes of a name with its folders
_MOST_HEADER = 4 << 10  # bytes of what stands before a file of a tar, for its long name and the like
_MOST_SHARED = 100  # entries of a header that is for all files of a tar
_MOST_LIST = 64 << 20  # bytes of a zip's list of files
_RATIO, _FREE = 4, 16 << 20  # pictures hardly compress
_CHUNK, _BLOCK = 1 << 20, 1 << 16

Member = tuple[str, IO[bytes] | None]
"""A name and what to read, which folders do not have."""


def unpack(path: Path, kind: str, folder: Path) -> None:
    """Unpack an archive into an empty folder; folders of it without files are left out.

    Args:
        path: of the archive.
        kind: "zip", or "tar", which may be compressed by gzip, bzip2 or xz.
        folder: is made; where something is wrong with the archive, part of it may be there.

    Raises:
        InputError: it is damaged or cut, or names a file outside the folder, twice, or with a name that is
            none; it holds links or devices, more than `MOST_FILES` files and folders, or, with its headers,
            more than four times its own size and 16 MiB.
        OSError: the files cannot be written.
    """
    folder.mkdir()
    left = most = _RATIO * path.stat().st_size + _FREE
    count = 0
    folders: set[tuple[str, ...]] = {()}
    try:
        for name, source in _zipped(path) if kind == "zip" else _tarred(path, most):
            new = _new_folders(name, path, folders) if source else []
            count += 1 + len(new)  # a name may have hundreds of folders
            if count > MOST_FILES:
                raise InputError(f"{path}: holds more than {MOST_FILES} files and folders")
            if source is None:
                continue
            folders.update(new)
            with source, _made(folder, _parts(name, path)) as file:
                while chunk := source.read(_CHUNK):
                    left -= len(chunk)
                    if left < 0:
                        raise _too_large(path)
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


def _too_large(path: Path) -> InputError:
    return InputError(f"{path}: unpacks to more than {_RATIO} times its size")


def _new_folders(name: str, path: Path, known: set[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The folders of a file's name that are not known."""
    base, new = _parts(name, path)[:-1], []
    while base not in known:
        new.append(base)
        base = base[:-1]
    return new


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
    with _Listed(open_input(path).detach()) as source, zipfile.ZipFile(source) as archive:
        for info in archive.infolist():
            mode = info.external_attr >> 16
            if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise InputError(f"{path}: holds {short(info.filename)}, a link or a device")
            if "\0" in info.orig_filename:  # `filename` ends there
                raise InputError(f"{path}: names {short(info.orig_filename)}, which has a NUL")
            if info.is_dir():
                _parts(info.filename, path)
            yield info.filename, None if info.is_dir() else archive.open(info)


class _Listed(io.BufferedReader):
    """A zip whose list of files, which zipfile reads at once and makes objects of, is bounded.

    Nothing else is read in parts that are large enough for so many files.
    """

    def read(self, size: int | None = -1, /) -> bytes:
        if size and size > _MOST_LIST:
            raise zipfile.BadZipFile(f"its list of files takes {size >> 20} MiB")
        data = super().read(size)
        if data.count(b"PK\1\2") > MOST_FILES:
            raise zipfile.BadZipFile(f"its list has more than {MOST_FILES} files and folders")
        return data


def _tarred(path: Path, most: int) -> Iterator[Member]:
    with contextlib.ExitStack() as stack:
        stream = _Counted(_decompressed(path, stack), most, path)
        # as a stream: what is read is what is counted, and nothing is read twice
        archive = stack.enter_context(
            tarfile.open(fileobj=stream, mode="r|", bufsize=_BLOCK, tarinfo=_Header)  # type: ignore[call-overload]
        )
        while (info := archive.next()) is not None:
            archive.members.clear()  # it would keep all
            if len(archive.pax_headers) > _MOST_SHARED:  # each file gets a copy
                raise InputError(f"{path}: has more than {_MOST_SHARED} entries in a header for all files")
            if info.isdir():
                if os.path.normpath(info.name) != ".":
                    _parts(info.name, path)
                yield info.name, None
                continue
            source = archive.extractfile(info) if info.isfile() else None
            if source is None:
                raise InputError(f"{path}: holds {short(info.name)}, a link or a device")
            yield info.name, source
        while stream.read(_CHUNK):  # to the end, where its checksum is
            pass


def _decompressed(path: Path, stack: contextlib.ExitStack) -> IO[bytes]:
    source = stack.enter_context(open_input(path))
    begins = source.peek(6)
    kinds: dict[bytes, Any] = {
        b"\x1f\x8b": gzip.GzipFile, b"BZh": bz2.BZ2File, b"\xfd7zXZ\0": lzma.LZMAFile,
        b"\x5d\0\0": lzma.LZMAFile,  # what came before xz
    }  # fmt: skip
    for magic, kind in kinds.items():
        if begins.startswith(magic):
            arguments = {"fileobj": source} if kind is gzip.GzipFile else {"filename": source}
            return stack.enter_context(kind(**arguments))
    return source


class _Counted:
    """The bytes of a tar, no more than so many."""

    def __init__(self, source: IO[bytes], most: int, path: Path) -> None:
        self.source, self.left, self.path = source, most, path

    def read(self, size: int) -> bytes:
        data = self.source.read(size)
        self.left -= len(data)
        if self.left < 0:
            raise _too_large(self.path)
        return data


class _Header(tarfile.TarInfo):
    """A header of a tar; tarfile itself takes damaged ones, and none at all, for the archive's end."""

    @classmethod
    def fromtarfile(cls, archive: tarfile.TarFile) -> Self:
        try:
            return super().fromtarfile(archive)
        except tarfile.EOFHeaderError:  # type: ignore[attr-defined]  # the zeros at the end
            raise
        except tarfile.HeaderError as error:
            raise tarfile.ReadError(str(error)) from error

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        info = super().frombuf(buf, encoding, errors)
        if info.type in _MORE and info.size > _MOST_HEADER:  # tarfile would read it whole
            raise tarfile.ReadError(f"a header of {info.size} bytes")
        return info


_MORE = (
    tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE,
    tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK,
)  # fmt: skip
"""Kinds of headers that belong to the next one."""
