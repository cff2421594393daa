"""A fit that was stopped goes on where it was: what is done stands in a file beside the output."""

import base64
import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.fit.state import State
from jaxisp.io.digests import read_sealed, sealed_json
from jaxisp.io.files import parse_json, write_text
from jaxisp.io.locks import locked

VERSION = 4


@dataclasses.dataclass
class Journal:
    """The states of a fit's jobs by name. Without a path nothing is written.

    Args:
        path: the file; it is replaced whole at each entry.
        print: what the fit is of. A file with another one is of another fit, and is replaced.
        writes: whether this process writes it; of several that fit together one does, and none where a file
            stands there that is no journal, or a damaged one: it is left as it is.
    """

    path: Path | None = None
    print: str = ""
    writes: bool = True
    entries: dict[str, Any] = dataclasses.field(default_factory=dict)
    resumed: bool = False

    @classmethod
    def open(cls, path: str | Path | None, print: str, writes: bool = True) -> "Journal":
        """The journal at a path, with what it holds where it is of the same fit."""
        if path is None:
            return cls()
        try:
            stored = _read(Path(path))
        except InputError:
            return cls(Path(path), print, writes=False)
        if stored.get("print") != print:
            return cls(Path(path), print, writes)
        return cls(Path(path), print, writes, stored["jobs"], bool(stored["jobs"]))

    def get(self, job: str) -> tuple[State | None, bool]:
        """Where a job was left, and whether it had finished."""
        entry = self.entries.get(job)
        return (None, False) if entry is None else (_decode(entry["state"]), entry["finished"])

    def put(self, job: str, state: State, finished: bool) -> None:
        """Note where a job is."""
        self.entries[job] = {"state": _encode(state), "finished": finished}
        if self.path is not None and self.writes:
            write_text(self.path, sealed_json(json.dumps({"print": self.print, "jobs": self.entries})))


def _read(path: Path) -> dict[str, Any]:
    """What a journal holds, {} where there is none; InputError where it is damaged, or no journal."""
    if not os.path.lexists(path):
        return {}
    stored = parse_json(read_sealed(path), str(path))
    try:
        for entry in stored["jobs"].values():
            _decode(entry["state"]), bool(entry["finished"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{path}: is no journal of a fit") from error
    return stored


def in_the_way(path: Path) -> str:
    """Why a fit cannot note there where it is; "" where it can."""
    try:
        _read(path)
    except InputError as error:
        return f"{error}; it is left as it is, and this fit could not be resumed"
    return ""


@contextlib.contextmanager
def alone(path: str | Path | None) -> Iterator[None]:
    """Keep other processes from a journal, and so from the fit that it is of.

    Raises:
        InputError: another process has it, or its folder cannot be written.
    """
    if path is None:
        yield
        return
    path = Path(path)
    with locked(path.parent, name=f".{path.name}.lock", doing="fitting"):
        yield


def fingerprint(*parts: Any) -> str:
    """A digest of arrays and of whatever has a repr that says it all."""
    digest = hashlib.sha256(f"jaxisp fit {VERSION}".encode())
    for part in parts:
        data = np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        digest.update(data)
    return digest.hexdigest()


def beside(out: str | Path) -> Path:
    """Where the journal of a fit into `out` is."""
    return Path(os.fspath(out) + ".partial")


def _encode(state: State) -> dict[str, Any]:
    values = dataclasses.asdict(state)
    for name in ("camera", "images", "places"):
        array = np.asarray(values[name], np.float64)
        values[name] = [list(array.shape), base64.b64encode(array.tobytes()).decode()]
    return values


def _decode(values: dict[str, Any]) -> State:
    arrays = {
        name: np.frombuffer(base64.b64decode(values[name][1])).reshape(values[name][0])
        for name in ("camera", "images", "places")
    }
    images, places = tuple(arrays["images"]), tuple(arrays["places"])
    return State(**{**values, "camera": arrays["camera"], "images": images, "places": places})
