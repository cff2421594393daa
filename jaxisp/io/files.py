"""Files on disk: checks before reading, whole-or-nothing writing, finding images, reading TOML."""

import contextlib
import fcntl
import os
import secrets
import tempfile
import tomllib
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxisp.errors import InputError, one_line

MOST_PIXELS = 1 << 28
"""Of a picture; phones make 200 million."""
FREE_PIXELS = 1 << 24
"""Pictures up to this many pixels are read however small their files are."""
MOST_TOML = 16 << 20
"""Bytes: a larger TOML file is not read."""
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


def check_file(path: PathLike) -> Path:
    """Return the path; raise InputError where it is no readable file with something in it."""
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected a file")
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(f"{path}: is empty (0 bytes)")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    return path


def read_bytes(path: PathLike) -> bytes:
    """The whole file; InputError where it cannot be read or is empty."""
    path = check_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error


def read_toml(path: PathLike) -> dict[str, Any]:
    """A TOML file as a dict; InputError with the file and the line where it is not valid."""
    path = Path(path)
    try:
        if path.stat().st_size > MOST_TOML:
            raise InputError(f"{path}: is larger than {MOST_TOML >> 20} MiB, which no TOML file of ours is")
        return parse_toml(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text") from error


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


def short(value: Any) -> str:
    """A value from a file as it may stand in one line of an error."""
    try:
        text = repr(value)
    except RecursionError:
        text = "tables nested too deeply"
    return text if len(text) < 120 else text[:120] + "..."


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
            return np.array(np.load(path, mmap_mode="r", allow_pickle=False))
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
    """A binary file that takes its name only once it is whole.

    The bytes go to a temporary file in the same folder, which is flushed to the disk and then
    renamed. On any error it is removed, and what stood under the name before still stands. What a
    killed process left of it is used again.

    Raises:
        InputError: the folder does not exist, cannot be written, or is full.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        temporary, file = _temporary(path)
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            os.replace(temporary, path)
    except OSError as error:
        _remove(temporary)
        ours = str(path.with_name(f".{path.name}."))
        if error.filename is not None and not str(error.filename).startswith(ours):
            raise  # the caller's own trouble with another file
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error
    except BaseException:
        _remove(temporary)
        raise


def write_text(path: PathLike, text: str) -> None:
    """A whole file of UTF-8 text; see `atomic_write`."""
    with atomic_write(path) as file:
        file.write(text.encode())


def _temporary(path: Path) -> tuple[Path, IO[bytes]]:
    """`.NAME.tmp`, empty and locked; where it is another's, or cannot be locked, a name of its own."""
    usual = path.with_name(f".{path.name}.tmp")
    with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
        file = stack.enter_context(open(usual, "r+b", opener=_make_or_open))
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(file.fileno()), usual.stat()):  # not renamed by its writer meanwhile
            file.truncate(0)
            stack.pop_all()
            return usual, file
    own = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    return own, own.open("xb")


def _make_or_open(path: str, flags: int) -> int:
    """Without emptying it, and no link that somebody put there."""
    return os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW, 0o666)


def _remove(path: Path | None) -> None:
    if path is not None:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def output_folder(path: PathLike) -> Path:
    """Make a folder (and those above it); InputError where nothing can be written into it."""
    path = Path(path)
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):  # has no name that could be left behind
            pass
    return path


@contextlib.contextmanager
def filled_folder(path: PathLike) -> Iterator[Path]:
    """`output_folder` for what is written at the end; an error before leaves none that is new and empty."""
    path = Path(path)
    new = [folder for folder in (path, *path.parents) if not os.path.exists(folder)]
    try:
        yield output_folder(path)
    except BaseException:
        for folder in new:
            with contextlib.suppress(OSError):  # it has something in it
                folder.rmdir()
        raise


def output_file(path: PathLike) -> Path:
    """Make the folder of a file that is to be written; InputError where it cannot be."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file")
    output_folder(path.parent)
    return path


def list_folder(folder: PathLike, *, recursive: bool = False) -> list[Path]:
    """The visible files of a folder, sorted; InputError where it cannot be listed."""
    folder = Path(folder)
    try:
        if not folder.is_dir():
            what = "is a file" if folder.exists() else "no such folder"
            raise InputError(f"{folder}: {what}, expected a folder")
        found = sorted(folder.rglob("*") if recursive else folder.iterdir())
        return [p for p in found if not _hidden(p.relative_to(folder)) and p.is_file()]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {reason(error)}") from error


def find_images(paths: PathLike | Iterable[PathLike], *, recursive: bool = False) -> list[Path]:
    """The image files among `paths`; folders stand for what is in them.

    Args:
        paths: files and folders. In folders other kinds of file are passed over.
        recursive: look into folders of folders too.

    Returns:
        Each file once: in the order given, the files of a folder sorted.

    Raises:
        InputError: a path does not exist, is not an image, or is a folder without images.
    """
    given = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    if not given:
        raise InputError("no input files given, expected images or folders of images")
    found: dict[Path, None] = {}
    for path in map(Path, given):
        if path.is_dir():
            images = [p for p in list_folder(path, recursive=recursive) if is_image(p)]
            if not images:
                raise InputError(f"{path}: holds no images ({', '.join(IMAGE_SUFFIXES)})")
            found.update(dict.fromkeys(images))
        elif not is_image(path) and path.exists():
            raise InputError(f"{path}: is not an image jaxisp reads ({', '.join(IMAGE_SUFFIXES)})")
        else:
            found[check_file(path)] = None
    return list(found)


def is_image(path: PathLike) -> bool:
    """Whether the name is one of a picture (a `.raw.npy` is a mosaic)."""
    name = Path(path).name.lower()
    return name.endswith(IMAGE_SUFFIXES) and not name.endswith(".raw.npy")


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
