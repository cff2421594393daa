"""Checks on the host: values within their bounds, finite arrays."""

import os
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.errors import InputError as InputError
from jaxisp.params import Spec, specs


def several(given: Any) -> tuple[Any, ...]:
    """What may be given alone as one of several: a text is one name, and not its letters."""
    alone = isinstance(given, str | os.PathLike) or not isinstance(given, Iterable)
    return (given,) if alone else tuple(given)


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
    _require_within(path, spec, array)
    return array


def check_known(params: dict[str, Any]) -> None:
    """Raise InputError where a value that the host knows is NaN or out of its bounds.

    Nothing is known of traced values, nor of those that other processes hold a part of. Values on a device
    are fetched, which waits for them.
    """
    known = [
        (f"{stage}.{field}", spec, value)
        for stage, values in params.items()
        for field, spec in specs(type(values)).items()
        if _is_known(value := getattr(values, field))
    ]
    for (path, spec, _), value in zip(known, jax.device_get([value for *_, value in known])):
        array = np.asarray(value)
        half = array.dtype.itemsize < 4 and jnp.issubdtype(array.dtype, jnp.floating)
        _require_within(path, spec, array if half else array.astype(np.float32, copy=False))


def check_count(params: dict[str, Any], count: int) -> None:
    """Raise InputError where a parameter has a value an image, and these are not so many images."""
    for stage, values in params.items():
        for field, spec in specs(type(values)).items():
            shape = np.shape(getattr(values, field))
            if len(shape) == len(spec.shape) + 1 and shape[0] != count:
                raise InputError(f"{stage}.{field} has {shape[0]} values, one an image, for {count} images")


def _is_known(value: Any) -> bool:
    if isinstance(value, jax.Array):
        return not isinstance(value, jax.core.Tracer) and value.is_fully_addressable
    return isinstance(value, bool | int | float | np.ndarray | np.generic)


def _require_within(path: str, spec: Spec, array: np.ndarray) -> None:
    low, high = np.asarray(spec.bounds, array.dtype)  # so that a value that stands on a bound passes
    if not ((array >= low) & (array <= high)).all():
        text = np.array2string(array.astype(np.float32, copy=False), precision=4, threshold=6)
        shown = " ".join(text.split())
        unit = "" if spec.unit == "1" else f" {spec.unit}"
        raise InputError(f"{path} = {shown} is outside [{spec.bounds[0]:g}, {spec.bounds[1]:g}]{unit}")
