"""What a fit saw, and what a RAW has beyond it."""

import numpy as np
import pytest

from jaxisp.camera import standard_camera
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit.seen import Seen, block_means, blocks
from jaxisp.io import read_raw
from jaxisp.io.dng import write_dng
from jaxisp.recipe import Recipe

GREY = np.linspace(0.05, 0.4, 200)[:, None] * np.ones(3)


def test_means_of_blocks_are_those_of_each_colour():
    mosaic = np.tile(np.asarray([[0.1, 0.2], [0.4, 0.3]]), (32, 24))
    found = block_means(mosaic, "GRBG", np.asarray([2.0, 1.0, 1.5]))
    assert found.shape == (4 * 3, 3)
    np.testing.assert_allclose(found, np.tile([0.4, 0.2, 0.6], (12, 1)))


def test_tones_and_hues_beyond_are_told_and_others_not():
    seen = Seen.of(GREY)
    assert seen.hues == () and seen.levels == pytest.approx((0.05, 0.4), rel=0.1)
    assert seen.beyond(GREY[::-1]) == []
    (dark,) = seen.beyond(np.concatenate([GREY, GREY[:50] / 8]))
    assert dark == "20 % darker than all that was fitted"
    (bright,) = seen.beyond(np.concatenate([GREY, np.full((50, 3), 0.9)]))
    assert bright.startswith("20 % brighter")
    (red,) = seen.beyond(np.concatenate([GREY, np.tile([0.5, 0.1, 0.1], (50, 1))]))
    assert red == "20 % red, a hue that was not fitted"
    again = Seen.of(np.concatenate([GREY, np.tile([0.5, 0.1, 0.1], (50, 1))]))
    assert again.hues == ("red",)
    assert Seen.from_dict(again.as_dict(), "camera") == again


def test_tones_that_lack_between_those_that_were_fitted_are_told():
    both = Seen.of(np.concatenate([GREY / 16, GREY + 0.5]))  # nothing from 1/32 to 1/2
    assert both.gaps == (2, 3, 4, 5)
    assert both.beyond(GREY / 16) == both.beyond(GREY + 0.5) == []
    (told,) = both.beyond(np.concatenate([GREY + 0.5, np.full((50, 3), 0.3)]))
    assert told == "20 % of tones that lack between those that were fitted"
    assert Seen.of(GREY).gaps == ()
    assert Seen.from_dict(both.as_dict(), "camera") == both


def camera(seen: dict) -> Recipe:
    plain = standard_camera("demosaic_bilinear")
    return Recipe(plain.chain, plain.prior, meta={"seen": seen} if seen else {})


def test_develop_warns_of_what_the_camera_was_not_fitted_on(folder, tmp_path, capsys):
    raw = str(next(folder.glob("*.dng")))
    seen = Seen.of(blocks(read_raw(raw)))
    camera(seen.as_dict()).save(tmp_path / "camera.toml")
    out = ["-o", str(tmp_path / "out.png")]
    assert main(["develop", raw, *out, "--camera", str(tmp_path / "camera.toml")]) == 0
    assert "not fitted" not in capsys.readouterr().err
    assert "green" not in seen.hues
    green = np.tile(np.asarray([[60, 600], [600, 60]], np.uint16), (64, 64))
    write_dng(tmp_path / "green.dng", green, cfa="RGGB", black=(0, 0, 0, 0), white=1023, color_matrix=None)
    assert (
        main(["develop", str(tmp_path / "green.dng"), *out, "--camera", str(tmp_path / "camera.toml")]) == 0
    )
    assert "100 % green, a hue that was not fitted" in capsys.readouterr().err


def test_a_camera_that_does_not_say_what_it_saw_is_taken_and_a_wrong_one_refused(folder, tmp_path):
    raw = str(next(folder.glob("*.dng")))
    for seen, code in ({}, 0), ({"levels": 1}, 2):
        camera(seen).save(tmp_path / "camera.toml")
        arguments = ["develop", raw, "-o", str(tmp_path / "out.png")]
        assert main([*arguments, "--camera", str(tmp_path / "camera.toml")]) == code
    with pytest.raises(InputError, match=r"meta\.seen"):
        Seen.from_dict({"levels": [0, 1], "hues": 3}, "camera")
