"""SHA-256 of what is resumed: a text may hold its own digest, and those of the files that it tells of."""

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from jaxisp.errors import InputError
from jaxisp.io.files import (
    MOST_NOTES,
    PathLike,
    check_output,
    files_below,
    open_input,
    parse_json,
    read_text,
    reason,
    write_text,
    writing,
)
from jaxisp.io.locks import LOCK, locked

UNSEALED = "0" * 64
"""Stands in a text for its own digest, which is that of the text with this in it."""
_OWN = re.compile(r'(?<=\A\{"digest": ")[0-9a-f]{64}(?=", )|(?<=\n# digest = ")[0-9a-f]{64}(?="\n\Z)')
_HEXADECIMAL = re.compile("[0-9a-f]{64}")


def digest_of(path: PathLike) -> str:
    """SHA-256 of a file in hexadecimal digits; InputError where it cannot be read."""
    with open_input(path) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {reason(error)}") from error


def is_file_of(path: PathLike, digest: str) -> bool:
    """Whether a file can be read and has this digest."""
    try:
        return digest_of(path) == digest
    except InputError:
        return False


def sealed_toml(text: str) -> str:
    """A TOML text with a last line, a comment, that holds its digest."""
    return _sealed(f'{text.rstrip()}\n\n# digest = "{UNSEALED}"\n')


def sealed_json(text: str) -> str:
    """A JSON table with a first entry, "digest", that holds its digest."""
    return _sealed(f'{{"digest": "{UNSEALED}", {text.strip().removeprefix("{")}\n')


def _sealed(text: str) -> str:
    return _OWN.sub(hashlib.sha256(text.encode()).hexdigest(), text, count=1)


def is_sealed(text: str) -> bool:
    """Whether a text holds its own digest: not one bit of it has changed since it was written."""
    return _OWN.search(text) is not None and text == _sealed(_OWN.sub(UNSEALED, text, count=1))


def check_seal(path: PathLike) -> None:
    """Raise InputError where a text holds a digest in its last line that is not its own.

    One without may have been written by hand, or by a version before digests.
    """
    text = read_text(path)
    last = text.rstrip().rpartition("\n")[2]
    if (last.startswith("# digest") or _HEXADECIMAL.search(last)) and not is_sealed(text):
        raise InputError(
            f"{path}: is not what was written, by the digest in its last line; it is damaged, or "
            "was changed. Delete that line to use it as it is"
        )


def read_sealed(path: PathLike) -> str:
    """A text that holds its own digest.

    Raises:
        InputError: it cannot be read, or does not hold it: it is damaged, was changed, or is another's.
    """
    text = read_text(path, MOST_NOTES)
    if not is_sealed(text):
        raise InputError(f"{path}: does not hold its own digest; it is damaged, or was changed")
    return text


def note_files(folder: Path, name: str) -> None:
    """Write the digests of all files below a folder into a file of this name in it."""
    files = {str(path.relative_to(folder)): digest_of(path) for path in _files(folder, name)}
    write_text(folder / name, sealed_json(json.dumps({"files": files})))


def noted_files(folder: Path, name: str) -> dict[str, str]:
    """The digests that `note_files` wrote, by relative path. InputError where they are missing or damaged."""
    files = parse_json(read_sealed(folder / name), str(folder / name)).get("files")
    if not isinstance(files, dict) or not all(isinstance(digest, str) for digest in files.values()):
        raise InputError(f"{folder / name}: holds no digests of files")
    return files


def changed_files(folder: Path, name: str) -> list[Path]:
    """The files below a folder that are not those that `note_files` saw, and those that are missing."""
    noted, there = noted_files(folder, name), _files(folder, name)
    changed = [p for p in there if not is_file_of(p, noted.get(str(p.relative_to(folder)), ""))]
    return changed + sorted({folder / lost for lost in noted} - set(there))


def _files(folder: Path, name: str) -> list[Path]:
    return [path for path in files_below(folder) if path not in (folder / name, folder / LOCK)]


@contextlib.contextmanager
def own_folder(place: PathLike, name: str) -> Iterator[Path]:
    """A folder for one call alone, which notes in a file of this name what it wrote there.

    What an earlier call noted is removed first.

    Raises:
        InputError: other files, or files that were changed since, are in it; another process writes there.
    """
    folder = Path(place)
    with locked(folder):
        there, listed = _files(folder, name), os.path.lexists(folder / name)
        if there or listed:
            try:
                others = changed_files(folder, name) if there else []
                if listed:
                    check_output(folder / name)
                    noted_files(folder, name)
            except InputError:
                others = there or [folder / name]
            if others:
                raise InputError(
                    f"{folder}: holds {others[0].relative_to(folder)}, which is none of the files written "
                    "here before; choose a new or empty folder"
                )
        with writing(folder):
            for path in there:
                path.unlink()
            below = {base for path in there for base in path.parents if folder in base.parents}
            for base in sorted(below, reverse=True):
                with contextlib.suppress(OSError):  # it has something in it
                    os.rmdir(base)
        try:
            yield folder
        finally:
            note_files(folder, name)
