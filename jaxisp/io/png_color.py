"""What the chunks of a PNG say of its colours: cICP before iCCP before sRGB before gAMA and cHRM."""

import struct
import zlib

from jaxisp.color import srgb_to_linear
from jaxisp.io.color_space import D65, SRGB, SRGB_PRIMARIES, ColorSpace, Curve, gamma, of_primaries, rec709

_ILLUMINANT_C, _DCI = (0.310, 0.316), (0.314, 0.351)
_PRIMARIES = {
    1: (SRGB_PRIMARIES, D65),
    4: (((0.67, 0.33), (0.21, 0.71), (0.14, 0.08)), _ILLUMINANT_C),
    5: (((0.64, 0.33), (0.29, 0.60), (0.15, 0.06)), D65),
    6: (((0.63, 0.34), (0.31, 0.595), (0.155, 0.07)), D65),
    7: (((0.63, 0.34), (0.31, 0.595), (0.155, 0.07)), D65),
    9: (((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)), D65),
    11: (((0.68, 0.32), (0.265, 0.69), (0.15, 0.06)), _DCI),
    12: (((0.68, 0.32), (0.265, 0.69), (0.15, 0.06)), D65),
    22: (((0.63, 0.34), (0.295, 0.605), (0.155, 0.077)), D65),
}
"""By number in ITU-T H.273, table 2."""
_CURVES: dict[int, Curve] = {
    1: rec709, 6: rec709, 14: rec709, 15: rec709, 4: gamma(2.2), 5: gamma(2.8), 8: gamma(1.0),
    13: srgb_to_linear,
}  # fmt: skip
"""By number in table 3."""
_UNSUPPORTED = {16: "PQ (HDR)", 18: "HLG (HDR)"}
_MOST_BYTES = 16 << 20  # of a profile
_SAME = 0.002  # of a chromaticity
_APPROXIMATE = 0.01  # share by which gAMA may be off 1 / 2.2


def color_chunks(data: bytes) -> dict[bytes, bytes]:
    """The chunks before the pixels, the first of each name."""
    found: dict[bytes, bytes] = {}
    at = 8
    while at + 8 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        if name == b"IDAT":
            break
        found.setdefault(name, data[at + 8 : at + 8 + length])
        at += 12 + length
    return found


def png_space(chunks: dict[bytes, bytes]) -> tuple[ColorSpace | None, bytes | None]:
    """The colour space that a PNG states, or the ICC profile; neither where it states none.

    Raises:
        ValueError: what it states is damaged, or cannot be computed; in words.

    Source: PNG Specification (Third Edition), 4.3 and 11.3.2; ITU-T H.273.
    """
    if b"cICP" in chunks:
        return _coded(chunks[b"cICP"]), None
    if b"iCCP" in chunks:
        return None, _profile(chunks[b"iCCP"])
    if b"sRGB" in chunks:
        return SRGB, None
    if b"gAMA" in chunks or b"cHRM" in chunks:
        return _measured(chunks.get(b"gAMA"), chunks.get(b"cHRM")), None
    return None, None


def _coded(body: bytes) -> ColorSpace:
    if len(body) != 4:
        raise ValueError(f"a cICP of {len(body)} bytes, expected 4")
    primaries, transfer, matrix, full = body
    if matrix or full != 1:
        raise ValueError("a cICP of luma and chroma or of a narrow range, expected RGB of full range")
    if primaries not in _PRIMARIES or transfer not in _CURVES:
        what = _UNSUPPORTED.get(transfer, f"primaries {primaries} and transfer {transfer}")
        raise ValueError(f"a cICP of {what}, which is not converted to sRGB; expected SDR")
    corners, white = _PRIMARIES[primaries]
    return of_primaries(corners, _CURVES[transfer], white)


def _profile(body: bytes) -> bytes:
    name, _, rest = body.partition(b"\0")
    if not name or rest[:1] != b"\0":
        raise ValueError("an iCCP chunk that is cut short")
    try:
        unpack = zlib.decompressobj()
        profile = unpack.decompress(rest[1:], _MOST_BYTES)
    except zlib.error as error:
        raise ValueError("an iCCP chunk that cannot be unpacked") from error
    if not unpack.eof:
        raise ValueError("an iCCP chunk that cannot be unpacked")
    return profile


def _measured(gama: bytes | None, chrm: bytes | None) -> ColorSpace:
    """Of gAMA and cHRM. A gamma of 1 / 2.2 with sRGB's primaries or none is how sRGB itself is to be stated
    for those who do not know its chunk."""
    white, corners = D65, SRGB_PRIMARIES
    if chrm is not None:
        if len(chrm) != 32:
            raise ValueError(f"a cHRM of {len(chrm)} bytes, expected 32")
        values = [v / 100000 for v in struct.unpack(">8I", chrm)]
        given = [(values[i], values[i + 1]) for i in (0, 2, 4, 6)]
        known = (D65, *SRGB_PRIMARIES)
        if any(abs(a - b) > _SAME for one, other in zip(given, known) for a, b in zip(one, other)):
            white, corners = given[0], (given[1], given[2], given[3])
    usual = corners is SRGB_PRIMARIES
    if gama is None:
        if usual:
            return SRGB
        raise ValueError("a cHRM of other primaries than sRGB's and no gAMA: its tone curve is not stated")
    if len(gama) != 4 or gama == bytes(4):
        raise ValueError("a gAMA of 0, expected more")
    exponent = 100000 / struct.unpack(">I", gama)[0]
    if usual and abs(exponent / 2.2 - 1) < _APPROXIMATE:
        return SRGB
    if not 0.1 <= exponent <= 10:
        raise ValueError(f"a gAMA of 1 / {exponent:.3g}, expected 0.1 to 10")
    return of_primaries(corners, gamma(exponent), white)
