"""Opcode lists of a DNG: lens-shading gain maps, lens warps and vignetting, from and to bytes."""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxisp.errors import InputError

_WARP_RECTILINEAR, _FIX_VIGNETTE_RADIAL, _GAIN_MAP = 1, 3, 9
_MOST_OPCODES, _MOST_POINTS = 256, 1024  # of a list, of a map along one axis: far above what cameras write
_LARGEST_TERM = 1e3  # of a lens: far above what any needs, and far below what overflows
_GAIN_MAP_HEAD = struct.Struct(">10L4dL")


@dataclass(frozen=True)
class GainMap:
    """A grid of gains for every `pitch`-th pixel of a rectangle of the active area.

    Args:
        gains: (V, H, planes), from the top-left.
        rectangle: top, left, bottom, right [px]; the last two are exclusive.
        pitch: rows and columns from one touched pixel to the next: 2, 2 for one CFA phase.
        origin: place of the first grid point as a share of the active area's height and width.
        spacing: distance of grid points, likewise.
        plane, planes: the colour planes it is for (a mosaic has one).
    """

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

    coefficients: np.ndarray
    center: tuple[float, float]


@dataclass(frozen=True)
class FixVignetteRadial:
    """Gain `1 + k0 r^2 + k1 r^4 + ... + k4 r^10`; r is 1 at the farthest corner from the centre (x, y)."""

    coefficients: np.ndarray
    center: tuple[float, float]


Opcode = GainMap | WarpRectilinear | FixVignetteRadial


def parse_opcodes(data: bytes, name: str = "opcode list") -> list[Opcode]:
    """The opcodes of a list that are known here, in order; others are passed over.

    Args:
        data: the value of OpcodeList1, 2 or 3 (big-endian whatever the file's order).
        name: what to call it in an error.

    Raises:
        InputError: the list is cut short or says impossible things.

    Source: Digital Negative specification 1.4, chapter 7.
    """
    found: list[Opcode] = []
    try:
        (count,) = struct.unpack_from(">L", data, 0)
        if count > _MOST_OPCODES:
            raise ValueError(f"{count} opcodes")
        at = 4
        for _ in range(count):
            kind, _version, _flags, size = struct.unpack_from(">4L", data, at)
            body = data[at + 16 : at + 16 + size]
            if len(body) != size:
                raise ValueError("cut short")
            at += 16 + size
            if kind in _PARSERS:
                found.append(_PARSERS[kind](body))
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


def shading_gain(maps: Iterable[GainMap], shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32 gain of every pixel of the active area: the product of all maps, 1 elsewhere.

    Between grid points the gain is bilinear; outside the grid it is that of its border.

    Source: Digital Negative specification 1.4, GainMap.
    """
    out = np.ones(shape, np.float32)
    for gain_map in maps:
        top, left, bottom, right = gain_map.rectangle
        rows = np.arange(top, min(bottom, shape[0]), gain_map.pitch[0])
        columns = np.arange(left, min(right, shape[1]), gain_map.pitch[1])
        vertical = _weights(rows, shape[0], gain_map, 0)
        horizontal = _weights(columns, shape[1], gain_map, 1)
        out[np.ix_(rows, columns)] *= vertical @ gain_map.gains[..., 0].astype(np.float32) @ horizontal.T
    return out


def vignetting_gain(opcode: FixVignetteRadial, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32 gain of every pixel of the active area.

    Source: Digital Negative specification 1.4, FixVignetteRadial.
    """
    (row, column), farthest = optical_centre(opcode.center, shape)
    down, across = np.arange(shape[0]) - row, np.arange(shape[1]) - column
    squared = (down[:, None] ** 2 + across**2) / max(farthest, 1.0) ** 2
    return np.polynomial.Polynomial([1.0, *opcode.coefficients])(squared).astype(np.float32)


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
