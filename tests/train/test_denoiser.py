"""Files through a denoiser: one that fails is listed, the others are written."""

import numpy as np
import pytest
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.io import read_image, write_png
from jaxisp.train.denoiser import Denoiser, denoise_files


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


def test_a_tile_that_is_too_small_is_one_error(pictures, tmp_path):
    with pytest.raises(InputError, match="a tile of 4 px is too small"):
        denoise_files(Denoiser(Model()), [pictures], tmp_path / "out", tile=4)
