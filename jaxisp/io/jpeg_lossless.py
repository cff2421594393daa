"""Whether a stream of lossless JPEG is whole: a decoder may fill what is missing without a word."""

import struct
from pathlib import Path
from typing import BinaryIO

from jaxisp.errors import InputError

_SOF3, _SOS, _SOI, _EOI = 0xC3, 0xDA, 0xD8, 0xD9
_MOST_HEAD, _MOST_PADDING = 1 << 16, 64  # bytes before the frame, and after the end


def check_stream(file: BinaryIO, offset: int, count: int, pixels: int, path: Path) -> None:
    """Raise InputError where `count` bytes from `offset` on are not one whole JPEG of `pixels` samples."""
    file.seek(offset)
    head = file.read(min(count, _MOST_HEAD))
    samples = _samples(head)
    if samples is None:
        raise InputError(f"{path}: is damaged: its RAW pixels are no lossless JPEG, as they should be")
    if samples < pixels:
        raise InputError(f"{path}: is damaged: a JPEG of {samples} samples for {pixels} RAW pixels")
    tail = min(count, _MOST_PADDING + 2)
    file.seek(offset + count - tail)
    if bytes((0xFF, _EOI)) not in file.read(tail):
        raise InputError(f"{path}: is truncated or damaged: the JPEG of its RAW pixels has no end")


def _samples(head: bytes) -> int | None:
    """Width x height x components of the frame; None where it is no lossless JPEG."""
    if head[:2] != bytes((0xFF, _SOI)):
        return None
    at = 2
    while at + 10 <= len(head) and head[at] == 0xFF:
        marker, (size,) = head[at + 1], struct.unpack_from(">H", head, at + 2)
        if marker == _SOF3:
            height, width, components = struct.unpack_from(">HHB", head, at + 5)
            return int(height * width * components)
        if marker == _SOS or size < 2:
            return None
        at += 2 + size
    return None
