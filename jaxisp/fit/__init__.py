"""Fitting a camera to RAW+JPEG pairs."""

from jaxisp.fit.dataset import fit_dataset
from jaxisp.fit.fitter import Example, FitResult, PairResult, fit_examples

__all__ = ["Example", "FitResult", "PairResult", "fit_dataset", "fit_examples"]
