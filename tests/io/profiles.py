"""ICC profiles that tests write for themselves: three colorants under D50 and one curve."""

import struct

import colour
import numpy as np

D50 = (0.9642, 1.0, 0.8249)
GAMMA_1 = b"curv" + bytes(8)
SRGB_CURVE = (3, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))


def _colorants(name: str) -> np.ndarray:
    """(3, 3) rows: CIE XYZ of red, green and blue, adapted to D50 by Bradford, of colour-science's space."""
    space = colour.RGB_COLOURSPACES[name]
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        colour.xy_to_XYZ(space.whitepoint), np.array(D50), transform="Bradford"
    )
    return (adapt @ colour.models.normalised_primary_matrix(space.primaries, space.whitepoint)).T


COLORANTS = {
    name: _colorants(name)
    for name in ("sRGB", "Display P3", "Adobe RGB (1998)", "ProPhoto RGB", "ITU-R BT.2020")
}


def fixed(*values: float) -> bytes:
    return b"".join(struct.pack(">i", round(v * 65536)) for v in values)


def power(gamma: float) -> bytes:
    return b"curv" + struct.pack(">IIH", 0, 1, round(gamma * 256)) + bytes(2)


def sampled(values) -> bytes:
    codes = np.rint(np.asarray(values) * 65535).astype(">u2").tobytes()
    return b"curv" + struct.pack(">II", 0, len(values)) + codes + bytes(-len(codes) % 4)


def parametric(kind: int, numbers) -> bytes:
    return b"para" + struct.pack(">IHH", 0, kind, 0) + fixed(*numbers)


def grey_tables() -> bytes:
    """An A2B0 of two points an axis (lut8Type) that makes CIELAB greys of all: lightness by the sum."""
    corners = [(85 * (r + g + b), 128, 128) for r in (0, 1) for g in (0, 1) for b in (0, 1)]
    lines = bytes(range(256)) * 3
    head = b"mft1" + bytes(4) + bytes((3, 3, 2, 0)) + fixed(1, 0, 0, 0, 1, 0, 0, 0, 1)
    return head + lines + bytes(v for corner in corners for v in corner) + lines


def profile(
    name: str, colorants, curve: bytes, *, leave_out: bytes = b"", tables: bytes = b"", **fields: bytes
) -> bytes:
    """A display profile of that description; `fields` replace parts of its header."""
    text = name.encode() + b"\0"
    tags = {b"desc": b"desc" + struct.pack(">II", 0, len(text)) + text + bytes(78 + -len(text) % 4)}
    tags[b"wtpt"] = b"XYZ \0\0\0\0" + fixed(*D50)
    tags |= {c + b"XYZ": b"XYZ \0\0\0\0" + fixed(*v) for c, v in zip((b"r", b"g", b"b"), colorants)}
    tags |= {c + b"TRC": curve for c in (b"r", b"g", b"b")}
    tags.pop(leave_out, None)
    if tables:
        tags[b"A2B0"] = tables
    table, body, at = b"", b"", 132 + 12 * len(tags)
    for tag, data in tags.items():
        table += tag + struct.pack(">II", at + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    kind, connection = fields.get("kind", b"RGB "), fields.get("connection", b"XYZ ")
    head = b"test\2\x40\0\0mntr" + kind + connection + struct.pack(">6H", 2024, 1, 1, 0, 0, 0) + b"acsp"
    head += bytes(24) + struct.pack(">I", 1) + fixed(*D50) + bytes(48)
    return struct.pack(">I", at + len(body)) + head + struct.pack(">I", len(tags)) + table + body
