"""Checks on the host: values within their bounds, finite arrays."""

from typing import Any

import numpy as np

from jaxisp.errors import InputError as InputError
from jaxisp.params import Spec, specs


def check_finite(name: str, array: np.ndarray) -> np.ndarray:
    """Return `array`; raise InputError where it holds NaN or infinity."""
    bad = int((~np.isfinite(array)).sum())
    if bad:
        raise InputError(f"{name}: holds {bad} NaN or infinite values")
    return array


def check_params(params: dict[str, Any], *, batched: bool = True) -> dict[str, Any]:
    """Return `params` with float32 NumPy leaves, each within its bounds.

    Args:
        params: parameters by stage name; leaves are numbers or arrays.
        batched: whether a leaf may have one axis more than its spec.

    Raises:
        InputError: a value is NaN, out of bounds or of the wrong shape.
    """
    return {
        stage: type(values)(
            **{
                field: _check_value(f"{stage}.{field}", spec, getattr(values, field), batched)
                for field, spec in specs(type(values)).items()
            }
        )
        for stage, values in params.items()
    }


def _check_value(path: str, spec: Spec, value: Any, batched: bool) -> np.ndarray:
    array = np.asarray(value, np.float32)
    batch = array.ndim - len(spec.shape)
    if batch not in (0, int(batched)) or not (spec.any_length or array.shape[batch:] == spec.shape):
        raise InputError(f"{path}: shape {array.shape}, expected {spec.shape}")
    low, high = np.asarray(spec.bounds, np.float32)  # so that a value that stands on a bound passes
    if not ((array >= low) & (array <= high)).all():
        shown = np.array2string(array, precision=4, threshold=6)
        unit = "" if spec.unit == "1" else f" {spec.unit}"
        raise InputError(f"{path} = {shown} is outside [{spec.bounds[0]:g}, {spec.bounds[1]:g}]{unit}")
    return array
