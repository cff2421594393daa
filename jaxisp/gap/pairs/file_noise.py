"""What a picture's own file did to it, told from what the camera did."""

from collections.abc import Sequence

import numpy as np
from scipy.fft import idctn

from jaxisp.gap.pairs.pairs import to_rgb, to_steps
from jaxisp.gap.pairs.stored import quantised_off_grid
from jaxisp.gap.pairs.stored_twice import blocks_of
from jaxisp.io import Jpeg

_OFF_GRID = (3, 5)
"""Rows and columns by which a picture is moved before it is compressed."""


def file_noise(beyond: np.ndarray, pictures: np.ndarray, files: Sequence[Jpeg | None]) -> np.ndarray:
    """(N, H, W, 3) the part of what pictures have beyond a model that their files made.

    A Wiener filter of 8x8 coefficients in Y'CbCr: a frequency keeps one less the energy that compression adds
    there, over the energy that is there. The first is measured by compressing the pictures once more, off
    their grid. Where the model misses much, nearly all of it is the camera's.

    Args:
        beyond: (N, H, W, 3) pictures less what the model makes, encoded.
        pictures: (N, H, W, 3) encoded, their 8x8 blocks at the top-left corner.
        files: their headers.
    """
    added = blocks_of(quantised_off_grid(pictures, files, _OFF_GRID, back=False))
    own = blocks_of(to_steps(beyond))
    energies = [(b**2).mean((0, 1, 3)) for b in (added, own)]
    share = np.minimum(energies[0] / (energies[1] + 1e-9), 1)
    made = idctn(own * share[:, None], axes=(2, 4), norm="ortho")
    rows, columns = own.shape[1] * 8, own.shape[3] * 8
    found = np.zeros_like(beyond)
    found[:, :rows, :columns] = to_rgb(made.reshape(len(beyond), rows, columns, 3))
    return found
