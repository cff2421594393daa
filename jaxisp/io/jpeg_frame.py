"""The headers of a JPEG file, read without decoding anything: size, sampling, colour profile."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

_SUBSAMPLING = {
    (1, 1): "4:4:4",
    (2, 1): "4:2:2",
    (2, 2): "4:2:0",
    (1, 2): "4:4:0",
    (4, 1): "4:1:1",
    (4, 2): "4:1:0",
}
_PROFILE = b"ICC_PROFILE\0"


@dataclass(frozen=True)
class Frame:
    """A JPEG frame header (SOF)."""

    marker: int
    precision: int
    height: int
    width: int
    sampling: tuple[tuple[int, int], ...]  # horizontal, vertical of each component
    ids: tuple[int, ...]

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
    for marker, body in _segments(data):
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
        for marker, body in _segments(data)
        if marker == 0xE2 and body.startswith(_PROFILE)
    }
    found = sorted(parts)  # each begins with its number and how many there are
    if [part[:2] for part in found] != [bytes((i + 1, len(found))) for i in range(len(found))]:
        raise ValueError("a part of its colour profile is missing")
    return b"".join(part[2:] for part in found) or None


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Markers before the pixels, and what each holds; ValueError where none is where one should be."""
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise ValueError("no marker where one should be")
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker in (0xD9, 0xDA):
            return
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + length


def _parse_frame(marker: int, body: bytes) -> Frame:
    if len(body) < 6 or len(body) < 6 + 3 * body[5] or not body[5]:
        raise ValueError("a frame header that is cut short")
    precision, height, width, count = struct.unpack_from(">BHHB", body)
    factors = [(body[7 + 3 * i] >> 4, body[7 + 3 * i] & 15) for i in range(count)]
    if any(not (h and v) for h, v in factors):
        raise ValueError("sampling factors of zero")
    return Frame(
        marker, precision, height, width, tuple(factors), tuple(body[6 + 3 * i] for i in range(count))
    )
