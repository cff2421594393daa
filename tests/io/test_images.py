"""Clean photographs: what is read, in which range, and what is refused."""

import contextlib
import io
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.io.images import read_image, write_png
from jaxisp.io.orientation import orient
from jaxisp.testing import smooth_image

PICTURE = np.rint(smooth_image((21, 34, 3)) * 255).astype(np.uint8)


def refused(path, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_image(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and words in text, text


def test_png_round_trip(tmp_path):
    path = tmp_path / "a.png"
    write_png(path, (PICTURE / 255).astype(np.float32))
    got = read_image(path)
    assert got.dtype == np.float32 and got.flags.c_contiguous
    np.testing.assert_array_equal(got, PICTURE.astype(np.float32) / 255)
    write_png(path, PICTURE)
    np.testing.assert_array_equal(read_image(path), got)


def test_write_png_cuts_rounds_and_refuses(tmp_path):
    path = tmp_path / "a.png"
    write_png(path, np.broadcast_to([-0.5, 0.4999 / 255, 1.7], (4, 5, 3)))
    np.testing.assert_array_equal(np.asarray(Image.open(path))[2, 3], [0, 0, 255])
    before = path.read_bytes()
    with pytest.raises(InputError, match="NaN"):
        write_png(path, np.full((4, 5, 3), np.inf))
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="cannot be written"):
        write_png(tmp_path / "none" / "a.png", PICTURE)


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_eight_bits_upright(tmp_path, name):
    """Whatever the format, the stated orientation is applied; a wrong suffix does no harm."""
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(PICTURE).save(tmp_path / name, exif=exif, **({"quality": 100} if name == "a.jpg" else {}))
    with Image.open(tmp_path / name) as image:
        stored = np.asarray(image) if name == "a.jpg" else PICTURE
    np.testing.assert_array_equal(read_image(tmp_path / name), orient(stored, 6).astype(np.float32) / 255)
    other = (tmp_path / name).rename(tmp_path / "b.jpeg")
    assert read_image(other).shape == (34, 21, 3)


@pytest.mark.parametrize("planar", ["contig", "separate"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_deep_tiff(tmp_path, planar, compression, rng):
    values = rng.integers(0, 65536, (11, 16, 3)).astype(np.uint16)
    for array, expected in ((values, values / 65535), ((values / 65535).astype(np.float32), values / 65535)):
        stored = array if planar == "contig" else np.moveaxis(array, -1, 0)
        tifffile.imwrite(
            tmp_path / "a.tif", stored, photometric="rgb", planarconfig=planar, compression=compression
        )
        np.testing.assert_allclose(read_image(tmp_path / "a.tif"), expected, atol=1e-7)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_npy(tmp_path, dtype):
    top = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1
    array = (np.linspace(0, 1, 5 * 7 * 3).reshape(5, 7, 3) * top).astype(dtype)
    np.save(tmp_path / "a.npy", array)
    got = read_image(tmp_path / "a.npy")
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, array / top, atol=1e-7)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.full((4, 5, 3), np.nan), "NaN"),
        (np.zeros((4, 5)), "expected (H, W, 3)"),
        (np.zeros((3, 4, 5)), "(3, 4, 5)"),
        (np.zeros((0, 5, 3)), "(0, 5, 3)"),
        (np.full((4, 5, 3), 255.0), "from 255 to 255"),
        (np.full((4, 5, 3), -0.1), "from -0.1"),
        (np.zeros((4, 5, 3), np.int32), "int32"),
        (np.array([None]), "damaged"),
    ],
)
def test_bad_npy(tmp_path, array, words):
    np.save(tmp_path / "a.npy", array)
    refused(tmp_path / "a.npy", words)


def _png16(color_type: int, channels: int) -> bytes:
    """A 16-bit PNG of 2x2 pixels, by hand."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">L", len(body)) + kind + body + struct.pack(">L", zlib.crc32(kind + body))

    rows = (b"\0" + bytes(range(4 * channels))) * 2
    head = struct.pack(">LLBBBBB", 2, 2, 16, color_type, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def test_refused_pictures(tmp_path):
    (tmp_path / "deep.png").write_bytes(_png16(2, 3))
    refused(tmp_path / "deep.png", "16-bit PNG")
    (tmp_path / "grey16.png").write_bytes(_png16(0, 1))
    refused(tmp_path / "grey16.png", "16-bit PNG")
    for mode, words in (("L", "grayscale"), ("LA", "grayscale"), ("P", "palette"), ("1", "black and white")):
        Image.new(mode, (8, 8)).save(tmp_path / "a.png")
        refused(tmp_path / "a.png", words)
    Image.new("L", (8, 8)).save(tmp_path / "a.jpg")
    refused(tmp_path / "a.jpg", "grayscale")
    Image.new("CMYK", (8, 8)).save(tmp_path / "a.tif")
    refused(tmp_path / "a.tif", "CMYK")
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((8, 8), np.uint16))
    refused(tmp_path / "b.tif", "1 samples of 16 bits")
    deep = np.full((8, 8, 3), 4095, np.uint16)
    tifffile.imwrite(tmp_path / "c.tif", deep, photometric="rgb", bitspersample=12)
    refused(tmp_path / "c.tif", "3 samples of 12 bits")
    tifffile.imwrite(tmp_path / "c.tif", np.full((8, 8, 3), np.nan, np.float32), photometric="rgb")
    refused(tmp_path / "c.tif", "NaN")


def test_alpha(tmp_path):
    opaque = np.dstack([PICTURE, np.full(PICTURE.shape[:2], 255, np.uint8)])
    Image.fromarray(opaque).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), PICTURE.astype(np.float32) / 255)
    opaque[3, 4, 3] = 254
    Image.fromarray(opaque).save(tmp_path / "a.png")
    refused(tmp_path / "a.png", "transparent")


def tiff(*entries: tuple[int, int, int, int], body: bytes = b"") -> bytes:
    """Little-endian: (tag, type, count, value) of one directory, and what follows it."""
    table = b"".join(struct.pack("<HHII", *entry) for entry in sorted(entries))
    return b"II*\0\x08\0\0\0" + struct.pack("<H", len(entries)) + table + bytes(4) + body


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((34675, 3, 1, 7), "tag 34675 holds no bytes"),
        ((256, 4, 1, 2**31), "damaged"),
        ((257, 4, 1, 2**32 - 1), "damaged"),
        ((273, 4, 1, 2**32 - 8), "damaged"),
        ((279, 4, 1, 2**32 - 1), None),
        ((278, 4, 1, 2**32 - 1), None),
    ],
)
@pytest.mark.parametrize("compression", [1, 5, 8, 32773])
def test_a_tiff_with_one_number_that_cannot_be(tmp_path, capfd, change, words, compression):
    """Nothing is printed, by libtiff neither, and nothing is raised but one line."""
    usual = {256: (3, 1, 2), 257: (3, 1, 2), 258: (3, 3, 146), 259: (3, 1, compression), 262: (3, 1, 2),
             273: (4, 1, 152), 277: (3, 1, 3), 278: (3, 1, 2), 279: (4, 1, 12)}  # fmt: skip
    usual[change[0]] = change[1:]
    body = bytes(146 - 14 - 12 * len(usual)) + struct.pack("<3H", 8, 8, 8) + bytes(range(12))
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(*((tag, *rest) for tag, rest in usual.items()), body=body))
    if words is None and compression == 1:
        assert read_image(path).shape == (2, 2, 3)
    else:
        refused(path, words if words and compression == 1 else "")
    assert capfd.readouterr() == ("", "")


def test_sums_of_damaged_numbers_are_not_warned_of(tmp_path, recwarn):
    """tifffile compares the bits of the samples, which many numbers make an array: found by guided inputs."""
    bits = np.resize(np.array([1e38, -3e38], "<f4"), 2000)
    entries = ((256, 3, 1, 2), (257, 3, 1, 2), (258, 11, bits.size, 74), (273, 4, 1, 74), (277, 3, 1, 2000))
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(*entries, body=bits.tobytes()))
    refused(path, "damaged")
    assert not recwarn.list


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "jpeg", "packbits"])
def test_what_libtiff_says_is_kept_back(tmp_path, capfd, compression):
    out = io.BytesIO()
    Image.fromarray(PICTURE).save(out, "TIFF", compression=compression)
    rng, data = np.random.default_rng(0), out.getvalue()
    for _ in range(12):
        damaged = bytearray(data)
        for at in rng.integers(8, len(data), 5):
            damaged[at] = rng.integers(256)
        (tmp_path / "a.tif").write_bytes(damaged)
        with contextlib.suppress(InputError):
            read_image(tmp_path / "a.tif")
    assert capfd.readouterr() == ("", "")


def test_damaged_files(tmp_path):
    out = io.BytesIO()
    Image.fromarray(PICTURE).save(out, "PNG")
    data = out.getvalue()
    for length in (5, 8, 20, 40, 200, len(data) // 2, len(data) - 30):
        (tmp_path / "a.png").write_bytes(data[:length])
        refused(tmp_path / "a.png", "")
    bomb = bytearray(data)
    bomb[16:24] = struct.pack(">LL", 60000, 60000)
    bomb[29:33] = struct.pack(">L", zlib.crc32(bytes(bomb[12:29])))
    (tmp_path / "a.png").write_bytes(bytes(bomb))
    refused(tmp_path / "a.png", "larger than any camera")
    for compression in (None, "zlib"):
        tifffile.imwrite(
            tmp_path / "b.tif", np.zeros((40, 40, 3), np.uint16), photometric="rgb", compression=compression
        )
        whole = (tmp_path / "b.tif").read_bytes()
        for length in (4, 30, len(whole) - 5):
            (tmp_path / "b.tif").write_bytes(whole[:length])
            refused(tmp_path / "b.tif", "")
    (tmp_path / "c.png").write_text("hello")
    refused(tmp_path / "c.png", "not a picture")
    refused(tmp_path / "none.png", "no such file")
    refused(tmp_path, "is a folder")
