"""What the tags of a DNG state about its levels, its noise, its lens and the shot."""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.io import tags as tag
from jaxisp.io.dng_color import Tell
from jaxisp.io.exif import iso_of, text_of
from jaxisp.io.opcodes import Opcode, WarpRectilinear, check_gains, parse_opcodes, shades
from jaxisp.io.tags import DngTags

_MOST_CODE = 65535  # of a pixel
_MOST_EXPOSURE = 8.0  # EV
_ISO_RANGE = 1.0, 1e7  # the Canon ME20F-SH has 4,560,000
_EXPOSURE_RANGE = 1e-7, 1e6  # s
_MOST_SCALE = 4.0


def black_levels(tags: DngTags, shape: tuple[int, int], path: Path, tell: Tell) -> np.ndarray:
    """(H, W) float32 black level of the active area: the repeated cell, plus row and column terms."""
    dims = tags.numbers(tag.BLACK_DIM, (1, 1))
    cell = tags.numbers(tag.BLACK, 0.0)
    assert dims is not None and cell is not None
    if dims.size != 2 or not dims.min() >= 1 or cell.size != dims.prod() or not cell.min() >= 0:
        raise InputError(f"{path}: has a damaged BlackLevel")
    rows, columns = (int(v) for v in dims)
    wide = cell.reshape(rows, columns).astype(np.float32)[: shape[0], np.arange(shape[1]) % columns]
    black = wide[np.arange(shape[0]) % rows]
    for code, axis in ((tag.BLACK_DELTA_H, 1), (tag.BLACK_DELTA_V, 0)):
        delta = tags.numbers(code)
        if delta is None:
            continue
        if delta.size == shape[axis]:
            black = black + np.expand_dims(delta.astype(np.float32), 1 - axis)
        else:
            name = "BlackLevelDelta" + "VH"[axis]
            tell(f"its {name} has {delta.size} numbers for {shape[axis]} pixels and is not used")
    if not np.isfinite(black).all():
        raise InputError(f"{path}: has a damaged BlackLevel")
    return black


def white_level(tags: DngTags, path: Path, tell: Tell) -> float:
    """Level of a saturated pixel; the largest code where the file states none that a pixel can have."""
    table = tags.numbers(tag.LINEARIZATION)
    if table is not None and not np.isfinite(table).all():
        raise InputError(f"{path}: has a damaged LinearizationTable")
    if table is not None and (np.diff(table) < 0).any():
        tell("its LinearizationTable falls: brighter light may have darker pixels")
    elif table is not None and table.size and table.max() == table.min():
        tell("its LinearizationTable is of one value: all pixels are alike")
    largest = 2.0 ** min(tags.raw.get(tag.BITS, 16), 16) - 1
    if table is not None and table.size:
        largest = max(largest, float(table.max()))
    if tags.get(tag.WHITE) is None:
        return largest
    white = tags.number(tag.WHITE) or 0.0
    stated = tags.numbers(tag.WHITE)
    if stated is not None and stated.size and (stated != stated[0]).any():
        tell(f"its WhiteLevels differ: that of the first plane, {white:g}, is taken for all")
    # one more than the largest code is a slip that does no harm
    if 0 < white <= largest + 1:
        return white
    if largest < white <= _MOST_CODE:
        tell(f"its WhiteLevel of {white:g} is above all of its pixels, which end at {largest:g}")
        return white
    tell(f"its WhiteLevel of {white:g} is not from 1 to {_MOST_CODE}: {largest:g} is taken")
    return largest


def noise_profile(tags: DngTags, tell: Tell) -> np.ndarray | None:
    """(3, 2): shot and read of R, G, B in `shot * x + read**2`; None where the file states none of use."""
    values = tags.numbers(tag.NOISE_PROFILE)
    if values is None:
        return None
    if values.size not in (2, 6):
        tell(f"its NoiseProfile has {values.size} numbers, expected 2 or 6: not used")
        return None
    if not (np.isfinite(values).all() and np.abs(values).max() <= 1 and values[0::2].min() >= 0):
        tell("its NoiseProfile is not of variances from 0 to 1 (black is 0, white is 1): not used")
        return None
    shot, variance = np.broadcast_to(values.reshape(-1, 2), (3, 2)).T
    if variance.min() < 0:
        tell("its NoiseProfile has negative variances in the dark: 0 is taken")
    return np.stack([shot, np.sqrt(np.maximum(variance, 0))], axis=1)


def baseline_exposure(tags: DngTags, tell: Tell) -> float:
    """Gain [EV] with which the file is to be rendered: BaselineExposure and its profile's offset."""
    # 0/0, which is no number, is how some cameras say nothing
    total = sum(tags.number(code, 0.0) or 0.0 for code in (tag.BASELINE_EXPOSURE, tag.EXPOSURE_OFFSET))
    if abs(total) <= _MOST_EXPOSURE:
        return total
    tell(f"its BaselineExposure of {total:g} EV is beyond {_MOST_EXPOSURE:g} and is not used")
    return 0.0


def lens(tags: DngTags, path: Path, tell: Tell) -> dict[str, Any]:
    """The opcodes of lists 2 and 3 that shade, in order, and the first warp."""
    shading: list[tuple[Opcode, ...]] = []
    warps: list[WarpRectilinear] = []
    for number, code in enumerate((tag.OPCODES_1, tag.OPCODES_2, tag.OPCODES_3), 1):
        opcodes = parse_opcodes(tags.get(code) or bytes(4), str(path))
        kept = tuple(o for o in opcodes if number > 1 and shades(o, planes=1 if number == 2 else 3))
        left = {o.name: None for o in opcodes if not any(o is own for own in kept)}
        for name in left:
            tell(f"its OpcodeList{number} has {name}, which is not applied")
        shading.append(kept)
        warps += [o for o in opcodes if number > 1 and isinstance(o, WarpRectilinear)]
    check_gains([o for own in shading for o in own], str(path))
    return {"opcodes_2": shading[1], "opcodes_3": shading[2], "warp": warps[0] if warps else None}


_HINTS = (
    (tag.GREEN_SPLIT, "BayerGreenSplit", 0),
    (tag.LINEAR_LIMIT, "LinearResponseLimit", 1),
    (tag.SHADOW_SCALE, "ShadowScale", 1),
    (tag.BLACK_RENDER, "DefaultBlackRender", 1),  # 0: a black point that the reader finds
    (tag.BEST_SCALE, "BestQualityScale", 1),
)


def _is_hdr(tags: DngTags) -> bool:
    """Whether ProfileDynamicRange says that the profile is for more than a display's white, or nonsense.

    Source: Digital Negative specification 1.7.1, ProfileDynamicRange: version, range (0: standard), a hint.
    """
    data = tags.get(tag.DYNAMIC_RANGE)
    plain = len(data) == 8 and struct.unpack_from(f"{tags.byteorder}2H", data)[1] == 0 if data else True
    return not plain


def tell_unused(tags: DngTags, tell: Tell) -> None:
    """What else the file states of its look and is not applied."""
    if (orientation := tags.main.get(tag.ORIENTATION, 1)) not in range(1, 9):
        tell(f"its Orientation of {orientation} is not from 1 to 8: 1 is taken")
    about = header(tags)
    for name, value, (least, most) in (
        ("ISO", about["iso"], _ISO_RANGE), ("ExposureTime", about["exposure_time"], _EXPOSURE_RANGE)
    ):  # fmt: skip
        if value is not None and not least <= value <= most:
            tell(f"its {name} of {value:g} is that of no camera")
    names = list(dict.fromkeys(name for code, name in tag.STATED.items() if tags.get(code)))
    # each has a value at which nothing is to be done; 0/0 states none
    for code, name, plain in _HINTS:
        value = tags.numbers(code)
        if value is not None and np.isfinite(value).all() and not np.array_equal(value, [plain]):
            names.append(f"{name} of {', '.join(f'{v:g}' for v in value)}")
    if _is_hdr(tags):
        names.append("ProfileDynamicRange (HDR)")
    if names:
        tell(f"its {', '.join(names)} {'is' if len(names) == 1 else 'are'} not applied")
    if tags.number(tag.COLORIMETRIC_REFERENCE, 0):
        tell("its colours are those of a display (ColorimetricReference), read as those of the scene")
    crop = tags.numbers(tag.USER_CROP)
    if crop is not None and not np.array_equal(crop, (0, 0, 1, 1)):
        tell("its DefaultUserCrop is not applied")


def default_scale(tags: DngTags, tell: Tell) -> tuple[float, float]:
    """How much taller and wider the picture is to be rendered, so that its pixels are square."""
    scale = tags.numbers(tag.DEFAULT_SCALE, (1, 1))
    if scale is None or scale.size != 2 or not ((scale >= 1 / _MOST_SCALE) & (scale <= _MOST_SCALE)).all():
        tell(f"its DefaultScale is not two numbers from {1 / _MOST_SCALE:g} to {_MOST_SCALE:g}: not applied")
        return 1.0, 1.0
    return float(scale[1]), float(scale[0])


def header(tags: DngTags) -> dict[str, Any]:
    """What any TIFF-like RAW states in its first directory."""
    orientation = tags.main.get(tag.ORIENTATION, 1)
    return {
        "orientation": int(orientation) if orientation in range(1, 9) else 1,
        "iso": iso_of({**tags.main, **tags.raw}) or iso_of(tags.exif),
        "exposure_time": _seconds(tags),
        "make": text_of(tags.main.get(tag.MAKE)),
        "model": text_of(tags.main.get(tag.MODEL)),
    }


def _seconds(tags: DngTags) -> float | None:
    """The exposure time; None where it is not stated, or as no number."""
    value = tags.exif.get(tag.EXPOSURE_TIME)
    if isinstance(value, tuple):
        value = value[0] / value[1] if len(value) > 1 and value[1] else None
    for one in (tags.number(tag.EXPOSURE_TIME), value):
        if isinstance(one, int | float) and math.isfinite(one) and one > 0:
            return float(one)
    return None
