"""Files on disk: checks before reading, whole-or-nothing writing, finding images, reading TOML."""

import contextlib
import os
import secrets
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxisp.errors import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")

PathLike = str | os.PathLike[str]


def reason(error: OSError) -> str:
    """What the system says about an error, in lower case and without the path."""
    return (error.strerror or str(error) or type(error).__name__).lower()


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
    text = ""
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        message = str(error).replace("at end of document", f"at line {len(text.splitlines())}, the last")
        raise InputError(f"{path}: is not valid TOML: {message}") from error


def load_npy(path: PathLike) -> np.ndarray:
    """The array of a `.npy` file that is no larger than the file says; never unpickles."""
    path = check_file(path)
    try:
        return np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    except (OSError, ValueError, EOFError, SyntaxError, MemoryError, OverflowError, TypeError) as error:
        raise InputError(f"{path}: is a damaged or truncated NumPy file ({_one_line(error)})") from error


@contextlib.contextmanager
def atomic_write(path: PathLike) -> Iterator[IO[bytes]]:
    """A binary file that takes its name only once it is whole.

    The bytes go to a temporary file in the same folder, which is flushed to the disk and then
    renamed. On any error it is removed, and what stood under the name before still stands.

    Raises:
        InputError: the folder does not exist, cannot be written, or is full.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if error.filename not in (None, str(temporary)):  # the caller's own trouble with another file
            raise
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def output_folder(path: PathLike) -> Path:
    """Make a folder (and those above it); InputError where nothing can be written into it."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".{secrets.token_hex(4)}.tmp"
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error
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


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
