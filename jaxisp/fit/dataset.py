"""Fit a camera to a folder of RAW+JPEG pairs."""

from pathlib import Path

from jaxisp.errors import InputError
from jaxisp.fit.fitter import Example, FitResult, Tick, fit_examples
from jaxisp.io import open_dataset


def fit_dataset(
    folder: str | Path,
    *,
    steps: int = 250,
    demosaic: str = "demosaic_ahd",
    tick: Tick = lambda done, total, text: None,
) -> FitResult:
    """Fit one camera to every readable pair of a folder.

    Args:
        folder: a data set of RAW+JPEG pairs.
        steps: gradient steps in all.
        demosaic: the demosaicking stage.
        tick: called with (done, total, text).

    Returns:
        the fit; pairs that could not be read or aligned are in `failed`.

    Raises:
        InputError: no such folder, no pair, or none that can be fitted.
    """
    dataset = open_dataset(folder, kind="raw+jpeg")
    examples, failed = [], [(str(path), f"{path}: {reason}") for path, reason in dataset.problems]
    for pair in dataset.pairs:
        try:
            loaded = pair.load()
        except InputError as error:
            failed.append((pair.name, str(error)))
            continue
        assert loaded.raw is not None, "a raw+jpeg pair has one"
        examples.append(Example(pair.name, loaded.raw, loaded.picture, loaded.jpeg))
    if not examples:
        raise InputError("; ".join(reason for _, reason in failed))
    result = fit_examples(examples, steps=steps, demosaic=demosaic, tick=tick)
    result.failed.extend(failed)
    return result
