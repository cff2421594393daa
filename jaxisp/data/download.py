"""Downloads that go on where they stopped: pooch's checks, and a downloader that asks for the rest."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

from jaxisp.errors import InputError, one_line
from jaxisp.io.files import kind_of, read_text, write_text

_CHUNK = 1 << 16  # what has come of one is lost where the connection breaks
_TIMEOUT = (10, 60)  # to connect, between bytes [s]
_ITSELF = os.O_NOFOLLOW | os.O_NONBLOCK  # no link, and no waiting for who reads a FIFO
Tick = Callable[[int, int, str], Any]


def download(url: str, path: Path, digest: str | None, tick: Tick) -> Path:
    """The file at `path`, downloaded unless it is there and has the digest.

    Raises:
        ConnectionError: no answer, or the connection broke; what has come is kept for the next call.
        ValueError: the file does not have the digest; it is removed.
        InputError: there is no room for it; or it, or what has come of it, is a link, no plain file, or has
            another name elsewhere: none of these is read or written.
    """
    pooch, resuming = _pooch(), _Resuming(path, tick)
    for own in (path, resuming.part, resuming.mark):
        check_own(own)
    if path.exists() and digest is None:
        return path
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("ERROR")
    try:
        return Path(pooch.retrieve(url, digest, path.name, path.parent, downloader=resuming))
    finally:
        logger.setLevel(level)


def digest_of(path: Path, kind: str) -> str:
    """The checksum of a file."""
    return str(_pooch().file_hash(str(path), alg=kind))


def check_own(path: Path) -> None:
    """Raise InputError where something stands that cannot be what was written here: a link, no plain file, or
    one that is another file too, by a second name."""
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return
    if kind := kind_of(status.st_mode) or ("a hard link of another file" if status.st_nlink > 1 else ""):
        raise InputError(f"{path}: is {kind}, where a file of our own has to be; move it away")


class _Resuming:
    """A downloader for pooch: keeps what has come in NAME.part, and what the server calls it beside that."""

    def __init__(self, path: Path, tick: Tick) -> None:
        self.part, self.name, self.tick = path.with_name(f".{path.name}.part"), path.name, tick
        self.mark = path.with_name(f".{path.name}.etag")

    def __call__(self, url: str, output_file: str, _: Any) -> None:
        import requests

        try:
            if not self._get(requests, url):  # the server's file is another one now: from its start
                self._forget()
                self._get(requests, url)
        except requests.HTTPError as error:
            raise ConnectionError(one_line(error, 160)) from error
        except requests.RequestException as error:  # its text is of urllib3's objects
            raise ConnectionError(f"no connection to {urlsplit(url).hostname}, or it broke") from error
        shutil.move(self.part, output_file)
        self._forget()

    def _get(self, requests: Any, url: str) -> bool:
        done = self.part.stat().st_size if self.part.exists() else 0
        headers = {"Accept-Encoding": "identity"}
        if done:
            headers["Range"] = f"bytes={done}-"
            if mark := self._mark():
                headers["If-Range"] = mark
        with requests.get(url, headers=headers, stream=True, timeout=_TIMEOUT) as answer:
            if answer.status_code == 416:
                return False
            answer.raise_for_status()
            done = done if answer.status_code == 206 else 0
            total = done + int(answer.headers.get("Content-Length", 0))
            self._check_room(total - done)
            write_text(
                self.mark, json.dumps(answer.headers.get("ETag") or answer.headers.get("Last-Modified"))
            )
            with self._opened(done) as file:
                for chunk in answer.iter_content(_CHUNK):
                    file.write(chunk)
                    done += len(chunk)
                    self.tick(done, total, self.name)
                file.flush()
                os.fsync(file.fileno())
        if total and done != total:
            raise ConnectionError(f"{done} of {total} bytes came")
        return True

    def _opened(self, done: int) -> IO[bytes]:
        """The file that is gone on with, or a new one: what another program put there meanwhile is left."""
        if not done:
            self.part.unlink(missing_ok=True)
            return self.part.open("xb")
        check_own(self.part)
        return open(self.part, "ab", opener=lambda path, flags: os.open(path, flags | _ITSELF))

    def _mark(self) -> str | None:
        try:
            mark = json.loads(read_text(self.mark))
        except (ValueError, RecursionError):
            return None
        # a weak tag does not promise the same bytes, and may not be asked for
        return mark if isinstance(mark, str) and not mark.startswith("W/") else None

    def _check_room(self, size: int) -> None:
        free = shutil.disk_usage(self.part.parent).free
        if size > free:
            raise InputError(
                f"{self.part.parent}: {self.name} needs {size >> 20} MiB and {free >> 20} MiB are free"
            )

    def _forget(self) -> None:
        self.part.unlink(missing_ok=True)
        self.mark.unlink(missing_ok=True)


def _pooch() -> Any:
    try:
        import pooch
    except ImportError as error:
        raise InputError("downloads need pooch: pip install 'jaxisp[data]'") from error
    return pooch
