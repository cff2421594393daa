"""Pictures as files store them."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxisp.encoder import encoder_of
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.io import Jpeg
from jaxisp.pipeline import run


def as_stored(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """(H, W, 3) encoded, as a file with this one's header would have it; rounded where its encoder is not
    modelled."""
    own = encoder_of(file, original=picture)
    return np.round(255 * picture) / 255 if own is None else np.asarray(run(*own, picture))


def quantised_off_grid(
    pictures: np.ndarray, files: Sequence[Jpeg | None], by: tuple[int, int], *, back: bool = True
) -> np.ndarray:
    """(N, H, W, 3) what quantisation adds to pictures, in steps of Y'CbCr, where files of these headers store
    them once more.

    Args:
        pictures: (N, H, W, 3) encoded, as such files have them: their chroma is sampled already, and what
            sampling does to it again is not counted.
        files: N headers.
        by: rows and columns by which the pictures are moved first, in samples of a file: on their own blocks
            nothing would be lost.
        back: whether the result is moved back; else its blocks begin at the top-left corner.
    """
    found = _added(pictures, files, by, back)
    if any(map(_samples, files)):  # their samples of chroma are two pixels
        found[..., 1:] = _added(pictures, files, (2 * by[0], 2 * by[1]), back)[..., 1:]
    return found


def _added(pictures: np.ndarray, files: Sequence[Jpeg | None], by: tuple[int, int], back: bool) -> np.ndarray:
    moved = np.roll(pictures, by, (1, 2))
    added = np.stack([to_steps(as_stored(p, f)) - to_steps(_sampled(p, f)) for p, f in zip(moved, files)])
    return np.roll(added, (-by[0], -by[1]), (1, 2)) if back else added


def _samples(file: Jpeg | None) -> bool:
    return file is not None and file.subsampling != "4:4:4"


def _sampled(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """The picture after a file that samples its chroma and quantises as finely as it can."""
    if file is None or not _samples(file):
        return picture
    return as_stored(picture, dataclasses.replace(file, tables=np.ones_like(file.tables)))
