"""EXIF orientation: turning stored pixels upright, and back."""

import numpy as np

INVERSE = {1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}
"""The orientation that undoes each."""


def orient(array: np.ndarray, orientation: int) -> np.ndarray:
    """Turn an array as stored, (H, W) or (H, W, ...), into the upright one.

    Args:
        array: rows and columns come first.
        orientation: EXIF 1 to 8: as is, mirrored, half turn, flipped, transposed, quarter turn
            clockwise, anti-transposed, quarter turn counterclockwise.

    Returns:
        A view. On a mosaic the CFA pattern turns with it.
    """
    if orientation not in INVERSE:
        raise ValueError(f"orientation {orientation} is not one of EXIF 1 to 8")
    if orientation >= 5:
        array = np.swapaxes(array, 0, 1)
    flip_rows, flip_columns = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return array[:: -1 if flip_rows else 1, :: -1 if flip_columns else 1]


def unorient(array: np.ndarray, orientation: int) -> np.ndarray:
    """Turn an upright array back to how a file of that orientation stores it."""
    return orient(array, INVERSE[orientation])
