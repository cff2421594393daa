"""The headers of a JPEG file, read without decoding anything: size, sampling, colour profile, tables."""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

_SUBSAMPLING = {
    (1, 1): "4:4:4",
    (2, 1): "4:2:2",
    (2, 2): "4:2:0",
    (1, 2): "4:4:0",
    (4, 1): "4:1:1",
    (4, 2): "4:1:0",
}
_PROFILE = b"ICC_PROFILE\0"
_TABLES, _SCAN, _END, _APP2 = 0xDB, 0xDA, 0xD9, 0xE2
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")  # of those among pixels: not their bytes, no restart
_ZIGZAG = sorted(range(64), key=lambda i: (sum(divmod(i, 8)), divmod(i, 8)[(sum(divmod(i, 8)) + 1) % 2]))
"""Place in a table of 8 x 8, row by row, of each number as files hold them."""


@dataclass(frozen=True)
class Frame:
    """A JPEG frame header (SOF)."""

    marker: int
    precision: int
    height: int
    width: int
    sampling: tuple[tuple[int, int], ...]  # horizontal, vertical of each component
    ids: tuple[int, ...]
    slots: tuple[int, ...]  # the quantisation table of each component

    @property
    def subsampling(self) -> str:
        (h, v), *chroma = self.sampling
        if len(chroma) == 2 and chroma[0] == chroma[1] and not (h % chroma[0][0] or v % chroma[0][1]):
            name = _SUBSAMPLING.get((h // chroma[0][0], v // chroma[0][1]))
            if name:
                return name
        return ",".join(f"{x}x{y}" for x, y in self.sampling)


def frame_header(data: bytes) -> Frame:
    """The first frame header; ValueError where there is none."""
    for marker, body in _before_pixels(data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return _parse_frame(marker, body)
    raise ValueError("no frame header")


def color_profile(data: bytes) -> bytes | None:
    """The ICC profile, which may stand anywhere before the pixels and in several parts; None where there is
    none.

    Raises:
        ValueError: parts of it are missing.

    Source: ICC.1:2022, B.4.
    """
    parts = {
        body[len(_PROFILE) :]
        for marker, body in _before_pixels(data)
        if marker == _APP2 and body.startswith(_PROFILE)
    }
    found = sorted(parts)  # each begins with its number and how many there are
    if [part[:2] for part in found] != [bytes((i + 1, len(found))) for i in range(len(found))]:
        raise ValueError("a part of its colour profile is missing")
    return b"".join(part[2:] for part in found) or None


def quantization(data: bytes, frame: Frame) -> np.ndarray:
    """(components, 8, 8) steps, rows are vertical frequencies: a component has the table that stands in its
    slot where its first scan begins, as the slot may hold another one later.

    Raises:
        ValueError: a table is missing.

    Source: ITU-T T.81 (1992), B.2.4.1.
    """
    held: dict[int, np.ndarray] = {}
    found: dict[int, np.ndarray] = {}
    for marker, body in _segments(data):
        if marker == _TABLES:
            held |= _tables(body)
        elif marker == _SCAN:
            begun = body[1 : 1 + 2 * body[0] : 2] if body else b""
            for i, (name, slot) in enumerate(zip(frame.ids, frame.slots)):
                if name in begun and slot in held:
                    found.setdefault(i, held[slot])
        if len(found) == len(frame.ids):
            return np.stack([found[i] for i in range(len(frame.ids))])
    raise ValueError("a quantisation table is missing")


def _tables(body: bytes) -> dict[int, np.ndarray]:
    """By slot; steps have 8 or 16 bits."""
    tables, at = {}, 0
    while at < len(body):
        kind = ">u2" if body[at] >> 4 else "u1"
        size = 64 * np.dtype(kind).itemsize
        if len(body) < at + 1 + size:
            raise ValueError("a quantisation table that is cut short")
        table = np.empty(64, int)
        table[_ZIGZAG] = np.frombuffer(body, kind, 64, at + 1)
        tables[body[at] & 15] = table.reshape(8, 8)
        at += 1 + size
    return tables


def _before_pixels(data: bytes) -> Iterator[tuple[int, bytes]]:
    return takewhile(lambda segment: segment[0] != _SCAN, _segments(data))


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Markers, and what each holds, without pixels; ValueError where none is where one should be."""
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise ValueError("no marker where one should be")
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker == _END:
            return
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + length
        if marker == _SCAN:
            behind = _MARKER.search(data, at)
            if behind is None:
                return
            at = behind.start()


def _parse_frame(marker: int, body: bytes) -> Frame:
    if len(body) < 6 or len(body) < 6 + 3 * body[5] or not body[5]:
        raise ValueError("a frame header that is cut short")
    precision, height, width, count = struct.unpack_from(">BHHB", body)
    factors = [(body[7 + 3 * i] >> 4, body[7 + 3 * i] & 15) for i in range(count)]
    if any(not (h and v) for h, v in factors):
        raise ValueError("sampling factors of zero")
    return Frame(
        marker, precision, height, width, tuple(factors),
        tuple(body[6 + 3 * i] for i in range(count)), tuple(body[8 + 3 * i] for i in range(count)),
    )  # fmt: skip
