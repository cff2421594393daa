"""Fitting a camera to RAW+JPEG pairs."""

from jaxisp.fit.dataset import fit_dataset
from jaxisp.fit.fitter import fit_examples
from jaxisp.fit.pair import Example
from jaxisp.fit.prior import prior_from_cameras
from jaxisp.fit.raw_noise import estimate_raw_noise
from jaxisp.fit.result import FitResult, PairResult

__all__ = [
    "Example",
    "FitResult",
    "PairResult",
    "estimate_raw_noise",
    "fit_dataset",
    "fit_examples",
    "prior_from_cameras",
]
__dir__ = __all__.copy  # what an editor completes
