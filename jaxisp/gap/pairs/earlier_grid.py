"""Where the 8x8 blocks of compressions began, told from the decoded pictures."""

import numpy as np
from scipy.fft import dctn

_COARSE = 3  # coefficients (i, j) with i + j of at least this: smooth shading has none
_CLEAR = 6.0  # spreads; places beside the file's own grid reach 0.2 of what that has
_BESIDE = 0.35


def earlier_grid(luma: np.ndarray) -> tuple[int, int]:
    """The (row, column) where the blocks of an earlier compression began; (0, 0) if only the file's are seen.

    On the grid of a quantiser fine coefficients are small, since many were rounded to 0: of the 64
    places a grid can have, two stand out of a file that was compressed twice. Rows and columns that a grid
    shares with others stand out a little too, so that only what a place has beyond its row and
    its column counts.

    Args:
        luma: (N, H, W) decoded pictures whose last compression began at (0, 0), 8-bit steps.

    Source: the idea of Barni, Costanzo & Sabatini 2010, here by the mean size of coefficients.
    """
    clear = _clear(luma)
    least = max(_CLEAR, _BESIDE * clear[0, 0])
    clear[0, 0] = 0
    row, column = np.unravel_index(np.argmax(clear), clear.shape)
    return (int(row), int(column)) if clear[row, column] > least else (0, 0)


def own_grid(luma: np.ndarray) -> tuple[int, int] | None:
    """The (row, column) where the blocks of pictures that were decoded and cut began; None if none are seen.

    Args:
        luma: (N, H, W) pictures that were cut at like places, 8-bit steps.
    """
    clear = _clear(luma)
    row, column = np.unravel_index(np.argmax(clear), clear.shape)
    return (int(row), int(column)) if clear[row, column] > _CLEAR else None


def _clear(luma: np.ndarray) -> np.ndarray:
    """(8, 8) how far each of the places of a grid stands out, in spreads."""
    sizes = np.array([[_fine(luma[:, y:, x:]) for x in range(8)] for y in range(8)])
    clear = np.median(sizes, axis=0) + np.median(sizes, axis=1, keepdims=True) - sizes
    clear -= np.median(clear)
    return np.asarray(clear / (1.48 * np.median(np.abs(clear)) + 1e-9))


def _fine(luma: np.ndarray) -> float:
    """The mean size of the fine coefficients of whole 8x8 blocks."""
    n, h, w = (s // 8 * 8 if i else s for i, s in enumerate(luma.shape))
    blocks = luma[:, :h, :w].reshape(n, h // 8, 8, w // 8, 8).swapaxes(2, 3)
    i, j = np.indices((8, 8))
    return float(np.abs(dctn(blocks, axes=(3, 4), norm="ortho"))[..., i + j >= _COARSE].mean())
