"""Shards: degraded samples in array-record files, a range of samples each, with a manifest.

A shard is a job: any machine can write any of them, in any order, and a job that was killed is run again.
What sample k is follows from the inputs, the recipe, the seed and k alone.
"""

import contextlib
import io
import json
import os
import re
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp import __version__
from jaxisp.checks import check_whole
from jaxisp.data.shard_source import (
    MANIFEST,
    MOST_SHARDS,
    SCHEMA,
    array_record,
    read_manifest,
    shard_name,
    stands,
    told_of,
)
from jaxisp.data.work import Degraded, Outcome, Tick, Work
from jaxisp.errors import InputError, one_line, short
from jaxisp.io.digests import digest_of, sealed_json
from jaxisp.io.files import atomic_write, check_output, write_new, write_text
from jaxisp.io.jpeg import to_bytes
from jaxisp.io.locks import locked

RECIPE = "recipe.toml"


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
    array_record()
    check_whole("shards", shards, 1)
    if shards > MOST_SHARDS:
        raise InputError(f"{shards} shards: expected 1 to {MOST_SHARDS}")
    out, outcome, clock = Path(out), Outcome(), time.perf_counter()
    numbers = list(range(shards) if only is None else only)
    if wrong := [s for s in numbers if s not in range(shards)]:
        raise InputError(f"only = {short(wrong)}: shards are counted from 0 to {shards - 1}")
    with locked(out, shared=True):
        for name in (shard_name(shard, shards) for shard in numbers):
            for end in (".array_record", ".json"):  # before the plan is written
                check_output(out / f"{name}{end}", work.inputs_real)
        with locked(out, name=".plan.lock", wait=True):  # another that starts now has to see this plan
            plan = _write_plan(work, out, shards, numbers)
        total = sum(len(_range(work, s, shards)) for s in numbers)
        for shard in numbers:
            with locked(out, name=f".{shard_name(shard, shards)}.lock"):
                told = told_of(plan, shard)
                _write_shard(work, out, told, outcome, lambda done: tick(done, total))
    outcome.seconds = time.perf_counter() - clock
    return outcome


def _range(work: Work, shard: int, shards: int) -> range:
    return range(len(work) * shard // shards, len(work) * (shard + 1) // shards)


def _write_plan(work: Work, out: Path, shards: int, numbers: list[int]) -> dict[str, Any]:
    """Write the manifest that all shards have in common; it must be that of the shards that stand there.

    Who writes it takes the digests of all inputs; others those of the inputs of their own shards.
    """
    before = read_manifest(out) if os.path.lexists(out / MANIFEST) else {}
    own = {k // work.count for s in numbers for k in _range(work, s, shards)}
    told = before.get("inputs", [])
    plan = {
        "schema": SCHEMA,
        "format": "array_record of npz: clean, noisy (H, W, 3) uint8, index, name, parameters (TOML)",
        "jaxisp": __version__,
        "recipe": work.degradation.name,
        "recipe_sha256": work.digest,
        "seed": work.seed,
        "start": work.start,
        "count": work.count,
        "samples": len(work),
        "shards": shards,
        "inputs": [
            [path.name, told[i][1] if i < len(told) and i not in own else work.digest_of(path)]
            for i, path in enumerate(work.paths)
        ],
    }
    if before:
        for key in plan:
            if plan[key] != before.get(key) and key != "jaxisp":
                other = {
                    "inputs": "other inputs",
                    "recipe_sha256": f"another recipe named {plan['recipe']!r}",
                }
                what = other.get(key, f"{key} = {before.get(key)!r}, not {plan[key]!r}")
                raise InputError(f"{out}: holds shards of {what}; choose another folder")
    write_new(out / RECIPE, work.degradation.to_toml())
    if not before:
        write_text(out / MANIFEST, sealed_json(json.dumps(plan, indent=1)))
    return plan


def _write_shard(work: Work, out: Path, told: dict[str, Any], outcome: Outcome, tick: Any) -> None:
    """Write a shard, or keep it; `told` is what its note says it is of."""
    name, which = shard_name(told["shard"], told["shards"]), _range(work, told["shard"], told["shards"])
    if stands(out, name, told):
        outcome.kept += len(which)
        tick(outcome.images + outcome.kept)
        return
    own = Outcome()
    path, note = out / f"{name}.array_record", out / f"{name}.json"
    indices = []
    with atomic_write(path) as file:
        place = f"/dev/fd/{file.fileno()}"  # it has no name before it is whole
        with _recording(path):
            writer = array_record().ArrayRecordWriter(place, "group_size:1,zstd:1")
        for degraded in work.run(which, own):
            with _recording(path):
                writer.write(encode_record(degraded))
            indices.append(degraded.sample.index)
            outcome.images += 1
            tick(outcome.images + outcome.kept)
        with _recording(path):
            whole = writer.ok()
            writer.close()
            if not whole or _count(place) != len(indices):
                raise OSError(0, "the disk may be full")
    outcome.failed += own.failed
    size, digest = path.stat().st_size, digest_of(path)
    said = {"of": told, "bytes": size, "sha256": digest, "indices": indices, "failed": own.failed}
    write_text(note, sealed_json(json.dumps(said)))  # the last: where it stands the shard is whole


@contextlib.contextmanager
def _recording(path: Path) -> Iterator[None]:
    """InputError that names the path for what array_record raises, a RuntimeError for any trouble."""
    try:
        yield
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be written: {one_line(error)}") from error


def _count(place: str) -> int:
    """Records in a file that was just written."""
    reader = array_record().ArrayRecordReader(place)
    try:
        return int(reader.num_records())
    finally:
        reader.close()


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
