"""Start values of a camera's colour matrix, from its pictures or, for grey pictures, a typical one."""

import numpy as np

from jaxisp.color import srgb_to_linear

TYPICAL = np.array([[0.6, -0.5, -0.1], [-0.25, 0.5, -0.25], [0.0, -0.6, 0.6]])
"""Difference of a typical phone's colour matrix from the identity; its rows sum to 0, which keeps white."""
_COLOURLESS = 3e-5
_BLOCK = 8


def typical_matrix(gains: np.ndarray, share: float = 1.0) -> np.ndarray:
    """Colour matrix (3, 3) in linear light whose rows sum to the gains (3,).

    Args:
        gains: (3,) row sums.
        share: factor on `TYPICAL`; 0 gives a diagonal matrix.
    """
    return np.asarray(gains)[:, None] * (np.eye(3) + share * TYPICAL)


def is_colourless(light: np.ndarray, mask: np.ndarray) -> bool:
    """Whether pictures are so grey that a colour matrix would be fitted to noise alone.

    The colours of such pictures lie in a plane of grey and one other direction, up to `_COLOURLESS` of their
    mean square. Usual scenes have some hundredths outside it. Noise does not count as colour: only products
    of neighbouring blocks are used, whose noise is independent.

    Args:
        light: (N, H, W, 3) linear light, white balanced.
        mask: (N, H, W) pixels that count.
    """
    n, height, width = mask.shape
    rows, pairs = height // _BLOCK, width // (2 * _BLOCK)

    def means(a: np.ndarray) -> np.ndarray:
        a = a[:, : rows * _BLOCK, : 2 * pairs * _BLOCK]
        return a.reshape(n, rows, _BLOCK, pairs, 2, _BLOCK, -1).mean((2, 5), dtype=float)

    whole = (means(mask[..., None]) == 1).all((3, 4))
    first, second = np.moveaxis(means(light)[whole], 1, 0)
    shared = first.T @ second
    spectrum = np.linalg.eigvalsh((shared + shared.T) / 2)
    return bool(spectrum[1] < _COLOURLESS * spectrum.sum())


def start_matrix(light: np.ndarray, pictures: np.ndarray, mask: np.ndarray, block: int = 8) -> np.ndarray:
    """Colour matrix (3, 3) by least squares in linear light over block means.

    Args:
        light: (N, H, W, 3) white-balanced camera RGB.
        pictures: (N, H, W, 3) encoded sRGB in [0, 1].
        mask: (N, H, W) pixels that count.
        block: side of the blocks [px].
    """
    linear = srgb_to_linear(pictures)

    def means(a: np.ndarray) -> np.ndarray:
        n, h, w, c = a.shape
        a = a[:, : h // block * block, : w // block * block]
        return a.reshape(n, h // block, block, w // block, block, c).mean((2, 4)).reshape(-1, c)

    whole = means(mask[..., None].astype(np.float32))[:, 0] == 1
    return np.linalg.lstsq(means(light)[whole], means(linear)[whole], rcond=None)[0].T
