"""What two JPEG files of one picture differ in, though nothing has changed it but a little."""

from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn, idctn

from jaxisp.gap.pairs.pairs import INNER, to_steps
from jaxisp.gap.pairs.stored import quantised_off_grid
from jaxisp.io import Jpeg

_OFF_GRID = ((3, 3), (5, 5))
"""Rows and columns by which a picture is moved before it is compressed, once for each file."""
_SAME = 1.5
"""Difference of coefficients [8-bit steps] that rounding of decoded pixels makes."""


def stored_twice(first: np.ndarray, second: np.ndarray, files: Sequence[Sequence[Jpeg | None]]) -> np.ndarray:
    """(N, h, w, 3) what the compressions of two pictures leave between them, in steps, its border cut off.

    It has the energy that remains where what has changed from the first picture to the second is known. Both
    quantise the same coefficients, so that one that has hardly changed is mostly rounded alike. A change by a
    share t of a step, of a coefficient that is anywhere between two levels, moves it by a step with
    probability t: the mean square move is t, and t (1 - t) of it is chance. So what remains of a frequency is
    its mean square move times the share p that stays, at least 1 - p of what two independent roundings leave,
    and at most all of that. Where the files quantise by different steps nothing is rounded alike: all of it
    is left.

    Args:
        first, second: (N, H, W, 3) encoded, their 8x8 blocks at the top-left corner.
        files: their headers, N each.
    """
    total = np.sum([quantised_off_grid(first, *how)[INNER] for how in zip(files, _OFF_GRID)], 0)
    if any(file is None for own in files for file in own):
        return total  # what is not quantised in blocks
    change, whole = blocks_of(to_steps(second[INNER]) - to_steps(first[INNER])), blocks_of(total)
    moved = np.abs(change) >= _SAME
    stay = (1 - moved.mean((0, 1, 3))) * _alike(files)
    both = (whole**2).mean((0, 1, 3)) + 1e-9
    chance = np.maximum((change**2 * moved).mean((0, 1, 3)) * stay, (1 - stay) * both)
    left = np.minimum(chance / both, 1)
    shaped = idctn(whole * np.sqrt(left)[:, None], axes=(2, 4), norm="ortho")
    height, width = map(int, np.shape(total)[1:3])
    rows, columns = height // 8 * 8, width // 8 * 8
    total[:, :rows, :columns] = shaped.reshape(len(total), rows, columns, 3)
    return total


def _alike(files: Sequence[Sequence[Jpeg | None]]) -> np.ndarray:
    """(8, 8, 3) whether the two files of each pair quantise a frequency of Y', Cb or Cr by the same step, and
    sample chroma alike."""
    pairs = [(one, other) for one, other in zip(*files) if one is not None and other is not None]
    alike = np.all([one.tables == other.tables for one, other in pairs], 0)
    alike[1:] &= all(one.subsampling == other.subsampling for one, other in pairs)
    return np.moveaxis(alike, 0, -1)


def blocks_of(pictures: np.ndarray) -> np.ndarray:
    """(N, h / 8, 8, w / 8, 8, 3) coefficients of whole 8x8 blocks."""
    n, height, width = (s // 8 * 8 if i else s for i, s in enumerate(pictures.shape[:3]))
    blocks = pictures[:, :height, :width].reshape(n, height // 8, 8, width // 8, 8, 3)
    return np.asarray(dctn(blocks, axes=(2, 4), norm="ortho"), np.float32)
