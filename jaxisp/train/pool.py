"""Pairs that were degraded once and lie on disk, for networks that learn faster than pairs can be made."""

import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxisp.errors import InputError, one_line
from jaxisp.io.digests import digest_of, is_file_of, read_sealed, sealed_json
from jaxisp.io.files import atomic_write, open_input, output_folder, parse_json, reason, write_text, writing

PART = 1024
"""Pairs in a file, rounded up to whole batches."""


class PairPool:
    """Pairs by index, 8 bits each. Written file by file, each with a note of its digest: what is of this run,
    and as it was written, stays where it is made again.

    Args:
        folder: of the files.
        of: what the run was told, as a digest.
        size: of a patch [px].
        count: pairs in all, rounded up to whole files.
        make: the (noisy, target) patches of indices, (N, size, size, 3) in [0, 1] each.
        seed: of order and turn.
        batch: pairs that are made at once.
        tick: called with (done, total, text).

    Raises:
        InputError: a file cannot be written or read.
    """

    def __init__(
        self,
        folder: Path,
        of: str,
        size: int,
        count: int,
        make: Callable[[range], tuple[jax.Array, jax.Array]],
        *,
        seed: int = 0,
        batch: int = 32,
        tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
    ) -> None:
        output_folder(folder)
        part = -(-PART // batch) * batch
        self.size, self.seed, self.count, self._part = size, seed, -(-count // part) * part, part
        self._parts: list[_Part] = []
        for first in range(0, self.count, part):
            path = folder / f"{first // part:05d}.npy"
            if not is_part_of(path, of, first):
                starts = range(first, first + part, batch)
                made = np.concatenate([_levels(make(range(start, start + batch))) for start in starts])
                with writing(path), atomic_write(path) as file:
                    np.save(file, made)
                note = {"of": of, "first": first, "sha256": digest_of(path)}
                write_text(path.with_suffix(".json"), sealed_json(json.dumps(note)))
            self._parts.append(_opened(path, (part, 2, size, size, 3)))
            tick(first + part, self.count, "degrading")
        self._epoch = (-1, np.zeros(0, np.int64))

    def __len__(self) -> int:
        return self.count

    def batch(self, indices: Any) -> np.ndarray:
        """(N, 2, size, size, 3) uint8, noisy and target, of global indices: each epoch in another order."""
        return np.stack([self._pair(int(i)) for i in indices])

    def _pair(self, index: int) -> np.ndarray:
        epoch, position = divmod(index, self.count)
        if self._epoch[0] != epoch:
            self._epoch = (epoch, np.random.default_rng((self.seed, 3, epoch)).permutation(self.count))
        slot = int(self._epoch[1][position])
        pair = self._parts[slot // self._part].pair(slot % self._part)
        turn, flip = np.random.default_rng((self.seed, 4, slot, epoch)).integers(4), (slot + epoch) % 2
        pair = np.rot90(pair, int(turn), axes=(1, 2))
        return pair[:, :, ::-1] if flip else pair


def _levels(pair: tuple[jax.Array, jax.Array]) -> np.ndarray:
    return np.stack([np.round(np.clip(np.asarray(p), 0, 1) * 255) for p in pair], 1).astype(np.uint8)


class _Part(NamedTuple):
    """A file, read and not mapped: one that is cut meanwhile would end the process."""

    path: Path
    file: io.BufferedReader
    start: int
    shape: tuple[int, ...]

    def pair(self, slot: int) -> np.ndarray:
        size = int(np.prod(self.shape))
        try:
            data = os.pread(self.file.fileno(), size, self.start + slot * size)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {reason(error)}") from error
        if len(data) < size:
            raise InputError(f"{self.path}: was cut short while it was in use")
        return np.frombuffer(data, np.uint8).reshape(self.shape)


def is_part_of(path: Path, of: str, first: int) -> bool:
    """Whether the file of this run and this place is there, to the bit."""
    note = path.with_suffix(".json")
    try:
        told = parse_json(read_sealed(note), str(note))
    except InputError:
        return False
    return (told.get("of"), told.get("first")) == (of, first) and is_file_of(path, str(told.get("sha256")))


def _opened(path: Path, shape: tuple[int, ...]) -> _Part:
    file = open_input(path)
    try:
        np.lib.format.read_magic(file)
        found, _, dtype = np.lib.format.read_array_header_1_0(file)
        if found != shape or dtype != np.uint8:
            raise ValueError(f"holds {dtype} of {found}, expected uint8 of {shape}")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({one_line(error)}); delete it to have it made again"
        ) from error
    return _Part(path, file, file.tell(), shape[1:])
