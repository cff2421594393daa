"""What the tags of a DNG state about its pixels, and what must hold before LibRaw opens them."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.io import tags as tag
from jaxisp.io.calibration import Calibration, neutral_of
from jaxisp.io.files import check_pixels
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, WarpRectilinear, parse_opcodes
from jaxisp.io.tags import DngTags

_JPEG_XL = 52546


def check_dng(tags: DngTags, path: Path) -> None:
    """Raise InputError where the RAW pixels are not one whole Bayer mosaic of integers."""
    raw = tags.raw
    kind, samples = raw.get(tag.PHOTOMETRIC), raw.get(tag.SAMPLES, 1)
    if kind == tag.LINEAR_RAW and samples == 1:
        raise InputError(f"{path}: is a monochrome RAW, expected a Bayer mosaic")
    if kind == tag.LINEAR_RAW:
        raise InputError(f"{path}: is a linear (already demosaicked) DNG, expected a Bayer mosaic")
    if kind != tag.CFA:
        raise InputError(f"{path}: holds no RAW pixels, expected a DNG with a Bayer mosaic")
    _check_size(raw, path)
    pattern = raw.get(tag.CFA_PATTERN, b"")
    if tuple(raw.get(tag.CFA_DIM, ())) != (2, 2) or sorted(pattern) != [0, 1, 1, 2]:
        dims = "x".join(f"{n:g}" for n in raw.get(tag.CFA_DIM, ())) or "unknown"
        raise InputError(f"{path}: has a colour filter array that is not Bayer ({dims} cell)")
    if raw.get(tag.PLANE_COLOR, b"\0\1\2") != b"\0\1\2":
        raise InputError(f"{path}: has a colour filter array that is not red, green and blue")
    if raw.get(tag.SAMPLE_FORMAT) == 3:
        raise InputError(f"{path}: holds floating-point RAW pixels, expected integers")
    if raw.get(tag.COMPRESSION) == _JPEG_XL:
        raise InputError(
            f"{path}: is compressed with JPEG XL, which LibRaw does not read; expected a lossless DNG"
        )
    _check_whole(raw, path)


def _check_size(raw: dict[int, Any], path: Path) -> None:
    width, height = raw.get(tag.WIDTH, 0), raw.get(tag.HEIGHT, 0)
    check_pixels(width, height, path.stat().st_size, str(path), bytes_each=2)
    if min(width, height) < 2:
        raise InputError(f"{path}: says it is {width} x {height} pixels; it is damaged")


def _check_whole(raw: dict[int, Any], path: Path) -> None:
    """LibRaw leaves missing rows black without a word: so compare the file's size with what it says."""
    tiled = tag.TILE_OFFSETS in raw
    none = np.zeros(0)
    offsets = raw.get(tag.TILE_OFFSETS if tiled else tag.STRIP_OFFSETS, none)
    counts = raw.get(tag.TILE_COUNTS if tiled else tag.STRIP_COUNTS, none)
    if not offsets.size or offsets.shape != counts.shape or not np.isfinite(offsets + counts).all():
        raise InputError(f"{path}: is damaged (no strips or tiles of RAW pixels)")
    needed, size = int((offsets.astype(np.int64) + counts.astype(np.int64)).max()), path.stat().st_size
    if needed > size:
        raise InputError(f"{path}: is truncated: {size} bytes of at least {needed}")
    pixels, bits = raw[tag.WIDTH] * raw[tag.HEIGHT], raw.get(tag.BITS, 16)
    if raw.get(tag.COMPRESSION, 1) == 1 and int(counts.sum()) * 8 < pixels * bits:
        raise InputError(
            f"{path}: is damaged: {int(counts.sum())} bytes of RAW pixels for {pixels} of {bits} bits"
        )


def active_area(tags: DngTags, path: Path) -> tuple[int, int, int, int]:
    """Top, left, bottom, right of the pixels that see light, in the whole frame."""
    height, width = tags.raw[tag.HEIGHT], tags.raw[tag.WIDTH]
    area = tags.numbers(tag.ACTIVE_AREA, (0, 0, height, width))
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
    origin, size = tags.numbers(tag.CROP_ORIGIN, (0, 0)), tags.numbers(tag.CROP_SIZE, shape[::-1])
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
    dims = tags.numbers(tag.BLACK_DIM, (1, 1))
    cell = tags.numbers(tag.BLACK, 0.0)
    assert dims is not None and cell is not None
    if dims.size != 2 or dims.min() < 1 or dims.max() > 64 or cell.size != dims.prod():
        raise InputError(f"{path}: has a damaged BlackLevel")
    rows, columns = (int(v) for v in dims)
    repeats = -(-shape[0] // rows), -(-shape[1] // columns)
    black = np.tile(cell.reshape(rows, columns).astype(np.float32), repeats)[: shape[0], : shape[1]]
    for code, axis in ((tag.BLACK_DELTA_H, 1), (tag.BLACK_DELTA_V, 0)):
        delta = tags.numbers(code)
        if delta is not None and delta.size == shape[axis]:
            black = black + np.expand_dims(delta.astype(np.float32), 1 - axis)
    if not np.isfinite(black).all():
        raise InputError(f"{path}: has a damaged BlackLevel")
    return black


def noise_profile(tags: DngTags) -> np.ndarray | None:
    """(3, 2): shot and read of R, G, B in `shot * x + read**2`; None where the file states none."""
    values = tags.numbers(tag.NOISE_PROFILE)
    if values is None or values.size not in (2, 6) or not np.isfinite(values).all():
        return None
    shot, variance = np.broadcast_to(values.reshape(-1, 2), (3, 2)).T
    return np.stack([np.maximum(shot, 0), np.sqrt(np.maximum(variance, 0))], axis=1)


def lens(tags: DngTags, path: Path) -> dict[str, Any]:
    """Gain maps, warp and vignetting of the opcode lists."""
    before, after = (
        parse_opcodes(tags.get(code) or b"\0\0\0\0", str(path)) for code in (tag.OPCODES_2, tag.OPCODES_3)
    )
    return {
        "gain_map": tuple(o for o in before if isinstance(o, GainMap)) or None,
        "warp": next((o for o in after if isinstance(o, WarpRectilinear)), None),
        "vignette": next((o for o in after if isinstance(o, FixVignetteRadial)), None),
    }


def neutral(tags: DngTags, calibration: Calibration | None, as_shot: np.ndarray) -> np.ndarray:
    """What the camera saw of grey, green 1: from the tags, else from LibRaw's gains."""
    stated, xy = tags.numbers(tag.NEUTRAL), tags.numbers(tag.WHITE_XY)
    if stated is not None and stated.size == 3 and np.isfinite(stated).all() and stated.min() > 0:
        return stated / stated[1]
    if calibration is not None and xy is not None and xy.size == 2 and np.isfinite(xy).all() and xy.min() > 0:
        seen = neutral_of(calibration, xy)
        if seen.min() > 0:
            return seen
    return 1 / as_shot


def header(tags: DngTags) -> dict[str, Any]:
    """What any TIFF-like RAW states in its first directory."""
    orientation = tags.main.get(tag.ORIENTATION, 1)
    return {
        "orientation": orientation if 1 <= orientation <= 8 else 1,
        "iso": tags.number(tag.ISO) or tags.exif("ISOSpeedRatings") or tags.exif("PhotographicSensitivity"),
        "exposure_time": tags.number(tag.EXPOSURE_TIME) or tags.exif("ExposureTime"),
        "make": str(tags.main.get(tag.MAKE, "")).strip(),
        "model": str(tags.main.get(tag.MODEL, "")).strip(),
    }
