"""Developing RAW files, against LibRaw and with what the file itself states."""

import dataclasses

import numpy as np
import pytest
import rawpy

from jaxisp.arrays.strips import ROWS
from jaxisp.camera import develop, high_percentile, params_for, shaded_mosaic, standard_camera, with_cfa
from jaxisp.errors import InputError
from jaxisp.io import read_raw
from jaxisp.pipeline import Chain, Gate, Shuffle, run, stage
from jaxisp.priors import Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.samples import PHONES, scene, write_pairs
from tests.io.samples import dng, mosaic


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", (96, 128))})
    return read_raw(folder / "astronaut.dng")


def test_the_standard_camera_agrees_with_libraw(raw):
    """Same demosaicking and colour; exposure is each program's own, so one gain in linear light is free."""
    ours = develop(raw, standard_camera("demosaic_bilinear"))
    with rawpy.imread(str(raw.path)) as file:
        theirs = file.postprocess(
            use_camera_wb=True,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            gamma=(2.4, 12.92),
            no_auto_bright=True,
        )
    assert ours.shape == theirs.shape and ours.dtype == np.float32
    a, b = (linear(x)[8:-8, 8:-8] for x in (ours, theirs / 255))
    bright = (b > 0.02) & (b < 0.9) & (a > 0.01) & (a < 0.9)
    assert bright.mean() > 0.5
    gains = [np.median(b[..., c][bright[..., c]] / a[..., c][bright[..., c]]) for c in range(3)]
    np.testing.assert_allclose(gains, np.mean(gains), rtol=0.005)
    error = np.abs(np.mean(gains) * a - b)[bright]
    assert np.median(error / b[bright]) < 0.01
    assert np.corrcoef(a[bright], b[bright])[0, 1] > 0.9998


def linear(encoded):
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_what_the_file_states_is_set(raw):
    params = params_for(standard_camera(), raw)
    np.testing.assert_allclose(params["mosaic_white_balance"].gains, raw.white_balance, rtol=1e-6)
    np.testing.assert_allclose(params["color_matrix"].matrix, raw.camera_to_srgb, rtol=1e-5)
    applied = dataclasses.replace(raw, white_balanced=True)
    np.testing.assert_array_equal(params_for(standard_camera(), applied)["mosaic_white_balance"].gains, 1)
    fixed = dataclasses.replace(standard_camera(), meta={})
    np.testing.assert_array_equal(params_for(fixed, raw)["mosaic_white_balance"].gains, 1)


def test_exposure_takes_the_highlights_to_white(raw):
    ev = params_for(standard_camera(), raw)["exposure"].exposure_ev
    dim = dataclasses.replace(raw, mosaic=raw.mosaic / 4)
    assert params_for(standard_camera(), dim)["exposure"].exposure_ev == pytest.approx(ev + 2, abs=0.05)
    np.testing.assert_allclose(develop(dim).mean((0, 1)), develop(raw).mean((0, 1)), atol=0.01)
    black = dataclasses.replace(raw, mosaic=np.zeros_like(raw.mosaic))
    assert params_for(standard_camera(), black)["exposure"].exposure_ev == 5


def test_the_baseline_exposure_is_a_gain_in_linear_light(raw):
    """What brings highlights to white is at least that of the file; none is taken back."""
    light = np.full_like(raw.mosaic, 0.4)
    light[::4] = 1  # so that there is nothing to brighten
    full = dataclasses.replace(raw, mosaic=light, white_balance=np.ones(3))

    def exposure(ev):
        own = dataclasses.replace(full, baseline_exposure=ev)
        return float(params_for(standard_camera(), own)["exposure"].exposure_ev)

    assert [exposure(ev) for ev in (0.0, 1.0, 2.5, -1.0)] == [0, 1, 2.5, 0]
    flat = dataclasses.replace(full, camera_to_srgb=np.eye(3))
    camera = standard_camera("demosaic_bilinear")
    once, twice = (develop(dataclasses.replace(flat, baseline_exposure=ev), camera) for ev in (0.0, 1.0))
    np.testing.assert_allclose(linear(twice)[2::4], 2 * linear(once)[2::4], rtol=0.02)
    dim = dataclasses.replace(full, mosaic=full.mosaic / 4)
    dim = dataclasses.replace(dim, baseline_exposure=1.0)
    assert params_for(standard_camera(), dim)["exposure"].exposure_ev == pytest.approx(2)


def test_pixels_that_are_not_square_are_made_so(raw, tmp_path):
    """DefaultScale states the width first; twice as wide, each pair of columns has the mean of one before."""
    scale = [(50718, 5, 2, (2, 1, 1, 1))]
    read = read_raw(dng(tmp_path / "a.dng", mosaic(64, 96), orientation=6, extra_tags=scale))
    assert read.scale == (1, 2) and read.notes == ()
    picture = develop(read)
    assert picture.shape == (192, 64, 3)
    plain = develop(dataclasses.replace(read, scale=(1.0, 1.0)))
    middle = picture.reshape(96, 2, 64, 3).mean(1)[4:-4]
    np.testing.assert_allclose(middle.mean(), plain[4:-4].mean(), atol=2e-3)
    assert np.corrcoef(middle.ravel(), plain[4:-4].ravel())[0, 1] > 0.99


def test_the_picture_is_turned_upright(raw):
    upright = develop(dataclasses.replace(raw, orientation=1))
    turned = develop(dataclasses.replace(raw, orientation=6))
    np.testing.assert_array_equal(turned, np.rot90(upright, -1))


def test_a_gain_map_is_applied(raw):
    assert shaded_mosaic(raw) is raw.mosaic
    shaded = type("Shaded", (), {"mosaic": raw.mosaic, "shading": np.full_like(raw.mosaic, 1.5)})
    np.testing.assert_allclose(shaded_mosaic(shaded), 1.5 * raw.mosaic)


def test_the_pattern_reaches_every_stage_that_needs_it():
    chain = Chain(
        (Gate(stage("green_imbalance")), Shuffle((stage("mosaic_white_balance"),)), stage("demosaic_ahd"))
    )
    patterns = [s.options["cfa"] for s in with_cfa(chain, "BGGR").stages()]
    assert patterns == ["BGGR"] * 3
    assert stage("clip") == with_cfa(stage("clip"), "BGGR")


def test_a_frame_is_developed_in_strips(raw):
    camera = standard_camera("demosaic_hibbard")
    assert raw.mosaic.shape[0] > ROWS + 2 * camera.chain.reach
    chain = with_cfa(camera.chain, raw.cfa)
    whole = np.clip(run(chain, params_for(camera, raw), raw.mosaic), 0, 1)
    np.testing.assert_allclose(develop(raw, camera), whole, atol=1e-6)


def test_a_recipe_for_photographs_develops_nothing(raw):
    with pytest.raises(InputError, match="needs mosaic into encoded sRGB"):
        develop(raw, RECIPES["awgn"]())


def test_a_camera_that_is_drawn_develops_nothing(raw):
    camera = standard_camera()
    drawn = dataclasses.replace(camera.prior["exposure"], exposure_ev=Uniform(-1.0, 1.0))
    with pytest.raises(InputError, match="exposure is drawn at random"):
        develop(raw, Recipe(camera.chain, camera.prior | {"exposure": drawn}))


def test_a_camera_goes_to_toml_and_back(raw, tmp_path):
    camera = standard_camera("demosaic_malvar")
    camera.save(tmp_path / "c.toml")
    back = Recipe.load(tmp_path / "c.toml")
    assert back == camera
    np.testing.assert_array_equal(develop(raw, back), develop(raw, camera))


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (40, 70), (301, 203)])
@pytest.mark.parametrize("draw", ["gamma", "few levels", "one level", "brightest where nobody looks"])
def test_high_percentile_is_numpys(shape, draw):
    rng = np.random.default_rng(0)
    plane = rng.gamma(2, 0.1, shape).astype(np.float32)
    if draw == "few levels":
        plane = np.round(5 * plane) / 5
    elif draw == "one level":
        plane[:] = 0.25
    elif draw == "brightest where nobody looks":  # the sample is of the brightest pixels alone
        plane[::9, ::7] = 9
    want = np.percentile(plane.astype(np.float64), 99)
    assert high_percentile(plane, 99) == pytest.approx(want, rel=1e-5)
