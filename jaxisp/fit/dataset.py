"""Fit a camera to a folder of RAW+JPEG pairs."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jax.sharding import Mesh

from jaxisp.calibrate import Calibrated, Noise
from jaxisp.errors import InputError
from jaxisp.fit.fitter import HOLD_OUT, STEPS, fit_examples
from jaxisp.fit.pair import Example
from jaxisp.fit.result import FitResult
from jaxisp.fit.search import Tick
from jaxisp.io import Jpeg, Pair, Raw, open_dataset
from jaxisp.pipeline import Stage
from jaxisp.recipes import RecipeLike


class _Lazy:
    """A pair that is read when it is called: a folder of large ones does not fit into memory."""

    def __init__(self, pair: Pair, noise: Calibrated | None):
        self.pair, self.name, self.noise = pair, pair.name, noise

    def __call__(self) -> Example:
        loaded = self.pair.load()
        assert loaded.raw is not None, "a raw+jpeg pair has one"
        raw = loaded.raw if self.noise is None else _with_profile(loaded.raw, self.noise.at(loaded.iso))
        jpeg = loaded.jpeg if loaded.jpeg is not None and _as_stored(loaded.jpeg, loaded.picture) else None
        return Example(self.name, raw, loaded.picture, jpeg)


def _with_profile(raw: Raw, noise: Noise) -> Raw:
    """The RAW as if its file stated this noise."""
    return dataclasses.replace(raw, noise_profile=np.tile([noise.value("shot"), noise.value("read")], (3, 1)))


def _as_stored(jpeg: Jpeg, picture: np.ndarray) -> bool:
    """Whether a picture lies as its file does: turned to its RAW, it is not on its encoder's grid."""
    thin = (slice(None, None, 31), slice(None, None, 31))
    return np.array_equal(jpeg.pixels[thin].astype(np.float32) / np.float32(255), picture[thin])


def fit_dataset(
    folder: str | Path,
    *,
    start: RecipeLike | None = None,
    freeze: str | Sequence[str] = (),
    free: str | Sequence[str] = (),
    insert: str | Stage | Sequence[str | Stage] = (),
    per_image: str | Sequence[str] = (),
    noise: Calibrated | str | Path | None = None,
    steps: int = STEPS,
    demosaic: str = "auto",
    median: str = "auto",
    place: str = "camera",
    starts: int = 1,
    hold_out: str = HOLD_OUT[0],
    journal: str | Path | None = None,
    mesh: Mesh | None = None,
    tick: Tick = lambda done, total, text: None,
) -> FitResult:
    """Fit one camera to every readable pair of a folder.

    Args:
        folder: a data set of RAW+JPEG pairs.
        noise: of the sensor, as `jaxisp calibrate` measured it, in the place of what the RAWs state or show.
        start, freeze, free, insert, per_image: as those of `jaxisp.fit.fit_examples`, and so are
        steps, demosaic, median, place, starts, hold_out, journal, mesh, tick.

    Returns:
        the fit; pairs that could not be read or aligned are in `failed`.

    Raises:
        InputError: no such folder, no pair, none that can be fitted, or noise of other ISO numbers.
    """
    known = Calibrated.load(noise) if isinstance(noise, str | Path) else noise
    dataset = open_dataset(folder, kind="raw+jpeg")
    failed = [(str(path), f"{path}: {reason}") for path, reason in dataset.problems]
    try:
        result = fit_examples(
            [_Lazy(pair, known) for pair in dataset.pairs],
            start=start,
            freeze=freeze,
            free=free,
            insert=insert,
            per_image=per_image,
            steps=steps,
            demosaic=demosaic,
            median=median,
            place=place,
            starts=starts,
            hold_out=hold_out,
            journal=journal,
            mesh=mesh,
            tick=tick,
        )
    except InputError as error:
        raise InputError("; ".join([str(error), *(reason for _, reason in failed)])) from None
    result.failed.extend(failed)
    return result
