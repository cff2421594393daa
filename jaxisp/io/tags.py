"""Tags of DNG and other TIFF-like RAW files, which LibRaw hides or rounds."""

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from jaxisp.io.calibration import Calibration, usable

CFA, LINEAR_RAW = 32803, 34892

# Tag numbers (TIFF 6, EXIF 2.3, DNG 1.4)
SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
MAKE, MODEL, STRIP_OFFSETS, ORIENTATION, SAMPLES, STRIP_COUNTS = 271, 272, 273, 274, 277, 279
TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, CFA_DIM, CFA_PATTERN = 324, 325, 339, 33421, 33422
EXPOSURE_TIME, EXIF, ISO, DNG_VERSION, PLANE_COLOR = 33434, 34665, 34855, 50706, 50710
BLACK_DIM, BLACK, BLACK_DELTA_H, BLACK_DELTA_V, WHITE = 50713, 50714, 50715, 50716, 50717
CROP_ORIGIN, CROP_SIZE, COLOR_MATRIX_1, COLOR_MATRIX_2 = 50719, 50720, 50721, 50722
CALIBRATION_1, CALIBRATION_2, ANALOG_BALANCE, NEUTRAL, WHITE_XY = 50723, 50724, 50727, 50728, 50729
BASELINE_EXPOSURE, ILLUMINANT_1, ILLUMINANT_2, ACTIVE_AREA = 50730, 50778, 50779, 50829
FORWARD_1, FORWARD_2, OPCODES_2, OPCODES_3, NOISE_PROFILE = 50964, 50965, 51009, 51022, 51041

_WANTED = {
    SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, MAKE, MODEL, STRIP_OFFSETS, ORIENTATION, SAMPLES,
    STRIP_COUNTS, TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, CFA_DIM, CFA_PATTERN, EXPOSURE_TIME, EXIF, ISO,
    DNG_VERSION, PLANE_COLOR, BLACK_DIM, BLACK, BLACK_DELTA_H, BLACK_DELTA_V, WHITE, CROP_ORIGIN, CROP_SIZE,
    COLOR_MATRIX_1, COLOR_MATRIX_2, CALIBRATION_1, CALIBRATION_2, ANALOG_BALANCE, NEUTRAL, WHITE_XY,
    BASELINE_EXPOSURE, ILLUMINANT_1, ILLUMINANT_2, ACTIVE_AREA, FORWARD_1, FORWARD_2, OPCODES_2, OPCODES_3,
    NOISE_PROFILE,
}  # fmt: skip

_SINGLE = {
    SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION, SAMPLES, SAMPLE_FORMAT,
}  # fmt: skip
"""Tags of one whole number, or of one a sample that are all the same."""
_MOST_VALUES = 1 << 24
_MOST_DIRECTORIES = 100


@dataclass(frozen=True)
class DngTags:
    """Tags of the first directory and of the one that holds the RAW pixels, by number."""

    main: dict[int, Any]
    raw: dict[int, Any]

    @property
    def is_dng(self) -> bool:
        return DNG_VERSION in self.main

    def get(self, code: int) -> Any:
        """The value in the RAW directory, else in the first; None where there is none."""
        return self.raw.get(code, self.main.get(code))

    def numbers(self, code: int, default: Any = None) -> np.ndarray | None:
        """The value as a flat float64 array."""
        value = self.get(code)
        if value is None:
            return None if default is None else np.atleast_1d(np.asarray(default, np.float64))
        return np.atleast_1d(np.asarray(value, np.float64)).ravel()

    def number(self, code: int, default: float | None = None) -> float | None:
        """The first element of the value."""
        values = self.numbers(code)
        return (
            default if values is None or not values.size or not np.isfinite(values[0]) else float(values[0])
        )

    def exif(self, name: str) -> float | None:
        """A positive number of the EXIF directory, else None."""
        table = self.main.get(EXIF)
        value = table.get(name) if isinstance(table, dict) else None
        if isinstance(value, tuple):
            value = value[0] / value[1] if len(value) == 2 and value[1] else value[0]
        return float(value) if isinstance(value, (int, float)) and value > 0 else None

    def calibration(self) -> Calibration | None:
        """The colour calibration; None where no ColorMatrix can be used."""
        first, second = self._matrix(COLOR_MATRIX_1), self._matrix(COLOR_MATRIX_2)
        slots = [i for i, matrix in enumerate((first, second)) if usable(matrix)]
        if not slots:
            return None
        forward = [self._matrix((FORWARD_1, FORWARD_2)[i]) for i in slots]
        camera = [self._matrix((CALIBRATION_1, CALIBRATION_2)[i]) for i in slots]
        balance = self.numbers(ANALOG_BALANCE, (1.0, 1.0, 1.0))
        balance_ok = balance is not None and balance.shape == (3,) and (balance > 0).all()
        return Calibration(
            tuple(int(self.number((ILLUMINANT_1, ILLUMINANT_2)[i], 0) or 0) for i in slots),
            np.stack([(first, second)[i] for i in slots]),  # type: ignore[misc]
            np.stack(forward) if all(usable(m) for m in forward) else None,  # type: ignore[arg-type]
            np.stack([m if m is not None and usable(m) else np.eye(3) for m in camera]),
            balance if balance_ok and balance is not None else np.ones(3),
        )

    def _matrix(self, code: int) -> np.ndarray | None:
        values = self.numbers(code)
        return values.reshape(3, 3) if values is not None and values.size == 9 else None


@contextlib.contextmanager
def quiet_tifffile() -> Iterator[None]:
    """Keep tifffile from logging: what is wrong is told once, by an InputError."""
    logger = logging.getLogger("tifffile")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def read_tags(path: Path) -> DngTags | None:
    """The tags of a TIFF-like file; None where tifffile cannot read it as one."""
    try:
        with quiet_tifffile(), tifffile.TiffFile(path) as tif:
            pages = list(_walk(tif.pages, set()))
            directories = [{t.code: _value(t) for t in page.tags if t.code in _WANTED} for page in pages]
    except Exception:  # a parser on arbitrary bytes: any error means the same
        return None
    if not directories:
        return None
    return DngTags(directories[0], max(directories, key=_rawness))


def _walk(pages: Any, seen: set[int]) -> Iterator[Any]:
    """The directories of a file and those within them.

    Raises:
        ValueError: one leads back to another, or there are more than any file has.
    """
    for page in pages:
        if page.offset in seen or len(seen) > _MOST_DIRECTORIES:
            raise ValueError("directories that lead back to others")
        seen.add(page.offset)
        yield page
        if getattr(page, "pages", None):
            yield from _walk(page.pages, seen)


def _value(tag: Any) -> Any:
    """The value in the type that its tag has by the standard; rationals are divided out.

    Raises:
        ValueError: it is of another type, which only a damaged file has.
    """
    if tag.count > _MOST_VALUES:
        raise ValueError(f"{tag.count} values")
    value = tag.value
    if tag.code in (MAKE, MODEL):
        return value if isinstance(value, str) else ""
    if tag.code == EXIF:
        return value if isinstance(value, dict) else {}
    if tag.code in (CFA_PATTERN, PLANE_COLOR, OPCODES_2, OPCODES_3, DNG_VERSION):
        return value if isinstance(value, bytes) else bytes(np.atleast_1d(value).tolist())
    if isinstance(value, bytes):
        value = np.frombuffer(value, np.uint8)
    numbers = np.atleast_1d(np.asarray(value, np.float64)).ravel()
    if tag.dtype in (5, 10):
        top, bottom = numbers[0::2], numbers[1::2]
        numbers = np.divide(top, bottom, out=np.full(len(bottom), np.nan), where=bottom != 0)
    if tag.code not in _SINGLE:
        return numbers
    if not (numbers.size and 0 <= numbers[0] < 1 << 32):
        raise ValueError("no whole number")
    return int(numbers[0])


def _rawness(tags: dict[int, Any]) -> tuple[bool, bool, int]:
    """Orders directories: RAW pixels before others, full resolution before reduced, then the larger."""
    is_raw = tags.get(PHOTOMETRIC) in (CFA, LINEAR_RAW)
    return is_raw, tags.get(SUBFILE, 0) == 0, tags.get(WIDTH, 0) * tags.get(HEIGHT, 0)
