"""JPEG files: tables, sampling, orientation, profile; and what is refused."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageCms

from jaxisp.errors import InputError
from jaxisp.io.jpeg import decode_jpeg, encode_jpeg, read_jpeg, write_jpeg
from jaxisp.io.jpeg_frame import frame_header
from jaxisp.io.orientation import orient
from jaxisp.jpeg.tables import quality_tables
from jaxisp.testing import smooth_image

PICTURE = np.rint(smooth_image((37, 50, 3)) * 255).astype(np.uint8)
ZIGZAG = sorted(range(64), key=lambda i: (sum(divmod(i, 8)), divmod(i, 8)[(sum(divmod(i, 8)) + 1) % 2]))


def refused(data: bytes, words: str) -> None:
    with pytest.raises(InputError) as caught:
        decode_jpeg(data, "some.jpg")
    text = str(caught.value)
    assert text.startswith("some.jpg: ") and "\n" not in text and words in text, text


def saved(image: Image.Image, **options) -> bytes:
    out = io.BytesIO()
    image.save(out, "JPEG", **options)
    return out.getvalue()


@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:2", "4:2:0"])
@pytest.mark.parametrize("quality", [1, 37, 75, 92, 100])
def test_round_trip_of_what_the_file_states(tmp_path, subsampling, quality):
    path = tmp_path / "a.jpg"
    write_jpeg(
        path, PICTURE, quality=quality, subsampling=subsampling, orientation=6, iso=320, make="M", model="P 1"
    )
    jpeg = read_jpeg(path)
    with Image.open(path) as image:
        np.testing.assert_array_equal(jpeg.pixels, np.asarray(image))
    assert (jpeg.subsampling, jpeg.quality, jpeg.orientation) == (subsampling, quality, 6)
    assert (jpeg.iso, jpeg.make, jpeg.model, jpeg.icc) == (320, "M", "P 1", None)
    np.testing.assert_array_equal(np.stack([jpeg.luma_table, jpeg.chroma_table]), quality_tables(quality))
    np.testing.assert_array_equal(jpeg.upright, orient(jpeg.image, 6))
    assert jpeg.image.dtype == np.float32 and jpeg.image.max() <= 1


def test_tables_are_in_natural_order(tmp_path):
    """The bytes of the DQT segment are the zigzag of what was asked for, and of what is read."""
    luma = np.arange(1, 65).reshape(8, 8)
    chroma = luma.T + 100
    write_jpeg(tmp_path / "a.jpg", PICTURE, qtables=(luma, chroma), subsampling="4:4:4")
    jpeg = read_jpeg(tmp_path / "a.jpg")
    np.testing.assert_array_equal(jpeg.luma_table, luma)
    np.testing.assert_array_equal(jpeg.chroma_table, chroma)
    data = (tmp_path / "a.jpg").read_bytes()
    at = data.index(b"\xff\xdb") + 5
    np.testing.assert_array_equal(list(data[at : at + 64]), luma.ravel()[ZIGZAG])


def test_a_table_that_stands_in_a_slot_later_is_not_that_of_earlier_scans():
    """Scans of one component each, all of one slot, which holds another table before each; libjpeg decodes
    the same pixels as of three slots."""
    steps = [np.full(64, 3), np.arange(1, 65), np.arange(300, 364)]
    tables = [b"\xff\xdb" + struct.pack(">HB64H", 131, 16, *own) for own in steps]
    code = b"\xff\xc4" + struct.pack(">HB16B2B", 21, 0, 0, 2, *(0,) * 14, 0, 3)  # DC: categories 0 and 3
    code += b"\xff\xc4" + struct.pack(">HB16BB", 20, 16, 0, 1, *(0,) * 14, 0)  # AC: end of block
    head = b"\xff\xc1" + struct.pack(">HBHHB", 17, 8, 8, 8, 3)

    def scan(i: int) -> bytes:  # one block: a DC of 4 or 7 or -7 steps, then its end, then ones
        bits = ("01" + ("100", "111", "000")[i] + "00").ljust(8, "1")
        return b"\xff\xda" + struct.pack(">HB5B", 8, 1, i + 1, 0, 0, 63, 0) + bytes([int(bits, 2)])

    def file(slots) -> bytes:
        frame = head + bytes(v for i in range(3) for v in (i + 1, 0x11, slots[i]))
        body = b"".join(tables[i] + scan(i) if len(set(slots)) == 1 else scan(i) for i in range(3))
        three = (
            b""
            if len(set(slots)) == 1
            else b"".join(t[:4] + bytes([16 + i]) + t[5:] for i, t in enumerate(tables))
        )
        return b"\xff\xd8" + three + code + frame + body + b"\xff\xd9"

    one, three = decode_jpeg(file((0, 0, 0)), "a"), decode_jpeg(file((0, 1, 2)), "a")
    np.testing.assert_array_equal(one.pixels, three.pixels)
    for jpeg in (one, three):
        assert [jpeg.tables[i].ravel()[ZIGZAG].tolist() for i in range(3)] == [own.tolist() for own in steps]
    refused(file((0, 0, 0)).replace(tables[0], b""), "damaged")


def test_standard_tables_are_annex_k():
    """First rows of tables K.1 and K.2 of ITU-T T.81."""
    luma, chroma = quality_tables(50)
    np.testing.assert_array_equal(luma[0], [16, 11, 10, 16, 24, 40, 51, 61])
    np.testing.assert_array_equal(luma[:, 0], [16, 12, 14, 14, 18, 24, 49, 72])
    np.testing.assert_array_equal(chroma[:3, :4], [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99]])
    for quality in (3, 49, 51, 90, 100):
        with Image.open(io.BytesIO(saved(Image.new("RGB", (8, 8)), quality=quality))) as image:
            np.testing.assert_array_equal(quality_tables(quality)[1].ravel(), image.quantization[1])


def test_progressive_and_rgb():
    progressive = decode_jpeg(saved(Image.fromarray(PICTURE), progressive=True, quality=95), "a")
    baseline = decode_jpeg(saved(Image.fromarray(PICTURE), quality=95), "a")
    np.testing.assert_array_equal(progressive.pixels, baseline.pixels)
    np.testing.assert_array_equal(progressive.luma_table, baseline.luma_table)
    rgb = decode_jpeg(saved(Image.fromarray(PICTURE), keep_rgb=True, quality=95), "a")
    assert rgb.color_space == "RGB" and rgb.subsampling == "4:4:4"
    assert decode_jpeg(saved(Image.fromarray(PICTURE)), "a").color_space == "YCbCr"


def test_other_samplings_are_named():
    assert frame_header(_with_factors([(1, 2), (1, 1), (1, 1)])).subsampling == "4:4:0"
    assert frame_header(_with_factors([(4, 1), (1, 1), (1, 1)])).subsampling == "4:1:1"
    assert frame_header(_with_factors([(2, 2), (2, 1), (1, 1)])).subsampling == "2x2,2x1,1x1"


def _with_factors(factors) -> bytes:
    body = struct.pack(">BHHB", 8, 16, 16, 3) + b"".join(
        bytes([i + 1, h * 16 + v, 0]) for i, (h, v) in enumerate(factors)
    )
    return b"\xff\xd8\xff\xff\xc0" + struct.pack(">H", len(body) + 2) + body + b"\xff\xd9"


def test_profile_is_converted_to_srgb():
    """A profile whose red and green primaries are swapped swaps the picture's channels back."""
    linear = _swapped_profile()
    data = saved(Image.fromarray(PICTURE), quality=100, subsampling=0, icc_profile=linear)
    stored, converted = decode_jpeg(data, "a", to_srgb=False), decode_jpeg(data, "a")
    assert not stored.converted and converted.converted and converted.icc == stored.icc == linear
    difference = converted.pixels.astype(int) - stored.pixels[..., [1, 0, 2]]
    assert np.abs(difference).max() <= 2


def _swapped_profile() -> bytes:
    """littleCMS's sRGB profile with its rXYZ and gXYZ tag names exchanged, and another description."""
    data = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    data = data.replace(b"rXYZ", b"????", 1).replace(b"gXYZ", b"rXYZ", 1).replace(b"????", b"gXYZ", 1)
    return data.replace("sRGB".encode("utf-16-be"), "abcd".encode("utf-16-be"))


def test_a_profile_anywhere_before_the_pixels_in_parts():
    """Pixels of the profile that swaps red and green, against those of the file with the profile in one part
    where encoders write it."""
    icc, plain = _swapped_profile(), saved(Image.fromarray(PICTURE), quality=100, subsampling=0)
    want = decode_jpeg(
        saved(Image.fromarray(PICTURE), quality=100, subsampling=0, icc_profile=icc), "a"
    ).pixels
    scan, half = plain.index(b"\xff\xda"), len(icc) // 2

    def part(number: int, of: int, data: bytes) -> bytes:
        body = b"ICC_PROFILE\0" + bytes((number, of)) + data
        return b"\xff\xe2" + struct.pack(">H", len(body) + 2) + body

    def put(at: int, *parts: bytes) -> bytes:
        return plain[:at] + b"".join(parts) + plain[at:]

    whole, halves = part(1, 1, icc), (part(1, 2, icc[:half]), part(2, 2, icc[half:]))
    files = [put(scan, whole), put(scan, *halves), put(2, *halves[::-1]), put(2, whole, whole)]
    files += [halves[0].join((plain[:2], plain[2:scan] + halves[1] + plain[scan:]))]
    for data in files:
        jpeg = decode_jpeg(data, "a")
        assert jpeg.converted and jpeg.icc == icc
        np.testing.assert_array_equal(jpeg.pixels, want)
    for lacking in (
        halves[:1],
        halves[1:],
        (halves[0], part(2, 3, icc[half:])),
        (whole, part(1, 1, icc[:-1])),
    ):
        refused(put(2, *lacking), "a part of its colour profile is missing")
    assert decode_jpeg(put(2, part(1, 1, b"")), "a").icc is None


def test_srgb_profile_changes_nothing():
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    jpeg = decode_jpeg(saved(Image.fromarray(PICTURE), icc_profile=icc), "a")
    assert not jpeg.converted and jpeg.icc == icc
    np.testing.assert_array_equal(jpeg.pixels, decode_jpeg(saved(Image.fromarray(PICTURE)), "a").pixels)


def test_refused():
    refused(saved(Image.new("L", (16, 16))), "grayscale")
    refused(saved(Image.new("CMYK", (16, 16))), "CMYK")
    good = saved(Image.fromarray(PICTURE), icc_profile=b"no profile")
    refused(good, "colour profile")
    deep = bytearray(saved(Image.fromarray(PICTURE)))
    at = deep.index(b"\xff\xc0")
    for bits in (12, 16):
        deep[at + 4] = bits
        refused(bytes(deep), f"{bits}-bit")
    deep[at + 4], deep[at + 1] = 8, 0xC3
    refused(bytes(deep), "lossless")
    refused(b"\x89PNG\r\n\x1a\n", "not a JPEG")
    huge = bytearray(saved(Image.fromarray(PICTURE)))
    huge[at + 5 : at + 9] = b"\xff\xdc\xff\xdc"
    refused(bytes(huge), "which no camera makes")


def test_missing_and_empty(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_jpeg(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").touch()
    with pytest.raises(InputError, match="0 bytes"):
        read_jpeg(tmp_path / "a.jpg")


@given(st.floats(0, 1), st.booleans())
def test_truncated(share, progressive):
    """A file cut short is refused; without its end mark alone it may still be whole."""
    data = saved(Image.fromarray(PICTURE), progressive=progressive)
    cut = data[: int(share * (len(data) - 3))]
    with pytest.raises(InputError) as caught:
        decode_jpeg(cut, "some.jpg")
    assert "\n" not in str(caught.value)


@given(st.integers(0, 700), st.integers(0, 255))
def test_changed_bytes_never_crash(at, value):
    data = bytearray(saved(Image.fromarray(PICTURE), icc_profile=_swapped_profile()[:400]))
    data[at] = value
    try:
        assert decode_jpeg(bytes(data), "some.jpg").pixels.dtype == np.uint8
    except InputError as error:
        assert "\n" not in str(error)


def test_writing_floats_and_bad_arguments(tmp_path):
    image = PICTURE / 255.0
    write_jpeg(tmp_path / "a.jpg", PICTURE)
    write_jpeg(tmp_path / "b.jpg", image.astype(np.float32) + 0.001)
    assert (tmp_path / "a.jpg").read_bytes() == (tmp_path / "b.jpg").read_bytes()
    write_jpeg(tmp_path / "c.jpg", 9 * image - 4)
    with pytest.raises(InputError, match="NaN"):
        write_jpeg(tmp_path / "d.jpg", np.full((8, 8, 3), np.nan))
    with pytest.raises(ValueError, match="subsampling"):
        encode_jpeg(PICTURE, subsampling="4:2:1")
    with pytest.raises(ValueError, match="H, W, 3"):
        write_jpeg(tmp_path / "d.jpg", np.zeros((8, 8)))
    assert not (tmp_path / "d.jpg").exists()
