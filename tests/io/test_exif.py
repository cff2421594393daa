"""EXIF of pictures: sensitivities over 16 bits, several values, text that is not ASCII; and its writing."""

import io

import numpy as np
import pytest
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.io import read_jpeg, write_jpeg
from jaxisp.io.jpeg import decode_jpeg

ISO, TYPE, OUTPUT, INDEX, SPEED = 0x8827, 0x8830, 0x8831, 0x8832, 0x8833
GREY = np.full((16, 16, 3), 128, np.uint8)


def stated(inner, **main):
    exif = Image.Exif()
    exif.update({271: "a", **{int(code): value for code, value in main.items()}})
    exif.get_ifd(0x8769).update(inner)
    out = io.BytesIO()
    Image.fromarray(GREY).save(out, "JPEG", exif=exif)
    return decode_jpeg(out.getvalue(), "a.jpg")


@pytest.mark.parametrize(
    ("tags", "iso"),
    [
        ({ISO: 400}, 400),
        ({ISO: 65535, TYPE: 2, INDEX: 102400}, 102400),
        ({ISO: 65535, TYPE: 1, OUTPUT: 80000, INDEX: 90000}, 80000),
        ({ISO: 65535, TYPE: 3, SPEED: 409600, OUTPUT: 1}, 409600),
        ({ISO: 65535, TYPE: 4, OUTPUT: 80000, INDEX: 102400}, 102400),
        ({ISO: 65535, INDEX: 204800}, 204800),
        ({ISO: 65535}, None),
        ({ISO: 102400}, 102400),  # Pillow writes 32 bits
        ({INDEX: 12800}, 12800),
        ({ISO: 0, TYPE: 2, INDEX: 3200}, 3200),
        ({ISO: (0, 200)}, 200),
        ({ISO: (100, 200)}, 100),
        ({ISO: 400, TYPE: 2, INDEX: 500}, 400),
        ({ISO: 0}, None),
        ({}, None),
    ],
)
def test_sensitivity(tags, iso):
    assert stated(tags).iso == iso


@pytest.mark.parametrize("iso", [50, 65534, 65535, 102400, 2**32 - 1, 3276800.0])
def test_any_sensitivity_is_written(tmp_path, iso):
    write_jpeg(tmp_path / "a.jpg", GREY, iso=iso)
    assert read_jpeg(tmp_path / "a.jpg").iso == iso
    with Image.open(tmp_path / "a.jpg") as picture:
        assert picture.getexif().get_ifd(0x8769)[ISO] == min(iso, 65535)


@pytest.mark.parametrize("iso", [2**32, 0.2, 0.5, 0.99, -100, float("nan"), float("inf")])
def test_a_sensitivity_that_no_tag_holds(tmp_path, iso):
    with pytest.raises(InputError, match=r"a.jpg: not written: ISO .* expected 1 to 4294967295"):
        write_jpeg(tmp_path / "a.jpg", GREY, iso=iso)
    assert not (tmp_path / "a.jpg").exists()


def test_text_that_is_not_ascii(tmp_path):
    write_jpeg(tmp_path / "a.jpg", GREY, make="Käma™ 写真", model="Ω-1")
    jpeg = read_jpeg(tmp_path / "a.jpg")
    assert (jpeg.make, jpeg.model) == ("Käma™ 写真", "Ω-1")
    old = stated({}, **{"271": "Käma".encode("latin-1"), "272": b"P\0\0"})
    assert (old.make, old.model) == ("Käma", "P")


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_an_orientation_that_is_none(orientation):
    assert stated({}, **{"274": orientation}).orientation == 1
