"""LibRaw: opening a file, refusing what is no mosaic, and what it alone knows."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rawpy

from jaxisp.cfa import PATTERNS, is_xtrans, size
from jaxisp.errors import InputError
from jaxisp.io.files import PathLike, check_file, check_pixels, steady
from jaxisp.io.jpeg_frame import frame_header
from jaxisp.io.silence import silent_libraries


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """rawpy on the file; what LibRaw raises becomes one line."""
    try:
        with silent_libraries(), rawpy.imread(str(path)) as raw:
            yield raw
    except (rawpy.LibRawError, rawpy.NotSupportedError, NotImplementedError, MemoryError) as error:
        text = error.args[0] if error.args else type(error).__name__
        text = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        raise InputError(f"{path}: LibRaw cannot read it: {text.lower()}") from error


def check_mosaic(raw: Any, path: Path) -> None:
    """InputError where LibRaw says that its pixels are not of one colour each."""
    sizes = raw.sizes
    check_pixels(sizes.raw_width, sizes.raw_height, path.stat().st_size, str(path), bytes_each=2)
    if raw.num_colors == 1:
        raise InputError(f"{path}: is a monochrome RAW, expected a Bayer or X-Trans mosaic")
    if raw.raw_type != rawpy.RawType.Flat or raw.raw_image is None:
        raise InputError(
            f"{path}: holds full-colour pixels (linear, sRAW or Foveon), expected a Bayer or X-Trans mosaic"
        )


def check_pattern(raw: Any, path: Path) -> str:
    """The pattern of the visible area; InputError where LibRaw says it is neither Bayer nor X-Trans."""
    check_mosaic(raw, path)
    if raw.raw_pattern is None or raw.raw_pattern.shape not in ((2, 2), (6, 6)):
        raise InputError(f"{path}: has no 2x2 or 6x6 colour filter array, expected a Bayer or X-Trans mosaic")
    names = raw.color_desc.decode()
    cfa = "".join(names[i] for i in visible_pattern(raw).ravel())
    if cfa not in PATTERNS and not is_xtrans(cfa):
        raise InputError(
            f"{path}: has colour filters {cfa}, expected one of {', '.join(PATTERNS)} or X-Trans"
        )
    return cfa


def visible_pattern(raw: Any) -> np.ndarray:
    """The cell of LibRaw's colours from the top-left of the visible area.

    rawpy's `raw_pattern` is that of the whole frame, and wrong where an X-Trans frame has wide margins.
    """
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    rows, columns = raw.raw_pattern.shape
    return np.array([[raw.raw_color(top + y, left + x) for x in range(columns)] for y in range(rows)])


def check_cells(shape: tuple[int, int], cfa: str, path: Path) -> None:
    """InputError where a picture is smaller than the cell of its filters: some colour may be missing."""
    n = size(cfa)
    if min(shape) < n:
        raise InputError(f"{path}: is a mosaic of {shape[1]} x {shape[0]} pixels, expected {n} x {n} or more")


def camera_crop(sizes: Any) -> tuple[int, int, int, int]:
    """Top, left, height, width in the visible area of the camera's own crop, where that is sound."""
    top, left = sizes.crop_top_margin - sizes.top_margin, sizes.crop_left_margin - sizes.left_margin
    height, width = sizes.crop_height, sizes.crop_width
    inside = top >= 0 and left >= 0 and top + height <= sizes.height and left + width <= sizes.width
    if inside and 2 * height > sizes.height and 2 * width > sizes.width:
        return top, left, height, width
    return 0, 0, sizes.height, sizes.width


def white_gains(values: Any) -> np.ndarray:
    """LibRaw's multipliers with green 1; ones where it has none."""
    gains = np.array(values[:3], np.float64)
    return gains / gains[1] if np.isfinite(gains).all() and gains.min() > 0 else np.ones(3)


def embedded_jpeg(path: PathLike) -> bytes | None:
    """The JPEG inside a RAW file, where it has one that is as large as the picture; else None."""
    path = check_file(path)
    with steady(path), opened(path) as raw:
        try:
            thumb = raw.extract_thumb()
        except (rawpy.LibRawError, rawpy.NotSupportedError):
            return None
        size = sorted((raw.sizes.height, raw.sizes.width))
    if thumb.format != rawpy.ThumbFormat.JPEG:
        return None
    try:
        frame = frame_header(thumb.data)
    except ValueError:
        return None
    full = all(abs(a - b) <= 16 + b // 50 for a, b in zip(sorted((frame.height, frame.width)), size))
    return bytes(thumb.data) if full else None
