"""Tags of DNG and other TIFF-like RAW files, which LibRaw hides or rounds."""

import contextlib
import logging
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

CFA, LINEAR_RAW = 32803, 34892

# Tag numbers (TIFF 6, EXIF 2.3, DNG 1.7.1)
SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
MAKE, MODEL, STRIP_OFFSETS, ORIENTATION, SAMPLES, STRIP_ROWS, STRIP_COUNTS = 271, 272, 273, 274, 277, 278, 279
TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT = 322, 323, 324, 325, 339
CFA_DIM, CFA_PATTERN, EXPOSURE_TIME, EXIF, ISO = 33421, 33422, 33434, 34665, 34855
SENSITIVITIES = 34864, 34865, 34866, 34867
DNG_VERSION, BACKWARD_VERSION, PLANE_COLOR, CFA_LAYOUT, LINEARIZATION = 50706, 50707, 50710, 50711, 50712
BLACK_DIM, BLACK, BLACK_DELTA_H, BLACK_DELTA_V, WHITE = 50713, 50714, 50715, 50716, 50717
DEFAULT_SCALE, CROP_ORIGIN, CROP_SIZE, USER_CROP = 50718, 50719, 50720, 51125
COLOR_MATRICES, CALIBRATIONS, FORWARDS = (50721, 50722, 52531), (50723, 50724, 52530), (50964, 50965, 52532)
ILLUMINANTS, ILLUMINANT_DATA = (50778, 50779, 52529), (52533, 52534, 52535)
CALIBRATION_SIGNATURE, PROFILE_SIGNATURE = 50931, 50932
ANALOG_BALANCE, NEUTRAL, WHITE_XY, BASELINE_EXPOSURE, EXPOSURE_OFFSET = 50727, 50728, 50729, 50730, 51109
ACTIVE_AREA, SUB_TILE, ROW_INTERLEAVE, COLUMN_INTERLEAVE = 50829, 50974, 50975, 52547
COLORIMETRIC_REFERENCE, OPCODES_1, OPCODES_2, OPCODES_3, NOISE_PROFILE = 50879, 51008, 51009, 51022, 51041

GREEN_SPLIT, LINEAR_LIMIT, SHADOW_SCALE, BLACK_RENDER, DYNAMIC_RANGE = 50733, 50734, 50739, 51110, 52551
BEST_SCALE = 50780

STATED = {
    50830: "MaskedAreas", 50831: "AsShotICCProfile", 50833: "CurrentICCProfile",
    50938: "ProfileHueSatMap", 50939: "ProfileHueSatMap", 52537: "ProfileHueSatMap",
    50940: "ProfileToneCurve", 50982: "ProfileLookTable",
    52525: "ProfileGainTableMap", 52543: "RGBTables", 52544: "ProfileGainTableMap2",
}  # fmt: skip
"""What changes the look of a picture and is never applied: its value is not read, it is True where stated."""

_TEXT = {MAKE, MODEL, CALIBRATION_SIGNATURE, PROFILE_SIGNATURE}
_BYTES = {
    CFA_PATTERN, PLANE_COLOR, *ILLUMINANT_DATA, OPCODES_1, OPCODES_2, OPCODES_3, DNG_VERSION,
    BACKWARD_VERSION, DYNAMIC_RANGE,
}  # fmt: skip
_WANTED = {
    SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, STRIP_OFFSETS, ORIENTATION, SAMPLES, STRIP_ROWS,
    STRIP_COUNTS, TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, CFA_DIM, EXPOSURE_TIME,
    EXIF, ISO, *SENSITIVITIES,
    CFA_LAYOUT, LINEARIZATION, BLACK_DIM, BLACK, BLACK_DELTA_H, BLACK_DELTA_V, WHITE, DEFAULT_SCALE,
    CROP_ORIGIN, CROP_SIZE, USER_CROP, *COLOR_MATRICES, *CALIBRATIONS, *FORWARDS, *ILLUMINANTS,
    ANALOG_BALANCE, NEUTRAL, WHITE_XY, BASELINE_EXPOSURE, EXPOSURE_OFFSET, ACTIVE_AREA, SUB_TILE,
    ROW_INTERLEAVE, COLUMN_INTERLEAVE, COLORIMETRIC_REFERENCE, NOISE_PROFILE, GREEN_SPLIT,
    LINEAR_LIMIT, SHADOW_SCALE, BLACK_RENDER, BEST_SCALE, *STATED, *_TEXT, *_BYTES,
}  # fmt: skip

_SINGLE = {
    SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION, SAMPLES, SAMPLE_FORMAT, STRIP_ROWS,
    TILE_WIDTH, TILE_HEIGHT,
}  # fmt: skip
"""Tags of one whole number, or of one a sample that are all the same."""
_MOST_VALUES = 1 << 24
_MOST_DIRECTORIES = 100


@dataclass(frozen=True)
class DngTags:
    """Tags of the first directory and of the one that holds the RAW pixels, by number.

    `byteorder` is that of the file, "<" or ">"; `unread` are the numbers of tags that stand in either, and
    whose values do not, as in a file that was cut.
    """

    main: dict[int, Any]
    raw: dict[int, Any]
    byteorder: str = "<"
    unread: tuple[int, ...] = ()

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

    @property
    def exif(self) -> dict[int, Any]:
        """The EXIF directory; rationals are numerator and denominator."""
        return self.main.get(EXIF, {})

    def matrix(self, code: int) -> np.ndarray | None:
        """The value as (3, 3), where it has nine elements."""
        values = self.numbers(code)
        return values.reshape(3, 3) if values is not None and values.size == 9 else None


@contextlib.contextmanager
def quiet_tifffile() -> Iterator[None]:
    """Keep tifffile and its sums from logs and warnings: what is wrong is told once, by an InputError."""
    logger = logging.getLogger("tifffile")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        logger.setLevel(level)


def read_tags(path: Path) -> DngTags | None:
    """The tags of a TIFF-like file; None where tifffile cannot read it as one."""
    try:
        with quiet_tifffile(), tifffile.TiffFile(path) as tif:
            pages = list(_walk(tif.pages, set()))
            directories = [{t.code: _value(t) for t in page.tags if t.code in _WANTED} for page in pages]
            stated = [_codes(page) & _WANTED for page in pages]
            byteorder = tif.byteorder
    except Exception:  # a parser on arbitrary bytes: any error means the same
        return None
    if not directories:
        return None
    which = max(range(len(directories)), key=lambda i: _rawness(directories[i]))
    unread = {code for i in (0, which) for code in stated[i] - set(directories[i])}
    return DngTags(directories[0], directories[which], byteorder, tuple(sorted(unread)))


def _codes(page: Any) -> set[int]:
    """The numbers in a directory, of tags too that tifffile leaves out since it cannot read their values."""
    file, tiff = page.parent.filehandle, page.parent.tiff
    file.seek(page.offset)
    (count,) = struct.unpack(tiff.tagnoformat, file.read(tiff.tagnosize))
    entries = file.read(count * tiff.tagsize)
    places = range(0, len(entries) - 1, tiff.tagsize)
    return {struct.unpack_from(tiff.byteorder + "H", entries, place)[0] for place in places}


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
    if tag.code in STATED:
        return True
    if tag.code in _TEXT:
        return _text_bytes(tag)
    value = tag.value
    if tag.code == EXIF:
        return {_code(name): own for name, own in value.items()} if isinstance(value, dict) else {}
    if tag.code in _BYTES:
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


def _text_bytes(tag: Any) -> bytes:
    """Text as it stands in the file, up to its end; tifffile trims it, and guesses how it is coded."""
    if tag.dtype not in (1, 2, 7):
        return b""
    file = tag.parent.filehandle
    file.seek(tag.valueoffset)
    return file.read(tag.count).split(b"\0")[0]


def _code(name: str) -> Any:
    """The number of an EXIF tag, which tifffile calls by its name where it knows one."""
    return int(name) if name.isdecimal() else tifffile.TIFF.EXIF_TAGS.get(name, None)


def _rawness(tags: dict[int, Any]) -> tuple[bool, bool, int]:
    """Orders directories: RAW pixels before others, full resolution before reduced, then the larger."""
    is_raw = tags.get(PHOTOMETRIC) in (CFA, LINEAR_RAW)
    return is_raw, tags.get(SUBFILE, 0) == 0, tags.get(WIDTH, 0) * tags.get(HEIGHT, 0)
