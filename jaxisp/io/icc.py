"""ICC profiles of RGB pictures: those that are a matrix and curves, and those of tables by littleCMS."""

import io
import struct
from functools import partial

import numpy as np
from PIL import Image, ImageCms

from jaxisp.errors import InputError
from jaxisp.io.color_space import ColorSpace, Curve, gamma, of_xyz, sampled

_D50 = np.array([0.9642, 1.0, 0.8249])
"""White of the profile connection space."""
_TABLES = (b"A2B0", b"A2B1", b"D2B0", b"D2B1")
_MOST_TAGS = 200
_PARAMETERS = (1, 3, 4, 5, 7)  # of each type of parametric curve


def profile_space(icc: bytes, name: str) -> ColorSpace | None:
    """`matrix_profile` of a file's profile; InputError names the file."""
    try:
        return matrix_profile(icc)
    except ValueError as error:
        raise InputError(f"{name}: has a colour profile that cannot be used ({error})") from error


def by_tables(pixels: np.ndarray, icc: bytes, name: str) -> np.ndarray:
    """(H, W, 3) uint8 in sRGB, relative colorimetric, by a profile of any kind.

    Raises:
        InputError: it cannot be used.
    """
    try:
        transform = ImageCms.buildTransform(
            ImageCms.getOpenProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB"), "RGB", "RGB",
            ImageCms.Intent.RELATIVE_COLORIMETRIC,
        )  # fmt: skip
        return np.asarray(ImageCms.applyTransform(Image.fromarray(pixels), transform))
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        raise InputError(f"{name}: has a colour profile that cannot be used ({error})") from error


def matrix_profile(data: bytes) -> ColorSpace | None:
    """The colour space that a profile states by three colorants and three curves.

    Returns:
        It; None where the profile goes by tables of many dimensions.

    Raises:
        ValueError: the profile is damaged, or is none of RGB; in words.

    Source: ICC.1:2022, 9.2, 10.6 (curveType), 10.18 (parametricCurveType) and annex F.
    """
    if len(data) < 132 or data[36:40] != b"acsp":
        raise ValueError("no ICC profile")
    if data[16:20] != b"RGB ":
        raise ValueError(f"a profile of {_name(data[16:20])} pixels, expected RGB")
    tags = _tags(data)
    if any(name in tags for name in _TABLES):
        return None
    if data[20:24] != b"XYZ ":
        raise ValueError(f"a connection space of {_name(data[20:24])} without tables")
    missing = [name for c in "rgb" for name in (f"{c}XYZ", f"{c}TRC") if name.encode() not in tags]
    if missing:
        raise ValueError(f"no {' and no '.join(missing)}")
    colorants = np.stack([_xyz(tags[c + b"XYZ"]) for c in (b"r", b"g", b"b")], axis=1)
    if abs(np.linalg.det(colorants)) < 1e-5:
        raise ValueError("colorants that span no space")
    red, green, blue = (_rising(_curve(tags[c + b"TRC"])) for c in (b"r", b"g", b"b"))
    return of_xyz(colorants, (red, green, blue), _D50)


def _name(signature: bytes) -> str:
    text = signature.decode("ascii", "replace").strip()
    return text if text.isprintable() and text.isascii() and text else "unknown"


def _tags(data: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", data, 128)
    if count > _MOST_TAGS or len(data) < 132 + 12 * count:
        raise ValueError("a damaged table of tags")
    found = {}
    for i in range(count):
        name, offset, size = struct.unpack_from(">4sII", data, 132 + 12 * i)
        if offset + size <= len(data) and size >= 8:  # else it is as if it were not there
            found[name] = data[offset : offset + size]
    return found


def _fixed(data: bytes, start: int, count: int) -> np.ndarray:
    """So many s15Fixed16 numbers."""
    if len(data) < start + 4 * count:
        raise ValueError("a tag that is cut short")
    return np.frombuffer(data, ">i4", count, start) / 65536


def _xyz(data: bytes) -> np.ndarray:
    if data[:4] != b"XYZ ":
        raise ValueError(f"a colorant of type {_name(data[:4])}")
    return _fixed(data, 8, 3)


def _curve(data: bytes) -> Curve:
    if data[:4] == b"curv" and len(data) >= 12:
        (count,) = struct.unpack_from(">I", data, 8)
        if len(data) < 12 + 2 * count:
            raise ValueError("a curve that is cut short")
        values = np.frombuffer(data, ">u2", count, 12).astype(np.float64)
        if count == 0:
            return gamma(1.0)
        if count == 1:
            return gamma(float(values[0]) / 256)
        return partial(sampled, values / 65535)
    if data[:4] == b"para" and len(data) >= 12:
        (kind,) = struct.unpack_from(">H", data, 8)
        if kind < len(_PARAMETERS):
            return partial(_parametric, kind, _fixed(data, 12, _PARAMETERS[kind]))
        raise ValueError(f"a parametric curve of type {kind}")
    raise ValueError(f"a curve of type {_name(data[:4])}")


def _rising(curve: Curve) -> Curve:
    first, last = curve(np.array([0.0, 1.0]))
    if not first < last:
        raise ValueError("a curve that does not rise from black to white")
    return curve


def _parametric(kind: int, parameters: np.ndarray, x: np.ndarray) -> np.ndarray:
    """`(a x + b)**g + e` from d up, `c x + f` below."""
    g, a, b, c, d, e, f = (*parameters, *(0.0,) * 7)[:7]
    if kind == 0:
        a, b, d = 1.0, 0.0, 0.0
    if kind in (1, 2):  # from where a x + b is positive; the constant of type 2 is added on both sides
        e = f = c if kind == 2 else 0.0
        c, d = 0.0, -b / a if a else 0.0
    if kind == 3:
        e = f = 0.0
    with np.errstate(all="ignore"):  # what is no number is found by who asks for a curve that rises
        above = np.maximum(a * x + b, 0) ** g + e
    return np.clip(np.where(x >= d, above, c * x + f), 0, 1)
