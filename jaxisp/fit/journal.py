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

from jaxisp.fit.state import State
from jaxisp.io.files import write_text
from jaxisp.io.locks import locked

VERSION = 1


@dataclasses.dataclass
class Journal:
    """The states of a fit's jobs by name. Without a path nothing is written.

    Args:
        path: the file; it is replaced whole at each entry.
        print: what the fit is of. A file with another one is of another fit, and is not read.
        writes: whether this process writes it; of several that fit together one does.
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
        journal = cls(Path(path), print, writes)
        try:
            stored = json.loads(journal.path.read_text()) if journal.path else {}
        except (OSError, ValueError):
            return journal
        if isinstance(stored, dict) and stored.get("print") == print:
            journal.entries, journal.resumed = stored.get("jobs", {}), bool(stored.get("jobs"))
        return journal

    def get(self, job: str) -> tuple[State | None, bool]:
        """Where a job was left, and whether it had finished."""
        entry = self.entries.get(job)
        return (None, False) if entry is None else (_decode(entry["state"]), entry["finished"])

    def put(self, job: str, state: State, finished: bool) -> None:
        """Note where a job is."""
        self.entries[job] = {"state": _encode(state), "finished": finished}
        if self.path is not None and self.writes:
            write_text(self.path, json.dumps({"print": self.print, "jobs": self.entries}))


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
