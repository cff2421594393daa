"""Opcode lists of a DNG: lens-shading gain maps, lens warps and vignetting, from and to bytes."""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeGuard

import numpy as np

from jaxisp.cfa import size
from jaxisp.errors import InputError

_WARP_RECTILINEAR, _FIX_VIGNETTE_RADIAL, _GAIN_MAP = 1, 3, 9
_OPTIONAL = 1  # flag: a reader that does not know the opcode may leave it out
_MOST_OPCODES, _MOST_POINTS = 256, 1024  # of a list, of a map along one axis: far above what cameras write
_LARGEST_TERM = 1e3  # of a lens: far above what any needs, and far below what overflows
_MOST_GAIN = 1e6  # of all maps and vignetting together; the least is its inverse
_NAMES = {
    2: "WarpFisheye", 4: "FixBadPixelsConstant", 5: "FixBadPixelsList", 6: "TrimBounds", 7: "MapTable",
    8: "MapPolynomial", 10: "DeltaPerRow", 11: "DeltaPerColumn", 12: "ScalePerRow", 13: "ScalePerColumn",
    14: "WarpRectilinear2",
}  # fmt: skip
_GAIN_MAP_HEAD = struct.Struct(">10L4dL")


@dataclass(frozen=True)
class GainMap:
    """A grid of gains for every `pitch`-th pixel of a rectangle of the active area.

    Args:
        gains: (V, H, planes), from the top-left; colours beyond its planes have those of its last.
        rectangle: top, left, bottom, right [px]; the last two are exclusive.
        pitch: rows and columns from one touched pixel to the next: 2, 2 for one CFA phase.
        origin: place of the first grid point as a share of the active area's height and width.
        spacing: distance of grid points, likewise.
        plane, planes: the first colour plane it is for, and how many; a mosaic has one, a picture R, G, B.
    """

    name: ClassVar[str] = "GainMap"

    gains: np.ndarray
    rectangle: tuple[int, int, int, int]
    pitch: tuple[int, int] = (1, 1)
    origin: tuple[float, float] = (0.0, 0.0)
    spacing: tuple[float, float] = (1.0, 1.0)
    plane: int = 0
    planes: int = 1


@dataclass(frozen=True)
class WarpRectilinear:
    """Radial (k0 to k3) and tangential (t0, t1) terms per plane, about a relative centre (x, y)."""

    name: ClassVar[str] = "WarpRectilinear"
    coefficients: np.ndarray
    center: tuple[float, float]


@dataclass(frozen=True)
class FixVignetteRadial:
    """Gain `1 + k0 r^2 + k1 r^4 + ... + k4 r^10`; r is 1 at the farthest corner from the centre (x, y)."""

    name: ClassVar[str] = "FixVignetteRadial"
    coefficients: np.ndarray
    center: tuple[float, float]


@dataclass(frozen=True)
class Unknown:
    """An opcode that is not known here; a reader may leave it out where it is optional."""

    kind: int
    optional: bool

    @property
    def name(self) -> str:
        known = _NAMES.get(self.kind, f"an opcode of unknown kind {self.kind}")
        return f"{known} (optional)" if self.optional else known


Opcode = GainMap | WarpRectilinear | FixVignetteRadial


def parse_opcodes(data: bytes, name: str = "opcode list") -> list[Opcode | Unknown]:
    """The opcodes of a list, in order.

    Args:
        data: the value of OpcodeList1, 2 or 3 (big-endian whatever the file's order).
        name: what to call it in an error.

    Raises:
        InputError: the list is cut short or says impossible things.

    Source: Digital Negative specification 1.4, chapter 7.
    """
    found: list[Opcode | Unknown] = []
    try:
        (count,) = struct.unpack_from(">L", data, 0)
        if count > _MOST_OPCODES:
            raise ValueError(f"{count} opcodes")
        at = 4
        for _ in range(count):
            kind, _version, flags, size = struct.unpack_from(">4L", data, at)
            body = data[at + 16 : at + 16 + size]
            if len(body) != size:
                raise ValueError("cut short")
            at += 16 + size
            parse = _PARSERS.get(kind)
            found.append(parse(body) if parse else Unknown(kind, bool(flags & _OPTIONAL)))
    except (struct.error, ValueError) as error:
        raise InputError(f"{name}: is damaged ({error})") from error
    return found


def pack_opcodes(opcodes: Sequence[Opcode]) -> bytes:
    """The bytes of an opcode list."""
    out = [struct.pack(">L", len(opcodes))]
    for opcode in opcodes:
        kind, body = _pack(opcode)
        out += [struct.pack(">L4BLL", kind, 1, 3, 0, 0, 0, len(body)), body]
    return b"".join(out)


def shades(opcode: Opcode | Unknown, planes: int) -> TypeGuard[GainMap | FixVignetteRadial]:
    """Whether it changes the gain of a picture of so many planes."""
    if isinstance(opcode, GainMap):
        return opcode.plane < planes and opcode.planes > 0
    return isinstance(opcode, FixVignetteRadial)


def check_gains(opcodes: Sequence[Opcode], name: str) -> None:
    """Raise InputError where gains are not positive, or further from 1 together than any lens needs."""
    # by pitch and phase: maps for other pixels do not multiply
    least: dict[Any, dict[Any, float]] = {}
    most: dict[Any, dict[Any, float]] = {}
    for opcode in opcodes:
        pitch, phase = (1, 1), (0, 0)
        if isinstance(opcode, GainMap):
            low, high = float(opcode.gains.min()), float(opcode.gains.max())
            pitch = opcode.pitch
            phase = opcode.rectangle[0] % pitch[0], opcode.rectangle[1] % pitch[1]
        elif isinstance(opcode, FixVignetteRadial):
            gains = _polynomial(opcode)(np.linspace(0, 1, 257))
            low, high = float(gains.min()), float(gains.max())
        else:
            continue
        lows, highs = least.setdefault(pitch, {}), most.setdefault(pitch, {})
        lows[phase] = lows.get(phase, 1.0) * min(low, 1.0)
        highs[phase] = highs.get(phase, 1.0) * max(high, 1.0)
        lowest = math.prod(min(own.values()) for own in least.values())
        highest = math.prod(max(own.values()) for own in most.values())
        if not (lowest >= 1 / _MOST_GAIN and highest <= _MOST_GAIN):
            raise InputError(
                f"{name}: is damaged: {opcode.name} with gains from {low:g} to {high:g}, "
                f"expected above 0 and, of all together, from {1 / _MOST_GAIN:g} to {_MOST_GAIN:g}"
            )


def shading_gain(
    on_mosaic: Iterable[Opcode], shape: tuple[int, int], on_colors: Iterable[Opcode] = (), cfa: str = "RGGB"
) -> np.ndarray:
    """(H, W) float32 gain of every pixel of the active area: the product of all maps and vignetting.

    Between grid points of a map the gain is bilinear; outside the grid it is that of its border.

    Args:
        on_mosaic: opcodes for the mosaic, which is one plane (OpcodeList2).
        shape: of the active area.
        on_colors: opcodes for the demosaicked picture (OpcodeList3): a pixel of the mosaic has the gain of
            its own colour.
        cfa: pattern of the active area.

    Source: Digital Negative specification 1.4, GainMap and FixVignetteRadial.
    """
    out = np.ones(shape, np.float32)
    for opcode in on_mosaic:
        if isinstance(opcode, FixVignetteRadial):
            out *= vignetting_gain(opcode, shape)
        elif isinstance(opcode, GainMap) and opcode.plane == 0 < opcode.planes:
            _multiply(out, opcode, 0, (slice(None), slice(None)))
    for opcode in on_colors:
        if isinstance(opcode, FixVignetteRadial):
            out *= vignetting_gain(opcode, shape)
        elif isinstance(opcode, GainMap):
            n = size(cfa)
            for i, color in enumerate(cfa):
                plane = "RGB".index(color)
                if opcode.plane <= plane < opcode.plane + opcode.planes:
                    _multiply(out, opcode, plane, (slice(i // n, None, n), slice(i % n, None, n)))
    return out


def _multiply(out: np.ndarray, gain_map: GainMap, plane: int, part: tuple[slice, slice]) -> None:
    """Apply a map's gains for one plane to the pixels of the part that it is for."""
    places, weights = [], []
    for axis in (0, 1):
        start, end = gain_map.rectangle[axis], min(gain_map.rectangle[axis + 2], out.shape[axis])
        own = np.arange(start, end, gain_map.pitch[axis])
        own = own[np.isin(own, np.arange(out.shape[axis])[part[axis]])]
        places.append(own)
        weights.append(_weights(own, out.shape[axis], gain_map, axis))
    gains = gain_map.gains[..., min(plane, gain_map.gains.shape[2] - 1)].astype(np.float32)
    out[np.ix_(*places)] *= weights[0] @ gains @ weights[1].T


def vignetting_gain(opcode: FixVignetteRadial, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32 gain of every pixel of the active area.

    Source: Digital Negative specification 1.4, FixVignetteRadial.
    """
    (row, column), farthest = optical_centre(opcode.center, shape)
    down, across = np.arange(shape[0]) - row, np.arange(shape[1]) - column
    squared = (down[:, None] ** 2 + across**2) / max(farthest, 1.0) ** 2
    return _polynomial(opcode)(squared).astype(np.float32)


def _polynomial(opcode: FixVignetteRadial) -> np.polynomial.Polynomial:
    """Gain over the square of the radius."""
    return np.polynomial.Polynomial([1.0, *opcode.coefficients])


def optical_centre(center: tuple[float, float], shape: tuple[int, int]) -> tuple[tuple[float, float], float]:
    """Row and column of a centre (x, y) in the active area, and how far off [px] the farthest corner is."""
    place = center[1] * (shape[0] - 1), center[0] * (shape[1] - 1)
    farthest = math.hypot(*(max(abs(p), abs(n - 1 - p)) for p, n in zip(place, shape)))
    return place, farthest


def _weights(positions: np.ndarray, length: int, gain_map: GainMap, axis: int) -> np.ndarray:
    """(positions, grid points) weights of linear interpolation along one axis."""
    points = gain_map.gains.shape[axis]
    spacing = gain_map.spacing[axis]
    with np.errstate(over="ignore"):  # of a tiny spacing: far outside, which is the border
        place = ((positions + 0.5) / length - gain_map.origin[axis]) / (spacing if spacing > 0 else 1.0)
    place = np.clip(place, 0, points - 1)
    return np.maximum(0, 1 - np.abs(place[:, None] - np.arange(points))).astype(np.float32)


def _parse_gain_map(body: bytes) -> GainMap:
    head = _GAIN_MAP_HEAD.unpack_from(body)
    top, left, bottom, right, plane, planes, row_pitch, column_pitch, points_v, points_h = head[:10]
    map_planes = head[14]
    count = points_v * points_h * map_planes
    fits = 0 < count <= len(body) // 4 and max(points_v, points_h) <= _MOST_POINTS
    if not fits or not (row_pitch and column_pitch):
        raise ValueError(
            f"GainMap of {points_v}x{points_h}x{map_planes} points, pitch {row_pitch}, {column_pitch}"
        )
    gains = np.frombuffer(body, ">f4", count, _GAIN_MAP_HEAD.size)
    _check_finite(gains)
    _check_finite(head[10:14])
    return GainMap(
        gains.astype(np.float32).reshape(points_v, points_h, map_planes),
        (top, left, bottom, right),
        (row_pitch, column_pitch),
        (head[12], head[13]),
        (head[10], head[11]),
        plane,
        planes,
    )


def _parse_warp(body: bytes) -> WarpRectilinear:
    (planes,) = struct.unpack_from(">L", body)
    if not 1 <= planes <= 4:
        raise ValueError(f"WarpRectilinear of {planes} planes")
    values = struct.unpack_from(f">{6 * planes + 2}d", body, 4)
    _check_terms(values)
    return WarpRectilinear(np.array(values[:-2]).reshape(planes, 6), (values[-2], values[-1]))


def _parse_vignette(body: bytes) -> FixVignetteRadial:
    values = struct.unpack_from(">7d", body)
    _check_terms(values)
    return FixVignetteRadial(np.array(values[:5]), (values[5], values[6]))


def _check_terms(values: Any) -> None:
    _check_finite(values)
    if np.abs(values).max() > _LARGEST_TERM:
        raise ValueError(f"a lens with a term of {np.abs(values).max():g}")


def _check_finite(values: Any) -> None:
    if not np.isfinite(values).all():
        raise ValueError("NaN or infinity")


_PARSERS: dict[int, Callable[[bytes], Opcode]] = {
    _WARP_RECTILINEAR: _parse_warp,
    _FIX_VIGNETTE_RADIAL: _parse_vignette,
    _GAIN_MAP: _parse_gain_map,
}


def _pack(opcode: Opcode) -> tuple[int, bytes]:
    if isinstance(opcode, GainMap):
        gains = np.asarray(opcode.gains, ">f4")
        head = _GAIN_MAP_HEAD.pack(
            *opcode.rectangle,
            opcode.plane,
            opcode.planes,
            *opcode.pitch,
            *gains.shape[:2],
            *opcode.spacing,
            *opcode.origin,
            gains.shape[2],
        )
        return _GAIN_MAP, head + gains.tobytes()
    body = np.asarray([*np.ravel(opcode.coefficients), *opcode.center], ">f8").tobytes()
    if isinstance(opcode, WarpRectilinear):
        return _WARP_RECTILINEAR, struct.pack(">L", len(opcode.coefficients)) + body
    return _FIX_VIGNETTE_RADIAL, body
