"""Tags of DNG and other TIFF-like RAW files: what LibRaw hides or rounds, and checks before it opens them."""

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from jaxisp.errors import InputError
from jaxisp.io.calibration import Calibration, neutral_of, usable
from jaxisp.io.files import check_pixels
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, WarpRectilinear, parse_opcodes

CFA, _LINEAR_RAW = 32803, 34892
_JPEG_XL = 52546

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
            pages = list(_walk(tif.pages))
            directories = [{t.code: _value(t) for t in page.tags if t.code in _WANTED} for page in pages]
    except Exception:  # a parser on arbitrary bytes: any error means the same
        return None
    if not directories:
        return None
    return DngTags(directories[0], max(directories, key=_rawness))


def _walk(pages: Any) -> Iterator[Any]:
    for page in pages:
        yield page
        if getattr(page, "pages", None):
            yield from _walk(page.pages)


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
    is_raw = tags.get(PHOTOMETRIC) in (CFA, _LINEAR_RAW)
    return is_raw, tags.get(SUBFILE, 0) == 0, tags.get(WIDTH, 0) * tags.get(HEIGHT, 0)


def check_dng(tags: DngTags, path: Path) -> None:
    """Raise InputError where the RAW pixels are not one whole Bayer mosaic of integers."""
    raw = tags.raw
    kind, samples = raw.get(PHOTOMETRIC), raw.get(SAMPLES, 1)
    if kind == _LINEAR_RAW and samples == 1:
        raise InputError(f"{path}: is a monochrome RAW, expected a Bayer mosaic")
    if kind == _LINEAR_RAW:
        raise InputError(f"{path}: is a linear (already demosaicked) DNG, expected a Bayer mosaic")
    if kind != CFA:
        raise InputError(f"{path}: holds no RAW pixels, expected a DNG with a Bayer mosaic")
    _check_size(raw, path)
    pattern = raw.get(CFA_PATTERN, b"")
    if tuple(raw.get(CFA_DIM, ())) != (2, 2) or sorted(pattern) != [0, 1, 1, 2]:
        dims = "x".join(f"{n:g}" for n in raw.get(CFA_DIM, ())) or "unknown"
        raise InputError(f"{path}: has a colour filter array that is not Bayer ({dims} cell)")
    if raw.get(PLANE_COLOR, b"\0\1\2") != b"\0\1\2":
        raise InputError(f"{path}: has a colour filter array that is not red, green and blue")
    if raw.get(SAMPLE_FORMAT) == 3:
        raise InputError(f"{path}: holds floating-point RAW pixels, expected integers")
    if raw.get(COMPRESSION) == _JPEG_XL:
        raise InputError(
            f"{path}: is compressed with JPEG XL, which LibRaw does not read; expected a lossless DNG"
        )
    _check_whole(raw, path)


def _check_size(raw: dict[int, Any], path: Path) -> None:
    width, height = raw.get(WIDTH, 0), raw.get(HEIGHT, 0)
    check_pixels(width, height, path.stat().st_size, str(path), bytes_each=2)
    if min(width, height) < 2:
        raise InputError(f"{path}: says it is {width} x {height} pixels; it is damaged")


def _check_whole(raw: dict[int, Any], path: Path) -> None:
    """LibRaw leaves missing rows black without a word: so compare the file's size with what it says."""
    tiled = TILE_OFFSETS in raw
    none = np.zeros(0)
    offsets = raw.get(TILE_OFFSETS if tiled else STRIP_OFFSETS, none)
    counts = raw.get(TILE_COUNTS if tiled else STRIP_COUNTS, none)
    if not offsets.size or offsets.shape != counts.shape:
        raise InputError(f"{path}: is damaged (no strips or tiles of RAW pixels)")
    needed, size = int((offsets.astype(np.int64) + counts.astype(np.int64)).max()), path.stat().st_size
    if needed > size:
        raise InputError(f"{path}: is truncated: {size} bytes of at least {needed}")
    pixels, bits = raw[WIDTH] * raw[HEIGHT], raw.get(BITS, 16)
    if raw.get(COMPRESSION, 1) == 1 and int(counts.sum()) * 8 < pixels * bits:
        raise InputError(
            f"{path}: is damaged: {int(counts.sum())} bytes of RAW pixels for {pixels} of {bits} bits"
        )


def active_area(tags: DngTags, path: Path) -> tuple[int, int, int, int]:
    """Top, left, bottom, right of the pixels that see light, in the whole frame."""
    height, width = tags.raw[HEIGHT], tags.raw[WIDTH]
    area = tags.numbers(ACTIVE_AREA, (0, 0, height, width))
    if area is None or area.size != 4 or not np.isfinite(area).all():
        raise InputError(f"{path}: has a damaged ActiveArea")
    top, left, bottom, right = (int(v) for v in area)
    if not (0 <= top < bottom <= height and 0 <= left < right <= width):
        raise InputError(
            f"{path}: has an ActiveArea {top, left, bottom, right} outside its {width} x {height} pixels"
        )
    return top, left, bottom, right


def default_crop(tags: DngTags, shape: tuple[int, int], path: Path) -> tuple[int, int, int, int]:
    """Top, left, height, width of the picture within the active area, cut where it would leave it."""
    origin, size = tags.numbers(CROP_ORIGIN, (0, 0)), tags.numbers(CROP_SIZE, shape[::-1])
    if origin is None or size is None or origin.size != 2 or size.size != 2:
        raise InputError(f"{path}: has a damaged DefaultCrop")
    if not (np.isfinite(origin).all() and np.isfinite(size).all() and (origin >= 0).all()):
        raise InputError(f"{path}: has a damaged DefaultCrop")
    left, top = (int(v) for v in np.rint(origin))
    width, height = (int(v) for v in np.rint(size))
    height, width = min(height, shape[0] - top), min(width, shape[1] - left)
    if min(height, width) < 2:
        raise InputError(
            f"{path}: has a DefaultCrop outside its active area of {shape[1]} x {shape[0]} pixels"
        )
    return top, left, height, width


def black_levels(tags: DngTags, shape: tuple[int, int], path: Path) -> np.ndarray:
    """(H, W) float32 black level of the active area: the repeated cell, plus row and column terms."""
    dims = tags.numbers(BLACK_DIM, (1, 1))
    cell = tags.numbers(BLACK, 0.0)
    assert dims is not None and cell is not None
    if dims.size != 2 or dims.min() < 1 or dims.max() > 64 or cell.size != dims.prod():
        raise InputError(f"{path}: has a damaged BlackLevel")
    rows, columns = (int(v) for v in dims)
    repeats = -(-shape[0] // rows), -(-shape[1] // columns)
    black = np.tile(cell.reshape(rows, columns).astype(np.float32), repeats)[: shape[0], : shape[1]]
    for code, axis in ((BLACK_DELTA_H, 1), (BLACK_DELTA_V, 0)):
        delta = tags.numbers(code)
        if delta is not None and delta.size == shape[axis]:
            black = black + np.expand_dims(delta.astype(np.float32), 1 - axis)
    if not np.isfinite(black).all():
        raise InputError(f"{path}: has a damaged BlackLevel")
    return black


def noise_profile(tags: DngTags) -> np.ndarray | None:
    """(3, 2): shot and read of R, G, B in `shot * x + read**2`; None where the file states none."""
    values = tags.numbers(NOISE_PROFILE)
    if values is None or values.size not in (2, 6) or not np.isfinite(values).all():
        return None
    shot, variance = np.broadcast_to(values.reshape(-1, 2), (3, 2)).T
    return np.stack([np.maximum(shot, 0), np.sqrt(np.maximum(variance, 0))], axis=1)


def lens(tags: DngTags, path: Path) -> dict[str, Any]:
    """Gain maps, warp and vignetting of the opcode lists."""
    before, after = (
        parse_opcodes(tags.get(code) or b"\0\0\0\0", str(path)) for code in (OPCODES_2, OPCODES_3)
    )
    return {
        "gain_map": tuple(o for o in before if isinstance(o, GainMap)) or None,
        "warp": next((o for o in after if isinstance(o, WarpRectilinear)), None),
        "vignette": next((o for o in after if isinstance(o, FixVignetteRadial)), None),
    }


def neutral(tags: DngTags, calibration: Calibration | None, as_shot: np.ndarray) -> np.ndarray:
    """What the camera saw of grey, green 1: from the tags, else from LibRaw's gains."""
    stated, xy = tags.numbers(NEUTRAL), tags.numbers(WHITE_XY)
    if stated is not None and stated.size == 3 and np.isfinite(stated).all() and stated.min() > 0:
        return stated / stated[1]
    if calibration is not None and xy is not None and xy.size == 2 and np.isfinite(xy).all() and xy.min() > 0:
        seen = neutral_of(calibration, xy)
        if seen.min() > 0:
            return seen
    return 1 / as_shot


def header(tags: DngTags) -> dict[str, Any]:
    """What any TIFF-like RAW states in its first directory."""
    orientation = tags.main.get(ORIENTATION, 1)
    return {
        "orientation": orientation if 1 <= orientation <= 8 else 1,
        "iso": tags.number(ISO) or tags.exif("ISOSpeedRatings") or tags.exif("PhotographicSensitivity"),
        "exposure_time": tags.number(EXPOSURE_TIME) or tags.exif("ExposureTime"),
        "make": str(tags.main.get(MAKE, "")).strip(),
        "model": str(tags.main.get(MODEL, "")).strip(),
    }
