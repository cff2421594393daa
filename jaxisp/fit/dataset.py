"""Fit a camera to a folder of RAW+JPEG pairs."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.fit.fitter import fit_examples
from jaxisp.fit.pair import Example
from jaxisp.fit.result import FitResult
from jaxisp.io import Jpeg, Pair, open_dataset


class _Lazy:
    """A pair that is read when it is called: a folder of large ones does not fit into memory."""

    def __init__(self, pair: Pair):
        self.pair, self.name = pair, pair.name

    def __call__(self) -> Example:
        loaded = self.pair.load()
        assert loaded.raw is not None, "a raw+jpeg pair has one"
        jpeg = loaded.jpeg if loaded.jpeg is not None and _as_stored(loaded.jpeg, loaded.picture) else None
        return Example(self.name, loaded.raw, loaded.picture, jpeg)


def _as_stored(jpeg: Jpeg, picture: np.ndarray) -> bool:
    """Whether a picture lies as its file does: turned to its RAW, it is not on its encoder's grid."""
    thin = (slice(None, None, 31), slice(None, None, 31))
    return np.array_equal(jpeg.pixels[thin].astype(np.float32) / np.float32(255), picture[thin])


def fit_dataset(folder: str | Path, **options: Any) -> FitResult:
    """Fit one camera to every readable pair of a folder.

    Args:
        folder: a data set of RAW+JPEG pairs.
        **options: those of `jaxisp.fit.fit_examples`.

    Returns:
        the fit; pairs that could not be read or aligned are in `failed`.

    Raises:
        InputError: no such folder, no pair, or none that can be fitted.
    """
    dataset = open_dataset(folder, kind="raw+jpeg")
    failed = [(str(path), f"{path}: {reason}") for path, reason in dataset.problems]
    try:
        result = fit_examples([_Lazy(pair) for pair in dataset.pairs], **options)
    except InputError as error:
        raise InputError("; ".join([str(error), *(reason for _, reason in failed)])) from None
    result.failed.extend(failed)
    return result
