"""What the data say about each parameter: standard errors from the curvature at the solution."""

import dataclasses
from typing import Any

import numpy as np

from jaxisp.fit.sharing import CAMERA, IMAGE
from jaxisp.fit.solve import PATCH, Fit
from jaxisp.fit.state import Equations, State
from jaxisp.params import specs

PRIOR = 4.0  # standard deviation on the real line of what the data do not see
LEAST = 0.1  # what the error of a number on a linear scale is relative to at least
KNOWN = 0.025  # relative standard error up to which a parameter counts as identified: 5 % at two of them


@dataclasses.dataclass(frozen=True)
class Identified:
    """One fitted number of the camera.

    Args:
        name: stage.field, with an index in brackets for an element.
        value: as fitted.
        error: its standard error, relative: to the value on a log scale, else to the largest element of
            the parameter, or to 0.1 where that is smaller.
        known: whether the data identify it.
    """

    name: str
    value: float
    error: float
    known: bool


def standard_errors(fit: Fit, state: State, at: Equations) -> list[Identified]:
    """The camera's parameters with their relative standard errors, correlations included.

    The covariance is the inverse of `J^T W J` over the variance of the residual, of which PATCH pixels
    count as one, for its neighbours resemble each other; all other parameters and the geometry vary with it.
    """
    columns = len(state.camera)
    variance = max(at.loss / max(at.weight, 1), 1e-9) / 2 * PATCH
    precision = at.data / variance + np.eye(len(at.data)) / PRIOR**2
    spread = np.sqrt(np.maximum(np.linalg.inv(precision).diagonal(), 0))[:columns]
    layout = fit.problem.layout
    params = layout.bounded(fit.fixed, state.camera, state.images[0] if layout.size(IMAGE) else np.zeros(0))
    found = []
    index = 0
    for stage, field, flag, shape in layout.leaves:
        if flag != CAMERA:
            continue
        values = np.ravel(np.asarray(getattr(params[stage], field), np.float64))
        spec = specs(type(params[stage]))[field]
        largest = max(float(np.abs(values).max()), LEAST)
        for at_index, value in zip(np.ndindex(shape), values):
            slope = _slope(spec, float(value))
            error = float(spread[index] * slope / (1.0 if spec.scale == "log" else largest))
            suffix = f"[{', '.join(map(str, at_index))}]" if shape else ""
            found.append(Identified(f"{stage}.{field}{suffix}", float(value), error, error <= KNOWN))
            index += 1
    return found


def _slope(spec: Any, value: float) -> float:
    """How far the value (or its logarithm) moves with its place on the real line."""
    low, high = np.log(spec.bounds) if spec.scale == "log" else spec.bounds
    scaled = np.log(value) if spec.scale == "log" else value
    share = np.clip((scaled - low) / (high - low), 1e-4, 1 - 1e-4)
    return float((high - low) * share * (1 - share))
