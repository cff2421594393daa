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


def quantised_off_grid(pictures: np.ndarray, files: Sequence[Jpeg | None], by: tuple[int, int]) -> np.ndarray:
    """(N, H, W, 3) what quantisation adds to pictures, in steps of Y'CbCr, where files of these headers store
    them once more.

    Args:
        pictures: (N, H, W, 3) encoded, as such files have them: their chroma is sampled already, and what
            sampling does to it again is not counted.
        files: N headers.
        by: rows and columns that the blocks are off the pictures' own, on which nothing would be lost; a
            multiple of 2, by which most files sample chroma.
    """
    moved = np.roll(pictures, by, (1, 2))
    added = [to_steps(as_stored(p, f)) - to_steps(_sampled(p, f)) for p, f in zip(moved, files)]
    return np.roll(np.stack(added), (-by[0], -by[1]), (1, 2))


def _sampled(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """The picture after a file that samples its chroma and quantises as finely as it can."""
    if file is None or file.subsampling == "4:4:4":
        return picture
    return as_stored(picture, dataclasses.replace(file, tables=np.ones_like(file.tables)))
