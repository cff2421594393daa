"""Mutations of files: blind ones on bytes, and ones that know where a format keeps its numbers."""

import re
import struct
import zlib
from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
_INTEGERS = (
    0, 1, 2, 3, 7, 8, 15, 16, 127, 128, 255, 256, 4096, 32767, 32768, 65500, 65535, 65536, 2**24, 2**28,
    2**31 - 1, 2**31, 2**32 - 1,
)  # fmt: skip
_WORDS = (
    "nan", "inf", "-inf", "1e400", "-1", "0", "1e-300", "10" * 200, "true", '""', '"a\\u0000b"', "[]", "{}",
    "[nan]", "[[1], [2, 3]]", "{ uniform = [1, 0] }", "{ choice = [] }", "{ log_uniform = [0, 1] }",
    "1979-05-27",
    "[" * 300 + "]" * 300, "[" * 3000, "{a=" * 2000, "9223372036854775807", '"__import__(\'os\').abort()"',
    "[" + "0," * 5000 + "]", '"../../etc/passwd"', "1_0", "0x7fffffffffffffff", '"phone"', "'''\n'''",
)  # fmt: skip


_TYPES = (
    "|O", "<f8", ">f2", "<c16", "|S9", "<U3", "<M8[s]", "|V12", "<i8", "|b1", "<f16", "{", "[('a','<f4')]",
)  # fmt: skip


def mutate(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """One to four mutations of a file; `others` are of its kind, to splice with."""
    own = [_for_format(data)] * 2 + [_blind]
    for _ in range(1 + int(rng.integers(4)) * int(rng.integers(2))):
        data = own[int(rng.integers(3))](data, others, rng)
    return data


def _for_format(data: bytes) -> Callable[[bytes, list[bytes], Rng], bytes]:
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff
    if data[:2] == b"\xff\xd8":
        return _jpeg
    if data[:4] == b"\x89PNG":
        return _png
    if data[:6] == b"\x93NUMPY":
        return _npy
    return _toml if b" = " in data and b"\0" not in data else _numbers


def _at(data: bytes, rng: Rng) -> int:
    """A place in the file, more often near its start, where headers are."""
    end = max(len(data), 1)
    return int(rng.integers(min(end, 600) if rng.random() < 0.5 else end))


def _put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def _blind(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    what, at, length = rng.integers(7), _at(data, rng), int(2 ** rng.uniform(0, 10))
    if what <= 1:  # a few bytes
        for _ in range(1 + int(rng.integers(6))):
            data = _put(
                data, _at(data, rng), bytes([int(rng.choice([0, 1, 127, 128, 255, rng.integers(256)]))])
            )
        return data
    if what == 2:  # cut short
        return data[:at]
    if what == 3:  # a piece taken out
        return data[:at] + data[at + length :]
    if what == 4:  # a piece twice
        return data[: at + length] + data[at:]
    if what == 5:  # noise
        return _put(data, at, rng.bytes(length))
    other = others[int(rng.integers(len(others)))]
    return data[:at] + other[_at(other, rng) :]


def _numbers(data: bytes, _: list[bytes], rng: Rng) -> bytes:
    value = int(rng.choice(_INTEGERS))
    form = str(rng.choice(["<H", ">H", "<L", ">L", ">d"]))
    if form == ">d":
        return _put(data, _at(data, rng), struct.pack(form, rng.choice([np.nan, np.inf, -1.0, 1e300, 0.0])))
    return _put(data, _at(data, rng), struct.pack(form, value & (0xFFFF if form[1] == "H" else 0xFFFFFFFF)))


def _tiff(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """One directory entry: its tag, type, count or value; or a number that a value points to."""
    order = "<" if data[:2] == b"II" else ">"
    entries = _entries(data, order)
    if not entries or rng.random() < 0.1:
        return _numbers(data, others, rng)
    at = entries[int(rng.integers(len(entries)))]
    value, what = int(rng.choice(_INTEGERS)), rng.integers(6)
    if what == 0:
        return _put(
            data,
            at,
            struct.pack(order + "H", int(rng.choice([value & 0xFFFF, *_tags(data, order, entries)]))),
        )
    if what == 1:
        return _put(data, at + 2, struct.pack(order + "H", int(rng.integers(14))))
    if what == 2:
        return _put(data, at + 4, struct.pack(order + "L", value))
    if what == 3:
        (place,) = struct.unpack_from(order + "L", data, at + 8)
        inside = place < len(data)
        return _put(data, place if inside else at + 8, struct.pack(order + "L", value))
    return _put(data, at + 8, struct.pack(order + "L", value if what == 4 else value & 0xFFFF))


def _entries(data: bytes, order: str) -> list[int]:
    """Places of the directory entries, directories below (SubIFDs, EXIF) too."""
    found: list[int] = []
    waiting, seen = [struct.unpack_from(order + "L", data, 4)[0] if len(data) >= 8 else 0], set()
    while waiting and len(seen) < 20:
        at = waiting.pop()
        if at in seen or at < 8 or at + 2 > len(data):
            continue
        seen.add(at)
        (count,) = struct.unpack_from(order + "H", data, at)
        places = [at + 2 + 12 * i for i in range(count) if at + 14 + 12 * i <= len(data)]
        found += places
        for place in places:
            tag, _, number, value = struct.unpack_from(order + "HHLL", data, place)
            if tag in (330, 34665) and number == 1:
                waiting.append(value)
        end = at + 2 + 12 * count
        if end + 4 <= len(data):
            waiting.append(struct.unpack_from(order + "L", data, end)[0])
    return found


def _tags(data: bytes, order: str, entries: list[int]) -> list[int]:
    return [struct.unpack_from(order + "H", data, at)[0] for at in entries]


def _jpeg(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """A field of one segment: its marker, its length, or a byte or short of its body (sizes, tables)."""
    places = [m.start() for m in re.finditer(rb"\xff[\xc0-\xfe]", data)]
    if not places:
        return _numbers(data, others, rng)
    frames = [p for p in places if data[p + 1] in (0xC0, 0xC1, 0xC2)]
    at = int(rng.choice(frames if frames and rng.random() < 0.4 else places))
    what = rng.integers(5)
    if what == 0:
        return _put(data, at + 1, bytes([int(rng.integers(0xC0, 0xFF))]))
    if what == 1:
        return _put(data, at + 2, struct.pack(">H", int(rng.choice(_INTEGERS)) & 0xFFFF))
    inside = at + 4 + int(rng.integers(16 if what < 4 else 200))
    if what == 2:
        return _put(data, inside, struct.pack(">H", int(rng.choice(_INTEGERS)) & 0xFFFF))
    return _put(data, inside, bytes([int(rng.integers(256))]))


def _png(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """A byte or a number of one chunk, with its checksum put right: a wrong one is refused at once."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">L", data, at)
        if at + 12 + length > len(data):
            break
        chunks.append((at, length))
        at += 12 + length
    if not chunks:
        return _numbers(data, others, rng)
    at, length = chunks[0 if rng.random() < 0.5 else int(rng.integers(len(chunks)))]
    body = bytearray(data[at + 4 : at + 8 + length])
    place = int(rng.integers(len(body)))
    if place + 4 <= len(body) and place >= 4 and rng.random() < 0.6:
        body[place : place + 4] = struct.pack(">L", int(rng.choice(_INTEGERS)))
    else:
        body[place] = int(rng.integers(256))
    return data[: at + 4] + bytes(body) + struct.pack(">L", zlib.crc32(body)) + data[at + 8 + length + 4 :]


def _npy(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """Another shape or type in the header."""
    head = data[10:128]
    if rng.random() < 0.5:
        shape = ", ".join(
            str(int(rng.choice(_INTEGERS)) * int(rng.choice([1, -1, 1]))) for _ in range(rng.integers(6))
        )
        head = re.sub(rb"\(.*?\)", f"({shape},)".encode(), head)
    else:
        kind = str(rng.choice(_TYPES))
        head = re.sub(rb"'[<>|=][^']*'", lambda _: repr(kind).encode(), head)
    return data[:10] + head[:118].ljust(118) + data[128:]


def _toml(data: bytes, others: list[bytes], rng: Rng) -> bytes:
    """A value, key or line replaced, moved, taken out or doubled."""
    lines = data.split(b"\n")
    i, j = (int(v) for v in rng.integers(len(lines), size=2))
    what, word = rng.integers(6), str(rng.choice(_WORDS)).encode()
    key, equals, _ = lines[i].partition(b" = ")
    if what <= 2 and equals:
        lines[i] = key + b" = " + word
    elif what == 3:
        lines[i] = lines[j]
    elif what == 4:
        new = [b"name", b"stage", b"gate", b"params", b"options", word][int(rng.integers(6))]
        lines[i] = re.sub(rb"[A-Za-z_]+", lambda _: new, lines[i], count=1)
    else:
        del lines[i]
    return b"\n".join(lines)
