"""The JPEG that pictures were before they were decoded and cut, as far as the pictures show it."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.gap.pairs.earlier_grid import own_grid
from jaxisp.io import Jpeg
from jaxisp.io.datasets import Loaded
from jaxisp.jpeg.tables import ANNEX_K_CHROMA, ANNEX_K_LUMA

_LARGEST = 96  # of the steps that are looked for
_FEW = 30  # least number of coefficients that are not rounded to 0, of a step that is measured
_SHARP = 0.6  # mean cosine of coefficients over a step: 1 on its multiples, 0 anywhere
_HALVED = 0.7  # share that halving chroma in phase costs of what it costs out of phase, where it was halved


def with_own_file(loaded: Sequence[Loaded]) -> list[Loaded]:
    """Pairs whose pictures come without a file but show the grid of one at their corner, with its header.

    Pictures that show no grid, one at another place, or come with their files stay as they are.
    """
    pictures = [pair.picture for pair in loaded]
    if any(pair.jpeg is not None for pair in loaded) or len({p.shape for p in pictures}) > 1:
        return list(loaded)
    steps = 255 * np.stack([np.stack(rgb_to_ycbcr_planes(*np.moveaxis(p, -1, 0))) for p in pictures])
    if own_grid(steps[:, 0]) != (0, 0):
        return list(loaded)
    tables = quantization_of(steps[:, 0])
    if tables is None:
        return list(loaded)
    header = Jpeg(
        np.zeros((0, 0, 3), np.uint8), tables, sampling_of(steps[:, 1:].reshape(-1, *steps.shape[2:])),
        orientation=1, icc=None, converted=False, color_space="YCbCr", iso=None, make="", model="",
    )  # fmt: skip
    return [dataclasses.replace(pair, jpeg=header) for pair in loaded]


def quantization_of(luma: np.ndarray) -> np.ndarray | None:
    """(3, 8, 8) quantisation steps of decoded pictures (N, H, W), 8-bit steps, whose blocks begin at (0, 0).

    A step is the largest number that luma's coefficients are multiples of. Where all coefficients were
    rounded to 0, and for chroma, steps follow from the others' ratio to the standard's tables. None where no
    step can be told.
    """
    n, height, width = luma.shape
    blocks = luma[:, : height // 8 * 8, : width // 8 * 8].reshape(n, height // 8, 8, width // 8, 8)
    found = dctn(blocks.swapaxes(2, 3) - 128, axes=(3, 4), norm="ortho").reshape(-1, 64)
    steps = np.array([_step(found[:, k]) for k in range(64)]).reshape(8, 8)
    told = steps > 0
    if not told.any():
        return None
    ratio = float(steps[told].sum() / ANNEX_K_LUMA[told].sum())
    luma_table, chroma_table = (np.clip(np.round(ratio * t), 1, 255) for t in (ANNEX_K_LUMA, ANNEX_K_CHROMA))
    return np.stack([np.where(told, steps, luma_table), chroma_table, chroma_table]).astype(int)


def _step(coefficients: np.ndarray) -> int:
    """The quantisation step of one coefficient; 0 where it cannot be told."""
    sizes = np.abs(coefficients)
    for step in range(_LARGEST, 1, -1):
        own = sizes[sizes > step / 2]
        if len(own) >= _FEW and np.cos(2 * np.pi * own / step).mean() > _SHARP:
            return step
    return 0


def sampling_of(chroma: np.ndarray) -> str:
    """How the chroma planes (N, H, W) of decoded pictures were stored: "4:4:4", "4:2:2" or "4:2:0"."""
    columns, rows = _is_halved(chroma), _is_halved(chroma.swapaxes(1, 2))
    return ("4:2:0" if rows else "4:2:2") if columns else "4:4:4"


def _is_halved(planes: np.ndarray) -> bool:
    """Whether pairs of columns from the first on differ less from what lies between pairs than others do."""

    def cost(start: int) -> float:
        even = planes[..., start : start + (planes.shape[-1] - start) // 2 * 2]
        small = even.reshape(*even.shape[:-1], -1, 2).mean(-1)
        near = np.pad(small, [(0, 0)] * (small.ndim - 1) + [(1, 1)], mode="edge")
        left, right = 0.75 * small + 0.25 * near[..., :-2], 0.75 * small + 0.25 * near[..., 2:]
        restored = np.stack([left, right], -1).reshape(even.shape)
        return float(((even - restored) ** 2)[..., 4:-4].mean())

    return cost(0) < _HALVED * cost(1)
