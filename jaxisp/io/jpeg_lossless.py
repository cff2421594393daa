"""Whether streams of lossless JPEG are whole: a decoder may fill what is missing without a word.

Source: ITU-T T.81, annexes B, F and H.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from jaxisp.errors import InputError

_SOF3, _DHT, _DRI, _SOS, _SOI, _EOI = 0xC3, 0xC4, 0xDD, 0xDA, 0xD8, 0xD9
_MOST_HEAD, _MOST_PADDING = 1 << 16, 64  # bytes before the scan, and after the end
_MOST_SLACK = 64  # bits between the last sample and the end
_TAIL = 32  # pixels at the end that are compared


_PREDICTORS: dict[int, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    1: lambda left, above, corner: left,
    2: lambda left, above, corner: above,
    3: lambda left, above, corner: corner,
    4: lambda left, above, corner: left + above - corner,
    5: lambda left, above, corner: left + ((above - corner) >> 1),
    6: lambda left, above, corner: above + ((left - corner) >> 1),
    7: lambda left, above, corner: (left + above) >> 1,
}


@dataclass
class Stream:
    """The header of one stream.

    Args:
        height, width, components: of the frame, in samples.
        codes: of each component, the bits ("0101") of each category of differences.
        predictor: 1 to 7; 0 where there are restarts or a point transform.
    """

    height: int = 0
    width: int = 0
    components: int = 0
    codes: list[dict[int, str]] = field(default_factory=list)
    predictor: int = 0

    @property
    def samples(self) -> int:
        return self.height * self.width * self.components


def check_stream(file: BinaryIO, offset: int, count: int, pixels: int, path: Path) -> Stream:
    """The header of the `count` bytes from `offset` on.

    Raises:
        InputError: they are not one whole JPEG of at least so many samples.
    """
    file.seek(offset)
    try:
        stream = _header(file.read(min(count, _MOST_HEAD)))
    except (struct.error, ValueError, IndexError, KeyError) as error:
        raise InputError(f"{path}: is damaged: its RAW pixels are no lossless JPEG") from error
    if stream.samples < pixels:
        raise InputError(f"{path}: is damaged: a JPEG of {stream.samples} samples for {pixels} RAW pixels")
    if bytes((0xFF, _EOI)) not in _tail(file, offset, count, _MOST_PADDING + 2):
        raise InputError(f"{path}: is truncated or damaged: the JPEG of its RAW pixels has no end")
    return stream


def ends_as(file: BinaryIO, offset: int, count: int, stream: Stream, rows: np.ndarray) -> bool:
    """Whether the data end with the last samples that were decoded.

    They do not where some in between are missing or overwritten: the decoder has then run out of data, or of
    picture, before. True where the stream is of a kind that is not looked into.

    Args:
        file, offset, count, stream: as of `check_stream`.
        rows: (2, width * components) the last rows of the picture.
    """
    predict = _PREDICTORS.get(stream.predictor)
    if predict is None or stream.width < 2:
        return True
    above, last = rows.astype(np.int64).reshape(2, stream.width, stream.components)
    differences = (last[1:] - predict(last[:-1], above[1:], above[:-1]))[-_TAIL:]
    try:
        wanted = "".join(
            _bits(int(difference), codes)
            for pixel in differences
            for difference, codes in zip(pixel, stream.codes)
        )
    except KeyError:  # a difference that the stream has no code for
        return False
    kept = (len(wanted) + _MOST_SLACK) // 8 + 2
    data = _tail(file, offset, count, 2 * kept + _MOST_PADDING)  # each byte may be stuffed
    data = data[: data.rfind(bytes((0xFF, _EOI)))].replace(b"\xff\0", b"\xff")
    bits = "".join(f"{byte:08b}" for byte in data)
    return wanted in bits[-(len(wanted) + _MOST_SLACK) :]


def _tail(file: BinaryIO, offset: int, count: int, most: int) -> bytes:
    kept = min(count, most)
    file.seek(offset + count - kept)
    return file.read(kept)


def _bits(difference: int, codes: dict[int, str]) -> str:
    """A difference, which is modulo 2^16, as it is coded."""
    own = (difference + 32767) % 65536 - 32767
    size = abs(own).bit_length()
    if size in (0, 16):  # 32768 has no bits of its own
        return codes[size]
    return codes[size] + f"{own if own > 0 else own + (1 << size) - 1:0{size}b}"


def _header(head: bytes) -> Stream:
    """What stands before the scan.

    Raises:
        ValueError, struct.error, IndexError, KeyError: it is no lossless JPEG.
    """
    if head[:2] != bytes((0xFF, _SOI)):
        raise ValueError("no JPEG")
    stream, tables, restarts, at = Stream(), {}, 0, 2
    while True:
        mark, marker, size = struct.unpack_from(">BBH", head, at)
        body, at = head[at + 4 : at + 2 + size], at + 2 + size
        if mark != 0xFF or size < 2:
            raise ValueError("no marker")
        if marker == _SOF3:
            stream.height, stream.width, stream.components = struct.unpack_from(">HHB", body, 1)
        elif 0xC0 <= marker <= 0xCF and marker not in (_DHT, 0xC8, 0xCC):
            raise ValueError("another kind of JPEG")
        elif marker == _DHT:
            tables.update(_tables(body))
        elif marker == _DRI:
            (restarts,) = struct.unpack_from(">H", body)
        elif marker == _SOS:
            stream.codes = [tables[body[2 + 2 * i] >> 4] for i in range(body[0])]
            predictor, shift = body[1 + 2 * body[0]], body[3 + 2 * body[0]] & 15
            whole = stream.components == body[0] and stream.samples > 0
            if whole and not restarts and not shift:
                stream.predictor = predictor
            return stream


def _tables(body: bytes) -> dict[int, dict[int, str]]:
    """The bits of each category, by table."""
    out, at = {}, 0
    while at < len(body):
        own, code, place = {}, 0, at + 17
        for length, count in enumerate(body[at + 1 : at + 17], 1):
            for category in body[place : place + count]:
                own[category] = f"{code:0{length}b}"
                code += 1
            place, code = place + count, code << 1
        out[body[at] & 15] = own
        at = place
    return out
