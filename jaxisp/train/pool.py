"""Pairs that were degraded once and lie on disk, for networks that learn faster than pairs can be made."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxisp.errors import InputError, one_line
from jaxisp.io.files import atomic_write, output_folder, writing

PART = 1024
"""Pairs in a file, rounded up to whole batches."""


class PairPool:
    """Pairs by index, 8 bits each. Written file by file; those that are whole stay where it is made again.

    Args:
        folder: of the files.
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
        self._parts: list[np.ndarray] = []
        for first in range(0, self.count, part):
            path = folder / f"{first // part:05d}.npy"
            if not path.exists():
                starts = range(first, first + part, batch)
                made = np.concatenate([_levels(make(range(start, start + batch))) for start in starts])
                with writing(path), atomic_write(path) as file:
                    np.save(file, made)
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
        pair = self._parts[slot // self._part][slot % self._part]
        turn, flip = np.random.default_rng((self.seed, 4, slot, epoch)).integers(4), (slot + epoch) % 2
        pair = np.rot90(pair, int(turn), axes=(1, 2))
        return pair[:, :, ::-1] if flip else pair


def _levels(pair: tuple[jax.Array, jax.Array]) -> np.ndarray:
    return np.stack([np.round(np.clip(np.asarray(p), 0, 1) * 255) for p in pair], 1).astype(np.uint8)


def _opened(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    try:
        found = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({one_line(error)}); delete it to have it made again"
        ) from error
    if found.shape != shape or found.dtype != np.uint8:
        raise InputError(f"{path}: is not of this run; delete it to have it made again")
    return found
