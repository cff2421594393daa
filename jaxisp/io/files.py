"""Files on disk: checks before reading, whole-or-nothing writing, finding images, reading TOML."""

import contextlib
import errno
import io
import json
import os
import secrets
import stat
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxisp.checks import several
from jaxisp.errors import InputError, one_line

MOST_PIXELS = 1 << 28
"""Of a picture; phones make 200 million."""
FREE_PIXELS = 1 << 24
"""Pictures up to this many pixels are read however small their files are."""
MOST_TEXT = 16 << 20
"""Bytes: a larger text of anybody's is not read."""
MOST_NOTES = 1 << 30
"""Bytes: the same of what we note of our own work, as of all inputs."""
MOST_NAME = 255
"""Bytes of a file's name, on most file systems."""
MOST_NESTED = 100
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")

PathLike = str | os.PathLike[str]


def reason(error: OSError) -> str:
    """What the system says about an error, in lower case and without the path."""
    return (error.strerror or str(error) or type(error).__name__).lower()


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """InputError that names the path for what the system says."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error


def sound_path(path: PathLike) -> Path:
    """The path; InputError where it cannot be one, or where no text that names it could be written."""
    path = Path(path)
    try:
        text = str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: {_unnamable(path)}") from error
    if b"\0" in text:
        raise InputError(f"{path}: has a NUL in its name, which no file can have")
    return path


def _unnamable(path: Path) -> str:
    """Why a path is no text."""
    try:
        os.fsencode(path).decode()
    except UnicodeError:
        return "its name is not UTF-8; rename it"
    return f"its name is not {sys.getfilesystemencoding()}, which this locale has; set LC_ALL=C.UTF-8"


def kind_of(mode: int) -> str:
    """What a file is by its mode, as it may stand in an error; "" for a plain one."""
    kinds = {
        stat.S_IFDIR: "a folder", stat.S_IFLNK: "a link", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
    }  # fmt: skip
    return "" if stat.S_ISREG(mode) else kinds.get(stat.S_IFMT(mode), "no plain file")


def leads_nowhere(path: PathLike) -> bool:
    """Whether a path is a link, at the end of which nothing is."""
    return os.path.islink(path) and not os.path.exists(path)


def open_input(path: PathLike) -> io.BufferedReader:
    """Open a plain file to be read: what all inputs are opened by.

    Nothing else is opened at all: a FIFO waits for its writer, a device may have no end, or do something.

    Raises:
        InputError: it cannot be read, or is no plain file.
    """
    path = sound_path(path)
    with _reading(path):
        _check_plain(path, os.stat(path).st_mode)
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb")
        try:
            _check_plain(path, os.fstat(file.fileno()).st_mode)  # another may stand there by now
        except BaseException:
            file.close()
            raise
        return file


def _check_plain(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        os.scandir(path).close()  # says why it was not listed
    if kind := kind_of(mode):
        raise InputError(f"{path}: is {kind}, expected a file")


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error


def file_state(path: PathLike) -> tuple[int, ...]:
    """What changes with a file: its size [bytes] and its time [ns]; InputError where it is gone."""
    path = sound_path(path)
    with _reading(path):
        status = os.stat(path)
    return status.st_size, status.st_mtime_ns


@contextlib.contextmanager
def steady(path: Path) -> Iterator[None]:
    """For what reads a file in several parts: InputError where it goes or changes meanwhile."""
    before = file_state(path)
    with _reading(path):
        yield
    if file_state(path) != before:
        raise InputError(f"{path}: changed while it was read")


def check_file(path: PathLike) -> Path:
    """Return the path; raise InputError where it is no readable plain file with something in it."""
    path = Path(path)
    with open_input(path) as file, _reading(path):
        if not file.read(1):
            raise InputError(f"{path}: is empty (0 bytes)")
    return path


def read_bytes(path: PathLike) -> bytes:
    """The whole file; InputError where it cannot be read or is empty."""
    path = check_file(path)
    with open_input(path) as file, _reading(path):
        return file.read()


def read_toml(path: PathLike) -> dict[str, Any]:
    """A TOML file as a dict; InputError with the file and the line where it is not valid."""
    return parse_toml(read_text(path), str(path))


def read_json(path: PathLike) -> dict[str, Any]:
    """A table in JSON as a dict; InputError where it is none."""
    return parse_json(read_text(path, MOST_NOTES), str(path))


def read_text(path: PathLike, most: int = MOST_TEXT) -> str:
    """A file of UTF-8 text of at most so many bytes; it may be empty."""
    path = Path(path)
    with open_input(path) as file, _reading(path):
        fits = os.fstat(file.fileno()).st_size <= most
        data = file.read() if fits else b""  # read(most) would ask for all of that memory
    if not fits:
        raise InputError(f"{path}: is larger than {most >> 20} MiB, which no text of ours is")
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text") from error


def parse_json(text: str, name: str) -> dict[str, Any]:
    """JSON from anybody as a dict; InputError that begins with `name` where it is not valid, or no table."""
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: is damaged ({one_line(error)})") from None
    if not isinstance(table, dict):
        raise InputError(f"{name}: is damaged (expected a table)")
    return table


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """TOML from anybody as a dict; InputError that begins with `name` where it is not valid or too deep."""
    try:
        table = tomllib.loads(text)
        _check_depth(table, name)
        return table
    except InputError:
        raise
    except RecursionError:  # not chained: its trace is as deep
        raise InputError(f"{name}: is not valid TOML: nested too deeply") from None
    except ValueError as error:  # tomllib's own, and dates and numbers that Python does not have
        message = str(error).replace("at end of document", f"at line {len(text.splitlines())}, the last")
        raise InputError(f"{name}: is not valid TOML: {' '.join(message.split())}") from error


def _check_depth(table: Any, name: str) -> None:
    """Dotted keys nest without end and without recursion; what walks the tables afterwards recurses."""
    level = [table]
    for _ in range(MOST_NESTED):
        inner = [v.values() if isinstance(v, dict) else v for v in level if isinstance(v, dict | list)]
        level = [value for values in inner for value in values]
        if not level:
            return
    raise InputError(f"{name}: is not valid TOML: nested more than {MOST_NESTED} deep")


def load_npy(path: PathLike) -> np.ndarray:
    """The array of a `.npy` file that is no larger than the file says; never unpickles."""
    path = check_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's note on headers of Python 2
            np.load(path, mmap_mode="r", allow_pickle=False)  # the file has the bytes that its header says
            # read, not copied from the map: a file that is cut meanwhile would end the process
            found = np.load(path, allow_pickle=False)
            if not isinstance(found, np.ndarray):  # an archive of several
                raise ValueError("holds no single array")
            return found
    except Exception as error:  # its header is parsed as Python, which fails in many ways
        raise InputError(f"{path}: is a damaged or truncated NumPy file ({one_line(error)})") from error


def check_pixels(width: int, height: int, size: int, name: str, *, bytes_each: int = 3) -> None:
    """Refuse a picture that a file of `size` bytes cannot hold, before memory is taken for it.

    Raises:
        InputError: no pixels, more than any camera makes, or, above 16 megapixels, more than 400 bytes
            of pixels for each of the file's: photographs stay below 150, decompression bombs are near 1000.
    """
    pixels = width * height
    if min(width, height) < 1 or max(width, height) > 65535 or pixels > MOST_PIXELS:
        raise InputError(
            f"{name}: says it is {width} x {height} pixels, which no camera makes; it is damaged"
        )
    if pixels > FREE_PIXELS and pixels * bytes_each > 400 * size:
        raise InputError(
            f"{name}: says it is {width} x {height} pixels, which a photograph of {size} bytes is not; "
            "it is damaged, or made to fill the memory"
        )


@contextlib.contextmanager
def atomic_write(path: PathLike) -> Iterator[IO[bytes]]:
    """A binary file that takes its name only once it is whole: what all outputs are written by.

    The bytes go to a file without a name, which is flushed to the disk and then named. On any error, and
    where the process is killed, nothing is left of it, and what stood under the name before still stands.
    File systems that know no such files (NFS) get a temporary name, which a killed process leaves.

    Raises:
        InputError: the folder does not exist, cannot be written, or is full; or a link, a folder or a device
            stands there, which are not replaced.
    """
    path, temporary = sound_path(path), None
    try:
        with writing(path):
            _check_replaceable(path)
            file, temporary = _unnamed(path.parent)
        with file:
            yield file
            file.flush()
            with writing(path):
                os.fsync(file.fileno())
                _check_replaceable(path)
                _give_name(file, temporary, path)
    except OSError as error:
        _remove(temporary)
        if error.filename is not None:
            raise  # the caller's own trouble with another file
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error
    except BaseException:
        _remove(temporary)
        raise


def write_text(path: PathLike, text: str) -> None:
    """A whole file of UTF-8 text, with what is none in names as `\\udcff`; see `atomic_write`."""
    with atomic_write(path) as file:
        file.write(text.encode(errors="backslashreplace"))


def write_new(path: PathLike, text: str) -> None:
    """`write_text` for what is written beside the outputs that a call names: it replaces nothing.

    Raises:
        InputError: another text stands there.
    """
    check_new(path, text)
    write_text(path, text)


def check_new(path: PathLike, text: str) -> None:
    """Raise InputError where `write_new` would."""
    if os.path.lexists(path) and read_text(path) != text:
        raise InputError(f"{path}: stands there already and would be replaced; choose another folder")


def _check_replaceable(path: Path) -> None:
    """Raise where something else than a plain file stands."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind := kind_of(mode):
        raise InputError(f"{path}: cannot be written: is {kind}, which is not replaced")


def _unnamed(folder: Path) -> tuple[IO[bytes], Path | None]:
    """An empty file in a folder, and its name where it has to have one."""
    with contextlib.suppress(OSError, AttributeError):
        descriptor = os.open(folder, os.O_TMPFILE | os.O_RDWR, 0o666)
        if os.path.exists(_numbered(descriptor)):
            return open(folder, "r+b", opener=lambda *_: descriptor), None  # libraries ask for a name
        os.close(descriptor)
    named = _own_name(folder)
    return named.open("x+b"), named


def _give_name(file: IO[bytes], temporary: Path | None, path: Path) -> None:
    """Rename a file, or link one that has no name; a link replaces nothing by itself."""
    if temporary is None:
        try:
            _link(file, path)
            return
        except FileExistsError:
            temporary = _own_name(path.parent)
            _link(file, temporary)
    try:
        os.replace(temporary, path)
    except BaseException:
        _remove(temporary)
        raise


def _link(file: IO[bytes], path: Path) -> None:
    # with a descriptor, which an absolute path does not need, Python asks the system to follow the link
    os.link(_numbered(file.fileno()), path, src_dir_fd=file.fileno(), follow_symlinks=True)


def _numbered(descriptor: int) -> str:
    return f"/proc/self/fd/{descriptor}"


def _own_name(folder: Path) -> Path:
    return folder / f".{secrets.token_hex(8)}.tmp"


def _remove(path: Path | None) -> None:
    if path is not None:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def output_folder(path: PathLike) -> Path:
    """Make a folder (and those above it); InputError where nothing can be written into it."""
    path = sound_path(path)
    if leads_nowhere(path):
        raise InputError(f"{path}: cannot be written: is a link that leads nowhere")
    if os.path.exists(path) and (kind := kind_of(os.stat(path).st_mode) or "a file") != "a folder":
        raise InputError(f"{path}: cannot be written: is {kind}, expected a folder")
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):  # has no name that could be left behind
            pass
    return path


@contextlib.contextmanager
def filled_folder(path: PathLike, *, keep: bool = True) -> Iterator[Path]:
    """`output_folder` for what is written at the end; an error before leaves none that is new and empty.

    Without `keep` none is left where nothing was written either, for whom it is no error.
    """
    path = Path(path)
    new = [folder for folder in (path, *path.parents) if not os.path.exists(folder)]
    try:
        yield output_folder(path)
    except BaseException:
        _remove_empty(new)
        raise
    if not keep:
        _remove_empty(new)


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):  # it has something in it
            folder.rmdir()


def output_file(path: PathLike, inputs: Iterable[PathLike] = ()) -> Path:
    """Make the folder of a file that is to be written.

    Raises:
        InputError: it cannot be written, it is one of the inputs, or something stands there that is not
            replaced.
    """
    path = check_output(path, real_paths(inputs))
    output_folder(path.parent)
    return path


def check_output(path: PathLike, inputs: Container[str] = ()) -> Path:
    """A file that may be written; InputError where it is an input, by `real_paths`, or no file."""
    path = sound_path(path)
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder, expected the name of a file")
    with writing(path):
        _check_replaceable(path)
    if os.path.realpath(path) in inputs:
        raise InputError(f"{path}: is an input, and would be overwritten by a result")
    return path


def real_paths(paths: Iterable[PathLike]) -> frozenset[str]:
    """Paths without links, for `check_output`."""
    return frozenset(os.path.realpath(path) for path in paths if "\0" not in str(path))


@contextlib.contextmanager
def filled_file(path: PathLike, inputs: Iterable[PathLike] = ()) -> Iterator[Path]:
    """`output_file` for what is written at the end; see `filled_folder`."""
    with filled_folder(Path(path).parent):
        yield output_file(path, inputs)


def list_folder(folder: PathLike) -> list[Path]:
    """The visible files of a folder, plain or not, sorted; InputError where it cannot be listed."""
    folder = sound_path(folder)
    if not os.path.isdir(folder):
        what = "is a file" if os.path.lexists(folder) else "no such folder"
        what = "is a link that leads nowhere" if leads_nowhere(folder) else what
        raise InputError(f"{folder}: {what}, expected a folder")
    files, closed = _walk(folder, recursive=False)
    for error in closed:
        raise InputError(f"{folder}: cannot be read: {reason(error)}") from error
    return files


def files_below(path: Path) -> list[Path]:
    """All files of a folder and those below it, hidden ones and links to folders too, sorted; or the file
    itself."""
    if not os.path.isdir(path):
        return [path] if os.path.lexists(path) else []
    found = []
    for base, folders, names in os.walk(path):
        links = [name for name in folders if os.path.islink(Path(base, name))]
        found += [Path(base, name) for name in (*names, *links)]
    return sorted(found)


def _walk(folder: Path, *, recursive: bool) -> tuple[list[Path], list[OSError]]:
    """The visible files of a folder, sorted, and what kept folders from being listed."""
    files: list[Path] = []
    closed: list[OSError] = []
    for base, folders, names in os.walk(folder, onerror=closed.append):
        folders[:] = [name for name in folders if recursive and not name.startswith(".")]
        files += [Path(base, name) for name in names if not name.startswith(".")]
    return sorted(files), closed


def find_images(paths: PathLike | Iterable[PathLike], *, recursive: bool = False) -> list[Path]:
    """The image files among `paths`; folders stand for what is in them.

    Args:
        paths: files and folders. In folders other kinds of file are passed over.
        recursive: look into folders of folders too.

    Returns:
        Each file once: in the order given, the files of a folder sorted. What cannot be read is among them,
        so that it is told where it is read, and the rest goes on; so are folders that cannot be listed.

    Raises:
        InputError: a folder holds no images, none of the files can be used, or what is given are no paths.
    """
    given = several(paths)
    if wrong := [one for one in given if not isinstance(one, str | os.PathLike)]:
        raise InputError(
            f"expected images or folders of images by their paths, got {type(wrong[0]).__name__}"
        )
    if not given:
        raise InputError("no input files given, expected images or folders of images")
    found: dict[Path, None] = {}
    for path in map(Path, given):
        if os.path.isdir(path):
            files, closed = _walk(path, recursive=recursive)
            images = [p for p in files if is_image(p)] + [Path(error.filename) for error in closed]
            if not images:
                raise InputError(f"{path}: holds no images ({', '.join(IMAGE_SUFFIXES)})")
            found.update(dict.fromkeys(images))
        else:
            found[path] = None
    _check_some(list(found))
    return list(found)


def _check_some(paths: list[Path]) -> None:
    """Raise the first one's InputError where none can be used."""
    first: InputError | None = None
    for path in paths:
        try:
            check_file(path)
            if not is_image(path):
                raise InputError(f"{path}: is not an image jaxisp reads ({', '.join(IMAGE_SUFFIXES)})")
            return
        except InputError as error:
            first = first or error
    if first:
        raise first


def is_image(path: PathLike) -> bool:
    """Whether the name is one of a picture (a `.raw.npy` is a mosaic)."""
    name = Path(path).name.lower()
    return name.endswith(IMAGE_SUFFIXES) and not name.endswith(".raw.npy")
