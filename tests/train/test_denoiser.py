"""Files through a denoiser: one that fails is listed, the others are written."""

import numpy as np
import pytest
from flax import nnx
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.io import read_image, write_png
from jaxisp.io.exif import new_exif
from jaxisp.models.apply import Denoiser, denoise_files
from jaxisp.process import memory
from jaxisp.testing import smooth_image
from jaxisp.train.evaluate import align_dataset
from tests.io.profiles import COLORANTS, SRGB_CURVE, parametric, profile


class Model(nnx.Module):
    """The identity, but for black pictures."""

    reach, multiple = 2, 1

    def __call__(self, x):
        return x / x.max() * x.max()


@pytest.fixture
def pictures(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    for name, level in (("a", 0.5), ("c", 0.8)):
        write_png(folder / f"{name}.png", np.full((8, 9, 3), level))
    return folder


def test_a_picture_that_becomes_nan_is_listed_and_the_others_are_written(pictures, tmp_path):
    write_png(pictures / "b.png", np.zeros((8, 9, 3)))
    result = denoise_files(Denoiser(Model()), [pictures], tmp_path / "out")
    assert result["images"] == 2 and sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "a.png",
        "c.png",
    ]
    assert result["failed"] == [
        (str(pictures / "b.png"), f"{pictures / 'b.png'}: the network makes NaN of it")
    ]


def test_a_name_is_taken_by_a_picture_that_was_written(pictures, tmp_path):
    (pictures / "a.jpg").write_bytes(b"broken")
    np.save(pictures / "c.npy", np.full((8, 9, 3), 0.1))  # before c.png
    result = denoise_files(Denoiser(Model()), [pictures], tmp_path / "out")
    assert [file for file, _ in result["failed"]] == [str(pictures / "a.jpg"), str(pictures / "c.png")]
    assert "has the same name" in result["failed"][1][1] and result["images"] == 2
    assert read_image(tmp_path / "out" / "a.png").mean() == pytest.approx(0.5, abs=0.01)
    assert read_image(tmp_path / "out" / "c.png").mean() == pytest.approx(0.1, abs=0.01)


def test_programs_of_many_sizes_are_forgotten(tmp_path, monkeypatch):
    """Every second size where one is kept; pairs of `evaluate` likewise."""
    forgotten = []
    monkeypatch.setattr(memory, "MOST_SIZES", 1)
    monkeypatch.setattr(memory, "forget_compiled", lambda: forgotten.append(1))
    (tmp_path / "in").mkdir()
    for i in range(3):
        picture = smooth_image((32 + 8 * (i > 0), 40, 3), i)
        for name in (f"{i}.clean.png", f"{i}.noisy.png"):
            write_png(tmp_path / "in" / name, picture)
    inputs = [tmp_path / "in" / f"{i}.noisy.png" for i in range(3)]
    assert denoise_files(Denoiser(Model()), inputs, tmp_path / "out")["images"] == 3 and len(forgotten) == 1
    pairs = list(align_dataset(tmp_path / "in"))
    assert [pair.name for pair in pairs] == ["0", "1", "2"] and len(forgotten) == 2


def test_a_tile_that_is_too_small_is_one_error(pictures, tmp_path):
    with pytest.raises(InputError, match="a tile of 4 px is too small"):
        denoise_files(Denoiser(Model()), [pictures], tmp_path / "out", tile=4)


class Darker(nnx.Module):
    """Half of what it is given."""

    reach, multiple = 2, 1

    def __call__(self, x):
        return x / 2


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_exif_profile_and_colours_stay(kind, tmp_path):
    exif = new_exif(6, make="Maker", model="Model 1")
    p3 = profile("Display P3", COLORANTS["Display P3"], parametric(*SRGB_CURVE))
    path = tmp_path / f"photo.{kind.lower()}"
    pixels = np.full((16, 24, 3), (200, 80, 40), np.uint8)
    Image.fromarray(pixels).save(path, kind, exif=exif, icc_profile=p3)
    result = denoise_files(Denoiser(Darker()), [path], tmp_path / "OUT.png")
    assert result["images"] == 1 and not result["failed"]
    with Image.open(tmp_path / "OUT.png") as out:
        assert out.info["icc_profile"] == p3
        assert out.getexif()[0x010F] == "Maker" and out.getexif()[0x0112] == 6
        assert out.size == (24, 16)  # as it was stored
        np.testing.assert_allclose(np.asarray(out), pixels / 2, atol=3)
    before, after = (read_image(p) for p in (path, tmp_path / "OUT.png"))
    assert after.shape == before.shape == (24, 16, 3)
    # both are read as Display P3, whose curve is sRGB's
    np.testing.assert_allclose(after[..., 0], before[..., 0] / 2, atol=0.03)


def test_other_files_are_written_in_srgb(tmp_path):
    np.save(tmp_path / "photo.npy", np.full((8, 9, 3), 0.5, np.float32))
    denoise_files(Denoiser(Darker()), [tmp_path / "photo.npy"], tmp_path / "out")
    np.testing.assert_allclose(read_image(tmp_path / "out" / "photo.png"), 0.25, atol=0.002)


def test_a_strength_of_a_half_takes_off_half(pictures, tmp_path):
    denoise_files(Denoiser(Darker()), [pictures / "c.png"], tmp_path / "c.png", strength=0.5)
    np.testing.assert_allclose(read_image(tmp_path / "c.png"), 0.6, atol=0.003)


def test_one_file_for_two_pictures_is_refused(pictures, tmp_path):
    with pytest.raises(InputError, match=r"out\.png: is one file, and there are 2 pictures"):
        denoise_files(Denoiser(Darker()), [pictures], tmp_path / "out.png")
    result = denoise_files(Denoiser(Darker()), [pictures / "a.png"], pictures / "a.png")
    assert not result["images"] and "has no place for its result" in result["failed"][0][1]
