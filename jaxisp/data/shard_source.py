"""Shards read again: samples by position, for grain or for anything that indexes."""

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError, one_line, short
from jaxisp.io.digests import is_file_of, read_sealed
from jaxisp.io.files import parse_json, read_json
from jaxisp.recipe import Recipe

MANIFEST = "manifest.json"
SCHEMA = 2
"""Of the manifest; since 2 it and the shards' notes hold their own digests."""
MOST_SHARDS = 100_000


def shard_name(shard: int, count: int) -> str:
    """The name of a shard without its suffix."""
    return f"shard-{shard:05d}-of-{count:05d}"


def read_note(out: Path, name: str) -> dict[str, Any] | None:
    """What stands beside a shard that was written whole; None where it is missing or damaged."""
    try:
        note = _read(out / f"{name}.json")
    except InputError:
        return None
    indices = note.get("indices")
    sound = isinstance(note.get("bytes"), int) and isinstance(note.get("sha256"), str)
    numbers = isinstance(indices, list) and all(type(i) is int and 0 <= i < 1 << 31 for i in indices)
    return note if sound and numbers else None


def told_of(plan: Mapping[str, Any], shard: int) -> dict[str, Any]:
    """What of a manifest a shard's note repeats, so that it is taken for no other shard's or set's."""
    keys = ("recipe_sha256", "seed", "start", "count", "samples", "shards")
    return {"shard": shard} | {key: plan.get(key) for key in keys}


def stands(out: Path, name: str, told: Mapping[str, Any]) -> bool:
    """Whether a shard is, to the bit, what was written of that."""
    note = read_note(out, name)
    return (
        note is not None
        and note.get("of") == told
        and is_file_of(out / f"{name}.array_record", note["sha256"])
    )


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """manifest.json of a folder of shards. Raises InputError where it is missing or damaged."""
    path = Path(folder) / MANIFEST
    if not os.path.lexists(path):
        raise InputError(
            f"{folder}: holds no {MANIFEST}, expected a folder that jaxisp degrade --shards wrote"
        )
    manifest = read_json(path)
    if manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: has schema {short(manifest.get('schema'))}, expected {SCHEMA}")
    manifest = _read(path)
    if type(manifest.get("shards")) is not int or not 1 <= manifest["shards"] <= MOST_SHARDS:
        raise InputError(f"{path}: has {short(manifest.get('shards'))} shards, expected 1 to {MOST_SHARDS}")
    for key, kind in (("recipe", str), ("recipe_sha256", str), ("seed", int)):
        if not isinstance(manifest.get(key), kind):
            raise InputError(f"{path}: says no {key}")
    inputs = manifest.get("inputs", [])
    if not isinstance(inputs, list) or not all(map(_is_input, inputs)):
        raise InputError(f"{path}: its inputs are no names with digests")
    return manifest


def _is_input(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(isinstance(v, str) for v in value)


def _read(path: Path) -> dict[str, Any]:
    table = parse_json(read_sealed(path), str(path))
    del table["digest"]
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
        told = {}
        for s, name in enumerate(names):
            note, own = read_note(self.folder, name), told_of(self.manifest, s)
            if note and note.get("of", own) == own:  # notes of earlier versions do not say it
                told[name] = note
        missing = [
            s
            for s, name in enumerate(names)
            if name not in told or _size(self.folder, name) != told[name]["bytes"]
        ]
        if missing:
            some = ",".join(map(str, missing[:8])) + (",..." if len(missing) > 8 else "")
            raise InputError(
                f"{folder}: {len(missing)} of {count} shards are missing; write them with --shard {some}"
            )
        notes = [told[name] for name in names]
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
        try:
            if self._records is None:
                self._records = _array_record_source(self.paths)
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
        return [path for path, digest in zip(self.paths, self._files) if not is_file_of(path, digest)]


def array_record() -> Any:
    """The module that writes and reads the files; InputError where it is not installed."""
    try:
        from array_record.python import array_record_module
    except ImportError as error:
        raise InputError("shards need array_record: pip install 'jaxisp[data]'") from error
    return array_record_module


def _size(folder: Path, name: str) -> int:
    try:
        return (folder / f"{name}.array_record").stat().st_size
    except OSError:
        return -1


def _array_record_source(paths: list[Path]) -> Any:
    array_record()
    from array_record.python.array_record_data_source import ArrayRecordDataSource

    return ArrayRecordDataSource([str(path) for path in paths])
