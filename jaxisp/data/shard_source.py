"""Shards read again: samples by position, for grain or for anything that indexes."""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError, one_line
from jaxisp.io.files import reason
from jaxisp.recipe import Recipe

MANIFEST = "manifest.json"
SCHEMA = 1
"""Of the manifest."""


def shard_name(shard: int, count: int) -> str:
    """The name of a shard without its suffix."""
    return f"shard-{shard:05d}-of-{count:05d}"


def stands(out: Path, name: str) -> bool:
    """Whether a shard was written whole."""
    note, path = out / f"{name}.json", out / f"{name}.array_record"
    if not (note.is_file() and path.is_file()):
        return False
    told = _read_json(note)
    return told.keys() >= {"bytes", "sha256", "indices"} and path.stat().st_size == told["bytes"]


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """manifest.json of a folder of shards. Raises InputError where it is missing or damaged."""
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise InputError(
            f"{folder}: holds no {MANIFEST}, expected a folder that jaxisp degrade --shards wrote"
        )
    manifest = _read_json(path)
    if manifest.get("schema") != SCHEMA or not isinstance(manifest.get("shards"), int):
        raise InputError(f"{path}: has schema {manifest.get('schema')!r}, expected {SCHEMA}")
    return manifest


def _read_json(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is damaged ({one_line(error)})") from None
    if not isinstance(table, dict):
        raise InputError(f"{path}: is damaged (expected a table)")
    return table


class ShardSource:
    """The samples of a folder of shards by position: a `grain.sources.RandomAccessDataSource`.

    Position 0 is the smallest sample index. It can be pickled, so that grain's workers can read it.

    Args:
        folder: as `degrade_shards` wrote it, all shards of it.

    Raises:
        InputError: no such folder, or shards are missing or damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder, self.manifest = Path(folder), read_manifest(folder)
        count = self.manifest["shards"]
        names = [shard_name(s, count) for s in range(count)]
        missing = [s for s, name in enumerate(names) if not stands(self.folder, name)]
        if missing:
            some = ",".join(map(str, missing[:8])) + (",..." if len(missing) > 8 else "")
            raise InputError(
                f"{folder}: {len(missing)} of {count} shards are missing; write them with --shard {some}"
            )
        notes = [_read_json(self.folder / f"{name}.json") for name in names]
        # a shard may have no samples, where there are more shards than these
        self.paths = [
            self.folder / f"{name}.array_record" for name, note in zip(names, notes) if note["indices"]
        ]
        indices = np.concatenate([np.asarray(note["indices"], np.int64) for note in notes])
        self._files = [note["sha256"] for note in notes if note["indices"]]
        self._order = np.argsort(indices)
        self.indices = indices[self._order]
        self._records: Any = None

    def __len__(self) -> int:
        return len(self._order)

    def __repr__(self) -> str:
        """Grain identifies a source by this when it resumes."""
        m = self.manifest
        return f"ShardSource({m['recipe']}, {m['recipe_sha256'][:16]}, seed={m['seed']}, samples={len(self)})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_records": None}

    def __getitem__(self, position: Any) -> dict[str, np.ndarray]:
        """{"noisy", "clean"}: (H, W, 3) float32 encoded sRGB each, in steps of 1/255."""
        arrays = self.arrays(position)
        return {k: arrays[k].astype(np.float32) / np.float32(255) for k in ("noisy", "clean")}

    def arrays(self, position: Any) -> dict[str, np.ndarray]:
        """All of a record as it is stored."""
        if not 0 <= position < len(self):
            raise IndexError(position)
        place = int(self._order[position])
        if self._records is None:
            self._records = _array_record_source(self.paths)
        try:
            record = self._records[place]
            with np.load(io.BytesIO(record), allow_pickle=False) as arrays:
                return dict(arrays)
        except (RuntimeError, ValueError, OSError, zipfile.BadZipFile, KeyError, IndexError) as error:
            raise InputError(f"{self.folder}: record {place} is damaged ({one_line(error)})") from error

    def parameters(self, position: Any) -> Recipe:
        """A recipe of the drawn parameters, as beside the images of `degrade_files`."""
        return Recipe.from_toml(self.arrays(position)["parameters"].tobytes().decode())

    def verify(self) -> list[Path]:
        """The shards whose bytes are not those that were written."""
        bad = []
        for path, digest in zip(self.paths, self._files):
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != digest:
                    bad.append(path)
        return bad


def array_record() -> Any:
    """The module that writes and reads the files; InputError where it is not installed."""
    try:
        from array_record.python import array_record_module
    except ImportError as error:
        raise InputError("shards need array_record: pip install 'jaxisp[data]'") from error
    return array_record_module


def _array_record_source(paths: list[Path]) -> Any:
    array_record()
    from array_record.python.array_record_data_source import ArrayRecordDataSource

    return ArrayRecordDataSource([str(path) for path in paths])
