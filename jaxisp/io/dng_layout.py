"""How the RAW pixels of a DNG are laid out, and what must hold before LibRaw opens them."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxisp.errors import InputError
from jaxisp.io import tags as tag
from jaxisp.io.dng_color import Tell
from jaxisp.io.files import check_pixels
from jaxisp.io.jpeg_lossless import check_stream, ends_as
from jaxisp.io.quad import Filters, filters
from jaxisp.io.tags import DngTags

_NEWEST = (1, 7, 1, 0)
_UNCOMPRESSED, _JPEG, _DEFLATE, _PACKBITS, _LOSSY, _JPEG_XL = 1, 7, 8, 32773, 34892, 52546
_COMPRESSIONS = {
    _DEFLATE: "Deflate", 32946: "Deflate", 5: "LZW", _PACKBITS: "PackBits", 6: "old JPEG",
    _LOSSY: "lossy JPEG", _JPEG_XL: "JPEG XL",
}  # fmt: skip


def check_dng(tags: DngTags, path: Path, tell: Tell) -> None:
    """Raise InputError where the RAW pixels are not one whole mosaic of integers."""
    raw = tags.raw
    _check_version(tags, tell)
    kind, samples = raw.get(tag.PHOTOMETRIC), raw.get(tag.SAMPLES, 1)
    if kind == tag.LINEAR_RAW and samples == 1:
        raise InputError(f"{path}: is a monochrome RAW, expected a Bayer or X-Trans mosaic")
    if kind == tag.LINEAR_RAW:
        raise InputError(f"{path}: is a linear (already demosaicked) DNG, expected a Bayer or X-Trans mosaic")
    if kind != tag.CFA:
        raise InputError(f"{path}: holds no RAW pixels, expected a DNG with a mosaic")
    _check_size(raw, path)
    _check_filters(tags, path)
    if samples != 1:
        raise InputError(f"{path}: has {samples} samples a pixel, expected a mosaic of one")
    if raw.get(tag.SAMPLE_FORMAT) == 3:
        raise InputError(f"{path}: holds floating-point RAW pixels, expected integers")
    compression = raw.get(tag.COMPRESSION, _UNCOMPRESSED)
    if compression not in (_UNCOMPRESSED, _JPEG):
        name = _COMPRESSIONS.get(compression, f"compression {compression}")
        raise InputError(
            f"{path}: is compressed with {name}, which LibRaw does not read as a mosaic; "
            "expected a lossless DNG"
        )
    _check_whole(raw, path)


def _check_version(tags: DngTags, tell: Tell) -> None:
    needed = tags.get(tag.BACKWARD_VERSION) or tags.get(tag.DNG_VERSION) or b""
    if tuple(needed) > _NEWEST:
        text = ".".join(map(str, needed))
        tell(f"it asks for readers of DNG {text}; read as 1.7.1, the newest known here")


def _check_size(raw: dict[int, Any], path: Path) -> None:
    width, height = raw.get(tag.WIDTH, 0), raw.get(tag.HEIGHT, 0)
    check_pixels(width, height, path.stat().st_size, str(path), bytes_each=2)
    if min(width, height) < 2:
        raise InputError(f"{path}: says it is {width} x {height} pixels; it is damaged")


def _check_filters(tags: DngTags, path: Path) -> None:
    raw = tags.raw
    color_filters(tags, path)
    if raw.get(tag.PLANE_COLOR, b"\0\1\2") != b"\0\1\2":
        raise InputError(f"{path}: has a colour filter array that is not red, green and blue")
    if (layout := tags.number(tag.CFA_LAYOUT, 1)) != 1:
        raise InputError(f"{path}: has a staggered colour filter array (CFALayout {layout:g}), expected 1")
    block = tags.numbers(tag.SUB_TILE, (1, 1))
    if block is not None and not (block == 1).all():
        text = " x ".join(f"{n:g}" for n in block)
        raise InputError(f"{path}: stores its pixels in blocks of {text} (SubTileBlockSize), expected 1 x 1")


def color_filters(tags: DngTags, path: Path) -> Filters:
    """The pattern of the active area: Bayer, whose filters may cover several pixels, or X-Trans."""
    dims, pattern = tags.raw.get(tag.CFA_DIM, np.zeros(0)), tags.raw.get(tag.CFA_PATTERN, b"")
    found = None
    if dims.size == 2 and dims.min() >= 1 and len(pattern) == dims.prod() and max(pattern) <= 2:
        found = filters(np.array(list(pattern)).reshape(dims.astype(int)))
    if found is None:
        text = "x".join(f"{n:g}" for n in dims) or "unknown"
        raise InputError(f"{path}: has a colour filter array that is not Bayer or X-Trans ({text} cell)")
    return found


class Part(NamedTuple):
    """A strip or tile: its bytes in the file, and its pixels, those beyond the picture included."""

    offset: int
    size: int
    top: int
    left: int
    height: int
    width: int


def _parts(raw: dict[int, Any], path: Path) -> list[Part]:
    """Strips or tiles; InputError where some are not in the file."""
    tiled = tag.TILE_OFFSETS in raw
    none = np.zeros(0)
    offsets = raw.get(tag.TILE_OFFSETS if tiled else tag.STRIP_OFFSETS, none)
    counts = raw.get(tag.TILE_COUNTS if tiled else tag.STRIP_COUNTS, none)
    if not offsets.size or offsets.shape != counts.shape or not np.isfinite(offsets + counts).all():
        raise InputError(f"{path}: is damaged (no strips or tiles of RAW pixels)")
    needed, size = int((offsets.astype(np.int64) + counts.astype(np.int64)).max()), path.stat().st_size
    if needed > size:
        raise InputError(f"{path}: is truncated: {size} bytes of at least {needed}")
    width, height = raw[tag.WIDTH], raw[tag.HEIGHT]
    across = max(raw.get(tag.TILE_WIDTH, width), 1) if tiled else width
    down = max(raw.get(tag.TILE_HEIGHT if tiled else tag.STRIP_ROWS, height), 1)
    columns = -(-width // across)
    parts = columns * -(-height // down)
    if counts.size != parts or not counts.min() > 0:
        held = int((counts > 0).sum())
        raise InputError(f"{path}: is damaged: {held} of {parts} strips or tiles of RAW pixels are there")
    places = [(i // columns * down, i % columns * across) for i in range(parts)]
    return [
        Part(int(offset), int(count), top, left, down if tiled else min(down, height - top), across)
        for offset, count, (top, left) in zip(offsets, counts, places)
    ]


def _check_whole(raw: dict[int, Any], path: Path) -> None:
    """LibRaw leaves missing rows black without a word: so compare the file's size with what it says."""
    width, height, bits = raw[tag.WIDTH], raw[tag.HEIGHT], raw.get(tag.BITS, 16)
    with path.open("rb") as file:
        for part in _parts(raw, path):
            pixels = min(part.height, height - part.top) * min(part.width, width - part.left)
            if raw.get(tag.COMPRESSION, _UNCOMPRESSED) == _JPEG:
                check_stream(file, part.offset, part.size, pixels, path)
            elif part.size * 8 < pixels * bits:
                raise InputError(
                    f"{path}: is damaged: {part.size} bytes of RAW for {pixels} pixels of {bits} bits"
                )


def check_decoded(stored: np.ndarray, tags: DngTags, path: Path) -> None:
    """Raise InputError where LibRaw's pixels are not those at the end of each stream of lossless JPEG."""
    raw = tags.raw
    if raw.get(tag.COMPRESSION) != _JPEG or tags.get(tag.LINEARIZATION) is not None:
        return
    with path.open("rb") as file:
        for part in _parts(raw, path):
            last, right = part.top + part.height, part.left + part.width
            stream = check_stream(file, part.offset, part.size, 0, path)
            as_wide = stream.width * stream.components == part.width and stream.height == part.height
            if last > raw[tag.HEIGHT] or right > raw[tag.WIDTH] or not as_wide:
                continue
            if part.height < 2:
                continue
            rows = stored[last - 2 : last, part.left : right]
            if not ends_as(file, part.offset, part.size, stream, rows):
                raise InputError(f"{path}: is damaged: a JPEG of its RAW pixels does not end where it should")


def in_place(stored: np.ndarray, tags: DngTags, path: Path) -> np.ndarray:
    """The pixels where they belong, of a file that stores every n-th row, or column, together.

    Source: Digital Negative specification 1.7.1, RowInterleaveFactor and ColumnInterleaveFactor.
    """
    for axis, code in enumerate((tag.ROW_INTERLEAVE, tag.COLUMN_INTERLEAVE)):
        factor = tags.number(code, 1)
        if factor is None or factor != int(factor) or not 1 <= factor <= stored.shape[axis]:
            name = ("RowInterleaveFactor", "ColumnInterleaveFactor")[axis]
            raise InputError(f"{path}: has a {name} that is not from 1 to {stored.shape[axis]}")
        if factor > 1:
            places = np.concatenate([np.arange(i, stored.shape[axis], factor) for i in range(int(factor))])
            stored = np.take(stored, np.argsort(places), axis)
    return stored


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


def default_crop(tags: DngTags, shape: tuple[int, int], path: Path, tell: Tell) -> tuple[int, int, int, int]:
    """Top, left, height, width of the picture within the active area, cut where it would leave it."""
    origin, size = tags.numbers(tag.CROP_ORIGIN, (0, 0)), tags.numbers(tag.CROP_SIZE, shape[::-1])
    if origin is None or size is None or origin.size != 2 or size.size != 2:
        raise InputError(f"{path}: has a damaged DefaultCrop")
    if not (np.isfinite(origin).all() and np.isfinite(size).all() and (origin >= 0).all()):
        raise InputError(f"{path}: has a damaged DefaultCrop")
    left, top = (int(v) for v in np.rint(origin))
    width, height = (int(v) for v in np.rint(size))
    if height > shape[0] - top or width > shape[1] - left:
        tell(f"its DefaultCrop ends outside of its {shape[1]} x {shape[0]} pixels: it is cut")
    height, width = min(height, shape[0] - top), min(width, shape[1] - left)
    if min(height, width) < 2:
        raise InputError(
            f"{path}: has a DefaultCrop outside its active area of {shape[1]} x {shape[0]} pixels"
        )
    return top, left, height, width
