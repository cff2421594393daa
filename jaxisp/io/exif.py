"""EXIF: what a picture's header says of its orientation, camera, sensitivity and colours."""

import contextlib
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.io.stated_color import NOTHING, StatedColor

_ORIENTATION, _MAKE, _MODEL, _EXIF_IFD, _INTEROPERABILITY = 274, 271, 272, 34665, 40965
_ISO, _SENSITIVITY_TYPE, _OUTPUT, _INDEX, _SPEED = 34855, 34864, 34865, 34866, 34867
_COLOR_SPACE, _GAMMA = 40961, 42240
_TRANSFER, _WHITE, _PRIMARIES, _TRANSFER_RANGE, _LEVELS = 301, 318, 319, 342, 532
_BEYOND = 65535
"""What the ISO tag of 16 bits says where the number is that or larger, and stands elsewhere."""
_BY_TYPE = {
    1: (_OUTPUT,), 2: (_INDEX,), 3: (_SPEED,), 4: (_INDEX, _OUTPUT), 5: (_SPEED, _OUTPUT),
    6: (_SPEED, _INDEX), 7: (_SPEED, _INDEX, _OUTPUT),
}  # fmt: skip
"""By SensitivityType: the tags that hold it."""


@dataclass(frozen=True)
class Exif:
    """Of a picture.

    Args:
        orientation: 1 to 8; 1 where there is none or another.
        iso: None where it is not stated.
        make, model: of the camera, "" where not stated.
        color: what it states of the colours.
    """

    orientation: int = 1
    iso: float | None = None
    make: str = ""
    model: str = ""
    color: StatedColor = NOTHING


def exif_of(picture: Any) -> Exif:
    """That of a Pillow picture; damaged EXIF costs the picture nothing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _parsed(picture.getexif())
    except Exception:  # a parser on arbitrary bytes
        return Exif()


def exif_in(data: bytes) -> Exif:
    """That of a TIFF, whatever its pixels are."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = Image.Exif()
            table.load(data)
            return _parsed(table)
    except Exception:  # a parser on arbitrary bytes
        return Exif()


def _parsed(table: Image.Exif) -> Exif:
    inner, shared = (_directory(table, code) for code in (_EXIF_IFD, _INTEROPERABILITY))
    orientation = table.get(_ORIENTATION)
    return Exif(
        orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1,
        iso_of(inner),
        text_of(table.get(_MAKE)),
        text_of(table.get(_MODEL)),
        StatedColor(
            adobe_rgb=_is_adobe_rgb(inner.get(_COLOR_SPACE), shared.get(1)),
            srgb=inner.get(_COLOR_SPACE) == 1,
            primaries=table.get(_PRIMARIES),
            white=table.get(_WHITE),
            gamma=inner.get(_GAMMA),
            transfer=table.get(_TRANSFER),
            transfer_range=table.get(_TRANSFER_RANGE),
            levels=table.get(_LEVELS),
        ),
    )


def _directory(table: Image.Exif, code: int) -> dict[int, Any]:
    """Another one within EXIF, which may be damaged by itself."""
    try:
        return table.get_ifd(code)
    except Exception:  # a parser on arbitrary bytes
        return {}


def iso_of(tags: Mapping[int, Any]) -> float | None:
    """The sensitivity that an EXIF directory states, by tag number; of several values the first that is one.

    None too where all that is stated is that it is 65535 or more.

    Source: EXIF 2.3, 4.6.5 (PhotographicSensitivity, SensitivityType) and annex G.
    """
    stated = _positive(tags.get(_ISO))
    if stated is not None and stated != _BEYOND:  # some write more in 32 bits
        return stated
    kind = _positive(tags.get(_SENSITIVITY_TYPE))
    named = _BY_TYPE.get(int(kind), ()) if kind else ()
    found = [_positive(tags.get(tag)) for tag in (*named, _INDEX, _OUTPUT, _SPEED)]
    return next((value for value in found if value is not None), None)


def _positive(value: Any) -> float | None:
    """The first positive number of one or several."""
    for one in value if isinstance(value, tuple | np.ndarray) else (value,):
        try:
            number = float(one)
        except (TypeError, ValueError, ZeroDivisionError, OverflowError):
            continue
        if math.isfinite(number) and number > 0:
            return number
    return None


def text_of(value: Any) -> str:
    """Text of a tag that is ASCII by the standard and UTF-8 or Latin-1 in files."""
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if not isinstance(value, str):
        return ""
    with contextlib.suppress(UnicodeError):
        value = value.encode("latin-1").decode("utf-8")  # Pillow takes all for Latin-1
    return value.replace("\0", " ").strip()


def _is_adobe_rgb(color_space: Any, interoperability: Any) -> bool:
    """By DCF's option file (R03), or by ColorSpace 2 as some cameras write it.

    Source: DCF 2.0 (2010); EXIF 2.3, 4.6.5 (ColorSpace).
    """
    return color_space == 2 or (text_of(interoperability) == "R03" and color_space != 1)


def new_exif(orientation: int = 1, iso: float | None = None, make: str = "", model: str = "") -> Image.Exif:
    """EXIF to write.

    Raises:
        InputError: an ISO that EXIF cannot hold.
    """
    table = Image.Exif()
    table[_ORIENTATION] = orientation
    for code, text in ((_MAKE, make), (_MODEL, model)):
        if text:
            table[code] = text if text.isascii() else text.encode()
    if iso is not None and iso != 0:  # 0 is how EXIF says nothing
        table.get_ifd(_EXIF_IFD).update(sensitivity_tags(iso))
    return table


def sensitivity_tags(iso: float) -> dict[int, int]:
    """By number, the tags that state a sensitivity, rounded to a whole number.

    Raises:
        InputError: EXIF cannot hold it.
    """
    if not 1 <= iso < 2**32 - 0.5:
        raise InputError(f"ISO {iso:g} cannot be written, expected 1 to {2**32 - 1}")
    whole = round(iso)
    beyond = {_SENSITIVITY_TYPE: 2, _INDEX: whole} if whole >= _BEYOND else {}
    return {_ISO: min(whole, _BEYOND), **beyond}
