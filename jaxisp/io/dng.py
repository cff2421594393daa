"""DNG files: opcode lists and a writer."""

import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from jaxisp.cfa import check_cfa, size
from jaxisp.io import tags
from jaxisp.io.exif import sensitivity_tags
from jaxisp.io.files import PathLike, atomic_write
from jaxisp.io.jpeg_frame import frame_header
from jaxisp.io.opcodes import GainMap, Opcode, pack_opcodes, parse_opcodes

__all__ = ["GainMap", "Opcode", "Tag", "pack_opcodes", "parse_opcodes", "write_dng"]

_LARGEST = 2**32 - 1

Tag = tuple[int, int, int, Any]
"""Code, TIFF type (1 BYTE, 2 ASCII, 3 SHORT, 4 LONG, 5 RATIONAL, 7 UNDEFINED, 10 SRATIONAL, 12 DOUBLE),
count, value."""


def write_dng(
    path: PathLike,
    mosaic: np.ndarray,
    *,
    cfa: str,
    black: Sequence[float],
    white: int,
    color_matrix: np.ndarray | None,
    as_shot_neutral: Sequence[float] = (1.0, 1.0, 1.0),
    iso: float = 100,
    exposure_time: float = 0.01,
    orientation: int = 1,
    noise_profile: np.ndarray | None = None,
    gain_map: Sequence[GainMap] | None = None,
    opcodes_3: Sequence[Opcode] | None = None,
    active_area: tuple[int, int, int, int] | None = None,
    crop: tuple[int, int, int, int] | None = None,
    make: str = "jaxisp",
    model: str = "reference",
    preview: bytes | None = None,
    extra_tags: Sequence[Tag] = (),
) -> Path:
    """Write an uncompressed DNG 1.4 that RAW readers open.

    Args:
        path: the file; it is replaced as a whole.
        mosaic: (H, W) uint16, the whole frame.
        cfa: Bayer or X-Trans pattern of the active area from its top-left.
        black: 1 or 4 levels, the 2x2 cell of the active area row by row.
        white: level of a saturated pixel.
        color_matrix: (3, 3) XYZ to camera under D65 (ColorMatrix1), or None to leave it out.
        as_shot_neutral: what the camera sees of grey: the inverse of the white-balance gains.
        iso: 1 to 4294967295; written as a whole number.
        exposure_time: [s].
        orientation: EXIF 1 to 8.
        noise_profile: (1 or 3, 2) S and O in `S x + O`, as variances.
        gain_map: OpcodeList2; in coordinates of the active area.
        opcodes_3: OpcodeList3.
        active_area: top, left, bottom, right in the frame; None is all of it.
        crop: top, left, height, width in the active area (DefaultCrop); None is all of it.
        preview: a JPEG to embed as the first directory.
        extra_tags: (code, TIFF type, count, value) added to the RAW's directory, in place of those it has.

    Raises:
        ValueError: another mosaic or pattern; a sensitivity or an exposure time that no tag holds.
    """
    mosaic = np.asarray(mosaic)
    if mosaic.ndim != 2 or mosaic.dtype != np.uint16:
        raise ValueError(f"write_dng: expected an (H, W) uint16 mosaic, got {mosaic.shape} {mosaic.dtype}")
    if not 1 / _LARGEST <= exposure_time <= _LARGEST:
        raise ValueError(
            f"write_dng: exposure_time = {exposure_time} s, expected from {1 / _LARGEST:.2g} to {_LARGEST}"
        )
    frame = active_area or (0, 0, *mosaic.shape)
    top, left, height, width = crop or (0, 0, frame[2] - frame[0], frame[3] - frame[1])
    levels = np.rint(np.asarray(black, np.float64) * 256).astype(int).ravel()
    raw: list[Tag] = [
        (tags.CFA_DIM, 3, 2, (size(check_cfa(cfa)),) * 2),
        (tags.CFA_PATTERN, 1, len(cfa), bytes("RGB".index(c) for c in cfa)),
        (tags.PLANE_COLOR, 1, 3, b"\0\1\2"),
        (50711, 3, 1, 1),  # CFALayout: rectangular
        (tags.BLACK_DIM, 3, 2, (2, 2) if levels.size == 4 else (1, 1)),
        (tags.BLACK, 5, levels.size, tuple(v for level in levels for v in (int(level), 256))),
        (tags.WHITE, 4, 1, int(white)),
        (tags.ACTIVE_AREA, 4, 4, tuple(int(v) for v in frame)),
        (tags.CROP_ORIGIN, 4, 2, (left, top)),
        (tags.CROP_SIZE, 4, 2, (width, height)),
    ]
    for code, opcodes in ((tags.OPCODES_2, gain_map), (tags.OPCODES_3, opcodes_3)):
        if opcodes:
            data = pack_opcodes(opcodes)
            raw.append((code, 7, len(data), data))
    main = _main_tags(
        make, model, orientation, iso, exposure_time, color_matrix, as_shot_neutral, noise_profile
    )
    with atomic_write(path) as file, tifffile.TiffWriter(file, byteorder="<") as tif:
        _write_pages(tif, mosaic, main, raw, extra_tags, preview)
    return Path(path)


def _main_tags(
    make: str,
    model: str,
    orientation: int,
    iso: float,
    exposure_time: float,
    color_matrix: np.ndarray | None,
    neutral: Sequence[float],
    noise: np.ndarray | None,
) -> list[Tag]:
    out: list[Tag] = [
        (tags.MAKE, 2, 0, make.encode()),
        (tags.MODEL, 2, 0, model.encode()),
        (tags.ORIENTATION, 3, 1, int(orientation)),
        (tags.EXPOSURE_TIME, 5, 1, _ratio(exposure_time)),
        *(
            (code, 4 if code == tags.SENSITIVITIES[2] else 3, 1, v)
            for code, v in sensitivity_tags(iso).items()
        ),
        (tags.DNG_VERSION, 1, 4, b"\1\4\0\0"),
        (50707, 1, 4, b"\1\1\0\0"),  # DNGBackwardVersion
        (50708, 2, 0, f"{make} {model}".encode()),  # UniqueCameraModel
        (tags.NEUTRAL, 5, 3, _rationals(neutral)),
        (tags.BASELINE_EXPOSURE, 10, 1, (0, 1)),
    ]
    if color_matrix is not None:
        out += [
            (tags.COLOR_MATRICES[0], 10, 9, _rationals(np.ravel(color_matrix))),
            (tags.ILLUMINANTS[0], 3, 1, 21),
        ]
    if noise is not None:
        out.append((tags.NOISE_PROFILE, 12, np.size(noise), tuple(float(v) for v in np.ravel(noise))))
    return out


def _write_pages(
    tif: tifffile.TiffWriter,
    mosaic: np.ndarray,
    main: list[Tag],
    raw: list[Tag],
    extra: Sequence[Tag],
    preview: bytes | None,
) -> None:
    def tagged(*lists: Sequence[Tag]) -> list[tuple[int, int, int, Any, bool]]:
        merged = {tag[0]: tag for group in lists for tag in group}
        return [(*merged[code], True) for code in sorted(merged)]

    options: dict[str, Any] = {"photometric": tags.CFA, "metadata": None, "software": "jaxisp"}
    if preview is None:
        tif.write(mosaic, subfiletype=0, extratags=tagged(main, raw, extra), **options)
        return
    frame = frame_header(preview)
    height, width = frame.height, frame.width
    tif.write(
        iter([preview]),
        shape=(height, width, 3),
        dtype=np.uint8,
        compression="jpeg",
        photometric="ycbcr",
        rowsperstrip=height,
        subfiletype=1,
        subifds=1,
        metadata=None,
        extratags=tagged(main),
    )
    tif.write(mosaic, subfiletype=0, extratags=tagged(raw, extra), **options)


def _ratio(value: float) -> tuple[int, int]:
    """Numerator and denominator, both of 32 bits."""
    finest = _LARGEST // max(math.ceil(value), 1)
    ratio = Fraction(value).limit_denominator(finest)
    return ratio.numerator, ratio.denominator


def _rationals(values: Any) -> tuple[int, ...]:
    """Numerators over a million, in one flat tuple as TIFF wants them."""
    return tuple(v for value in np.ravel(values) for v in (round(float(value) * 1_000_000), 1_000_000))
