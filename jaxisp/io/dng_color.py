"""What the tags of a DNG state about its colours: the calibration, and what grey looked like."""

import struct
from collections.abc import Callable

import numpy as np

from jaxisp.io import tags as tag
from jaxisp.io.calibration import Calibration, Light, is_known, neutral_of, usable
from jaxisp.io.observer import spectrum_xy
from jaxisp.io.tags import DngTags

Tell = Callable[[str], None]
"""Takes one line on what a file states that is not used, or used otherwise than it says."""

_OTHER = 255  # LightSource: see IlluminantData
_BALANCE_RANGE = 1 / 16, 16.0  # gains of a converter: cameras state 1, or nearly
_MOST_GAIN = 1e3  # of one colour against another
_MOST_SAMPLES = 1000  # of a spectrum, by the specification


def calibration(tags: DngTags, tell: Tell) -> Calibration | None:
    """The colour calibration; None where no ColorMatrix can be used."""
    colors = [tags.matrix(code) for code in tag.COLOR_MATRICES]
    slots = [i for i, matrix in enumerate(colors) if usable(matrix)]
    if not slots:
        stated = any(tags.get(code) is not None for code in tag.COLOR_MATRICES)
        own = "its ColorMatrix cannot be used" if stated else "it states no ColorMatrix"
        tell(f"{own}: colours stay the camera's")
        return None
    balance = tags.numbers(tag.ANALOG_BALANCE, (1.0, 1.0, 1.0))
    least, most = _BALANCE_RANGE
    if balance is None or balance.shape != (3,) or not ((balance >= least) & (balance <= most)).all():
        tell(f"its AnalogBalance is not three numbers from {least:g} to {most:g} and is not used")
        balance = np.ones(3)
    lights = tuple(_illuminant(tags, i, tell) for i in slots)
    unknown = [f"ColorMatrix{i + 1}" for i, light in zip(slots, lights) if not is_known(light)]
    if unknown and len(slots) > 1:
        few = len(slots) - len(unknown) < 2
        used = f"ColorMatrix{slots[0] + 1} alone is used" if few else "the others are used"
        tell(f"the light of its {' and '.join(unknown)} is unknown: {used}")
    return Calibration(
        lights,
        np.stack([matrix for matrix in (colors[i] for i in slots) if matrix is not None]),
        _forward(tags, slots),
        np.stack([_camera(tags, i, tell) for i in slots]),
        balance,
    )


def _forward(tags: DngTags, slots: list[int]) -> list[np.ndarray | None] | None:
    """Those of the lights; else the one that there is, whatever its light."""
    every = [tags.matrix(code) for code in tag.FORWARDS]
    good = [matrix if usable(matrix) else None for matrix in every]
    own = [good[i] for i in slots]
    if all(matrix is None for matrix in own):
        alone = next((matrix for matrix in good if matrix is not None), None)
        return None if alone is None else [alone] * len(slots)
    return own


def _camera(tags: DngTags, index: int, tell: Tell) -> np.ndarray:
    """CameraCalibration counts only beside a profile for which it was made."""
    matrix = tags.matrix(tag.CALIBRATIONS[index])
    ours, theirs = (tags.get(c) or b"" for c in (tag.CALIBRATION_SIGNATURE, tag.PROFILE_SIGNATURE))
    if matrix is None or np.array_equal(matrix, np.eye(3)):
        return np.eye(3)
    if ours != theirs:
        tell(f"its CameraCalibration{index + 1} is for another profile (its signatures differ): not used")
        return np.eye(3)
    if not usable(matrix):
        tell(f"its CameraCalibration{index + 1} cannot be used")
        return np.eye(3)
    return matrix


def _illuminant(tags: DngTags, index: int, tell: Tell) -> Light:
    """A chromaticity where the code says that it is stated, else the code."""
    stated = tags.numbers(tag.ILLUMINANTS[index], 0)
    code = stated[0] if stated is not None and stated.size else 0
    data = tags.get(tag.ILLUMINANT_DATA[index])
    if code != _OTHER or data is None:
        light = int(code) if is_known(code) else 0
        if not light and code not in (0, _OTHER):
            tell(f"its CalibrationIlluminant{index + 1} of {code:g} is no light source: taken as unknown")
        return light
    try:
        xy = _chromaticity(data, tags.byteorder)
        if not (np.isfinite(xy).all() and xy.min() > 0 and xy.sum() < 1):
            raise ValueError(f"the chromaticity {xy[0]:g}, {xy[1]:g}")
    except (struct.error, ValueError) as error:
        tell(f"its IlluminantData{index + 1} cannot be used ({error})")
        return 0
    return float(xy[0]), float(xy[1])


def _chromaticity(data: bytes, order: str) -> np.ndarray:
    """x, y of IlluminantData: type 0 states them, type 1 a spectrum.

    Source: Digital Negative specification 1.7.1, IlluminantData1.
    """
    (kind,) = struct.unpack_from(f"{order}H", data)
    if kind == 0:
        return _rationals(data, 2, 2, order)
    if kind != 1:
        raise ValueError(f"type {kind}, expected 0 or 1")
    (count,) = struct.unpack_from(f"{order}L", data, 2)
    if not 2 <= count <= _MOST_SAMPLES:
        raise ValueError(f"a spectrum of {count} samples")
    first, step, *power = _rationals(data, 6, count + 2, order)
    if not (first > 0 and step > 0 and np.isfinite(power).all()):
        raise ValueError(f"a spectrum from {first:g} nm on in steps of {step:g} nm")
    return spectrum_xy(first, step, np.array(power))


def _rationals(data: bytes, at: int, count: int, order: str) -> np.ndarray:
    if len(data) < at + 8 * count:
        raise ValueError("cut short")
    pairs = np.frombuffer(data, f"{order}u4", 2 * count, at).astype(np.float64).reshape(-1, 2)
    return np.divide(pairs[:, 0], pairs[:, 1], out=np.full(count, np.nan), where=pairs[:, 1] > 0)


def neutral(tags: DngTags, calibration: Calibration | None, as_shot: np.ndarray, tell: Tell) -> np.ndarray:
    """What the camera saw of grey, green 1: from the tags, else from LibRaw's gains."""
    stated, xy = tags.numbers(tag.NEUTRAL), tags.numbers(tag.WHITE_XY)
    if stated is not None:
        if stated.size == 3 and np.isfinite(stated).all() and 0 < stated.max() < _MOST_GAIN * stated.min():
            return stated / stated[1]
        # phones write zeros beside a chromaticity
        if xy is None or np.nan_to_num(stated).any():
            tell("its AsShotNeutral is not three positive numbers of one size and is not used")
    if xy is not None:
        fine = xy.size == 2 and np.isfinite(xy).all() and xy.min() > 0 and xy.sum() < 1
        seen = neutral_of(calibration, xy) if calibration is not None and fine else np.zeros(3)
        if np.isfinite(seen).all() and seen.min() > 0:
            return seen
        tell("its AsShotWhiteXY gives no white balance and is not used")
    if stated is None and xy is None:
        tell("it states no white balance")
    return 1 / as_shot
