"""Checks on the host: values within their bounds, finite arrays."""

import math
import os
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.domains import ENCODED, ENCODED_PROPHOTO, YCC, Domain
from jaxisp.errors import InputError as InputError
from jaxisp.errors import short
from jaxisp.params import Spec, specs

LAST_INDEX = 2**31 - 1
"""Of samples."""
FAR = 16.0
"""A level that no encoded picture has whose white is 1, sharpened or not."""
_LOOKED_AT = 1 << 16


def several(given: Any) -> tuple[Any, ...]:
    """What may be given alone as one of several: a text is one name, and not its letters."""
    alone = isinstance(given, str | os.PathLike) or not isinstance(given, Iterable)
    return (given,) if alone else tuple(given)


def check_whole(name: str, value: Any, least: int) -> None:
    """Raise InputError where a value is no whole number, or below the least that it may be."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name} must be a whole number from {least} on, got {short(value)}")


def check_seed(value: Any) -> None:
    """Raise InputError where a value is no seed: a whole number of 32 bits; two of more may make one key."""
    check_whole("seed", value, 0)
    if value >= 1 << 32:
        raise InputError(f"seed = {value}: seeds go from 0 to {(1 << 32) - 1}")


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
    """Raise InputError where a value is no number, or one that the host knows is NaN or out of its bounds.

    Nothing is known of traced values, nor of those that other processes hold a part of. Values on a device
    are fetched, which waits for them.
    """
    known = [
        (f"{stage}.{field}", spec, value)
        for stage, values in params.items()
        for field, spec in specs(type(values)).items()
        if _is_known(f"{stage}.{field}", value := getattr(values, field))
    ]
    for (path, spec, _), value in zip(known, jax.device_get([value for *_, value in known])):
        array = np.asarray(value)
        half = array.dtype.itemsize < 4 and jnp.issubdtype(array.dtype, jnp.floating)
        _require_within(path, spec, array if half else array.astype(np.float32, copy=False))


def check_count(params: dict[str, Any], count: int) -> None:
    """Raise InputError where a parameter has a value an image, and these are not so many images; or where its
    shape is neither its own nor that of one an image."""
    for stage, values in params.items():
        for field, spec in specs(type(values)).items():
            shape = np.shape(getattr(values, field))
            more = len(shape) - len(spec.shape)
            if more not in (0, 1):
                raise InputError(
                    f"{stage}.{field} has the shape {shape}, expected {spec.shape}, or one an image"
                )
            if more and shape[0] != count:
                raise InputError(f"{stage}.{field} has {shape[0]} values, one an image, for {count} images")


def check_key(who: str, key: Any) -> None:
    """Raise TypeError where something else stands in the place of one JAX key, new or raw."""
    advice = f"{who} takes a JAX key, as jax.random.key(0)"
    if not isinstance(key, jax.Array | np.ndarray):
        raise TypeError(f"{advice}, got {short(key)}")
    typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    if not typed and not (key.dtype == np.uint32 and key.ndim):
        raise TypeError(f"{advice}, got {key.dtype}{list(key.shape)}")
    if many := key.shape if typed else key.shape[:-1]:
        raise TypeError(
            f"{advice}, got {many[0]} keys: give one; each image's own follows from it and its index"
        )


def check_start(start: Any, count: int) -> Any:
    """`start` in int32, which JAX would wrap a larger one into; what is on the device already is as it is.

    Raises:
        ValueError: it is neither an index nor one for each of `count` images, or an image would have none.
    """
    if isinstance(start, jax.Array):
        return start
    given, asked = np.asarray(start), "give the index of the first image, or one for each of the"
    if not (np.issubdtype(given.dtype, np.integer) and given.shape in ((), (count,))):
        raise ValueError(f"start = {short(start)}: {asked} {count}, from 0 to {LAST_INDEX}")
    last = int(given) + max(count - 1, 0) if given.ndim == 0 else int(given.max(initial=0))
    if given.min(initial=0) < 0 or last > LAST_INDEX:
        what = f"the last of {count} images would have the index {last}" if last > LAST_INDEX else "below 0"
        raise ValueError(f"start = {short(start)}: {what}; indices go from 0 to {LAST_INDEX}")
    return given.astype(np.int32)


def check_scale(who: str, domain: Domain, images: Any) -> None:
    """Raise what is wrong with pictures on the host: TypeError for no array, InputError for a scale of 8 or
    more bits where a pipeline takes encoded pictures, whose white is 1.

    Linear light and mosaics may be on any scale. Some of the pixels are looked at, which takes no time.
    Nothing is known of pictures that are traced, still being computed, or on another device.
    """
    if not hasattr(images, "dtype"):
        raise TypeError(f"{who} takes an array, got {type(images).__name__}")
    if domain not in (ENCODED, ENCODED_PROPHOTO, YCC) or not _is_at_hand(images) or images.ndim < 3:
        return
    step = max(1, math.isqrt(images.size // _LOOKED_AT))
    some = np.asarray(images)[..., ::step, ::step, :]
    if some.size and some.dtype.kind == "f" and (high := float(some.max())) > FAR:  # not so where it is NaN
        raise InputError(
            f"{who} takes {domain.name}, whose white is 1, got levels up to {high:g}: divide 8 bits by 255"
        )


def _is_at_hand(images: Any) -> bool:
    if not isinstance(images, jax.Array):
        return isinstance(images, np.ndarray)
    if isinstance(images, jax.core.Tracer) or len(images.devices()) > 1 or not images.is_ready():  # type: ignore[attr-defined]
        return False
    return all(device.platform == "cpu" for device in images.devices())


def expected(spec: Spec) -> str:
    """What a parameter may be, to say where it is something else."""
    unit = "" if spec.unit in ("1", "switch") else f" {spec.unit}"
    what = (
        "a number" if not spec.shape else "numbers" if spec.any_length else f"numbers of shape {spec.shape}"
    )
    return f"{what} from {spec.bounds[0]:g} to {spec.bounds[1]:g}{unit}"


def _is_known(path: str, value: Any) -> bool:
    if isinstance(value, list | tuple):
        known = [_is_known(path, own) for own in value]  # each is looked at: none may be a text
        if len({np.shape(own) for own in value}) > 1:
            raise InputError(f"{path} must be a number or an array, got {short(value)}")
        return all(known)
    if isinstance(value, jax.Array):
        return not isinstance(value, jax.core.Tracer) and value.is_fully_addressable
    if isinstance(value, np.ndarray | np.generic):
        real = value.dtype.kind in "iub" or jnp.issubdtype(value.dtype, jnp.floating)
    else:
        real = isinstance(value, bool | int | float)
    if not real:
        drawn = ": a distribution, which Recipe.draw draws from" if hasattr(value, "support") else ""
        raise InputError(f"{path} must be a number or an array, got {short(value)}{drawn}")
    return True


def _require_within(path: str, spec: Spec, array: np.ndarray) -> None:
    low, high = np.asarray(spec.bounds, array.dtype)  # so that a value that stands on a bound passes
    if not ((array >= low) & (array <= high)).all():
        text = np.array2string(array.astype(np.float32, copy=False), precision=4, threshold=6)
        shown = " ".join(text.split())
        unit = "" if spec.unit == "1" else f" {spec.unit}"
        raise InputError(f"{path} = {shown} is outside [{spec.bounds[0]:g}, {spec.bounds[1]:g}]{unit}")
