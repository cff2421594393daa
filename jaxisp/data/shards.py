"""Shards: degraded samples in array-record files, a range of samples each, with a manifest.

A shard is a job: any machine can write any of them, in any order, and a job that was killed is run again.
What sample k is follows from the inputs, the recipe, the seed and k alone.
"""

import hashlib
import io
import json
import os
import re
import time
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp import __version__
from jaxisp.errors import InputError
from jaxisp.generate import Degraded, Outcome, Tick, Work
from jaxisp.io.files import atomic_write, locked, reason
from jaxisp.io.jpeg import to_bytes
from jaxisp.recipe import Recipe

MANIFEST, RECIPE = "manifest.json", "recipe.toml"
_SCHEMA = 1


def parse_shards(text: str, count: int) -> list[int]:
    """Shard numbers of "3", "0-7" or "0,4,8-11". Raises InputError where one is not below `count`."""
    chosen: dict[int, None] = {}
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if not first <= last < count:
            raise InputError(f"--shard {text}: expected numbers from 0 to {count - 1}, as 3, 0-7 or 0,4,8-11")
        chosen.update(dict.fromkeys(range(first, last + 1)))
    return list(chosen)


def shard_name(shard: int, count: int) -> str:
    """The name of a shard without its suffix."""
    return f"shard-{shard:05d}-of-{count:05d}"


def degrade_shards(
    work: Work,
    out: str | Path,
    shards: int,
    *,
    only: Iterable[int] | None = None,
    tick: Tick = lambda done, total: None,
) -> Outcome:
    """Write the samples of `work` as `shards` array-record files, or some of these.

    Shard s holds the samples from s * len(work) // shards on. Shards that stand already are kept, so a
    run that was stopped goes on; a shard is written whole or not at all. Its pictures are those of
    `degrade_files`, rounded to 8 bits.

    Args:
        work: inputs, recipe, versions, seed.
        out: the folder, made where it is missing; several processes may write into it.
        shards: how many in all.
        only: the shards to write now; all unless given.
        tick: called with (done, total) samples.

    Raises:
        InputError: the folder holds shards of other samples, cannot be written, or another process
            writes one of these shards; or array_record is not installed.
    """
    _array_record()
    out, outcome, clock = Path(out), Outcome(), time.perf_counter()
    numbers = list(range(shards) if only is None else only)
    with locked(out, shared=True):
        _write_plan(work, out, shards)
        total = sum(len(_range(work, s, shards)) for s in numbers)
        for shard in numbers:
            with locked(out, name=f".{shard_name(shard, shards)}.lock"):
                _write_shard(work, out, shard, shards, outcome, lambda done: tick(done, total))
    outcome.seconds = time.perf_counter() - clock
    return outcome


def _range(work: Work, shard: int, shards: int) -> range:
    return range(len(work) * shard // shards, len(work) * (shard + 1) // shards)


def _write_plan(work: Work, out: Path, shards: int) -> None:
    """The manifest that all shards have in common; it must be that of the shards that stand there."""
    plan = {
        "schema": _SCHEMA,
        "format": "array_record of npz: clean, noisy (H, W, 3) uint8, index, name, parameters (TOML)",
        "jaxisp": __version__,
        "recipe": work.recipe.name,
        "recipe_sha256": work.digest,
        "seed": work.seed,
        "start": work.start,
        "count": work.count,
        "samples": len(work),
        "shards": shards,
        "inputs": [[path.name, path.stat().st_size] for path in work.paths],
    }
    if (out / MANIFEST).exists():
        before = read_manifest(out)
        for key in plan:
            if plan[key] != before.get(key) and key != "jaxisp":
                what = (
                    "other inputs" if key == "inputs" else f"{key} = {before.get(key)!r}, not {plan[key]!r}"
                )
                raise InputError(f"{out}: holds shards of {what}; choose another folder")
        return
    work.recipe.save(out / RECIPE)
    with atomic_write(out / MANIFEST) as file:
        file.write((json.dumps(plan, indent=1) + "\n").encode())


def _write_shard(work: Work, out: Path, shard: int, shards: int, outcome: Outcome, tick: Any) -> None:
    name, which = shard_name(shard, shards), _range(work, shard, shards)
    if _stands(out, name):
        outcome.kept += len(which)
        tick(outcome.images + outcome.kept)
        return
    own = Outcome()
    path = out / f"{name}.array_record"
    temporary = path.with_name(f".{path.name}.tmp")  # the shard is locked: nobody else's
    indices = []
    try:
        writer = _array_record().ArrayRecordWriter(str(temporary), "group_size:1,zstd:1")
        for degraded in work.run(which, own):
            writer.write(encode_record(degraded))
            indices.append(degraded.sample.index)
            outcome.images += 1
            tick(outcome.images + outcome.kept)
        whole = writer.ok()
        writer.close()
        if not whole or _count(temporary) != len(indices):
            raise OSError(0, "the disk may be full")
        size, digest = _finish(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error
    except RuntimeError as error:  # what array_record raises for any trouble with its file
        raise InputError(f"{path}: cannot be written: {_line(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)
    outcome.failed += own.failed
    note = {"bytes": size, "sha256": digest, "indices": indices, "failed": own.failed}
    with atomic_write(out / f"{name}.json") as file:  # the last: where it stands the shard is whole
        file.write((json.dumps(note) + "\n").encode())


def _count(path: Path) -> int:
    """Records in a file that was just written."""
    reader = _array_record().ArrayRecordReader(str(path))
    try:
        return int(reader.num_records())
    finally:
        reader.close()


def _finish(temporary: Path, path: Path) -> tuple[int, str]:
    """Size and digest of a written file, once it is on the disk under its name."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
    os.replace(temporary, path)
    return size, digest


def _stands(out: Path, name: str) -> bool:
    note, path = out / f"{name}.json", out / f"{name}.array_record"
    return note.is_file() and path.is_file() and path.stat().st_size == _read_json(note)["bytes"]


def encode_record(degraded: Degraded) -> bytes:
    """A sample as the bytes of an npz file."""
    out = io.BytesIO()
    parameters = degraded.drawn.to_toml().encode()
    np.savez(
        out,
        clean=to_bytes(degraded.clean, degraded.sample.stem),
        noisy=to_bytes(degraded.noisy, degraded.sample.stem),
        index=np.int64(degraded.sample.index),
        name=np.frombuffer(degraded.sample.stem.encode(), np.uint8),
        parameters=np.frombuffer(parameters, np.uint8),
    )
    return out.getvalue()


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """manifest.json of a folder of shards. Raises InputError where it is missing or damaged."""
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise InputError(
            f"{folder}: holds no {MANIFEST}, expected a folder that jaxisp degrade --shards wrote"
        )
    manifest = _read_json(path)
    if manifest.get("schema") != _SCHEMA or not isinstance(manifest.get("shards"), int):
        raise InputError(f"{path}: has schema {manifest.get('schema')!r}, expected {_SCHEMA}")
    return manifest


def _read_json(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is damaged ({_line(error)})") from None
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
        missing = [s for s, name in enumerate(names) if not _stands(self.folder, name)]
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
            raise InputError(f"{self.folder}: record {place} is damaged ({_line(error)})") from error

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


def _array_record() -> Any:
    try:
        from array_record.python import array_record_module
    except ImportError as error:
        raise InputError("shards need array_record: pip install 'jaxisp[data]'") from error
    return array_record_module


def _array_record_source(paths: list[Path]) -> Any:
    _array_record()
    from array_record.python.array_record_data_source import ArrayRecordDataSource

    return ArrayRecordDataSource([str(path) for path in paths])


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
