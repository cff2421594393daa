"""Sensor noise read off one picture, against the noise that was put there."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from jaxisp.cfa import PATTERNS
from jaxisp.fit.raw_noise import estimate_raw_noise, raw_noise
from jaxisp.io.raw import Raw

SHOT, READ = 4e-4, 2e-3
SHAPE = (512, 640)


def light(seed=0, texture=0.0):
    """Smooth light from nearly black to two thirds of white, all of them seen, part of it textured."""
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.standard_normal(SHAPE), 40)
    level = 0.002 + 0.65 * ((smooth - smooth.min()) / np.ptp(smooth)) ** 3
    fine = np.sin(np.arange(SHAPE[1]) * 0.9) * (np.arange(SHAPE[0]) < SHAPE[0] // 2)[:, None]
    return level * (1 + texture * fine)


def shot(level, seed=1):
    rng = np.random.default_rng(seed)
    return rng.poisson(level / SHOT) * SHOT + READ * rng.standard_normal(level.shape)


def std(found, level):
    return np.sqrt(found[..., 0] * level + found[..., 1] ** 2)


@pytest.mark.parametrize("cfa", PATTERNS)
def test_the_noise_that_was_added_is_found(cfa):
    found = estimate_raw_noise(shot(light()), cfa)
    for level, tolerance in (0.02, 0.14), (0.1, 0.1), (0.5, 0.14):  # three standard errors
        np.testing.assert_allclose(std(found, level), np.sqrt(SHOT * level + READ**2), rtol=tolerance)


def test_texture_is_not_taken_for_noise():
    found = estimate_raw_noise(shot(light(texture=0.3)), "RGGB")
    np.testing.assert_allclose(std(found, 0.2), np.sqrt(SHOT * 0.2 + READ**2), rtol=0.15)


def test_the_estimate_scales_with_the_picture():
    mosaic = shot(light())
    once, twice = (estimate_raw_noise(gain * mosaic, "BGGR") for gain in (0.5, 1.0))
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-9)


def test_what_cannot_show_its_noise_gives_none():
    for side in (0, 2, 15, 200):
        assert estimate_raw_noise(shot(light())[:side, :side], "RGGB") is None
    assert estimate_raw_noise(np.ones(SHAPE), "RGGB") is None
    assert estimate_raw_noise(np.zeros(SHAPE), "RGGB") is None


@pytest.mark.parametrize(
    "mosaic, cfa", [(np.full(SHAPE, np.nan), "RGGB"), (light(), "XYZW"), (light()[0], "RGGB")]
)
def test_what_is_no_mosaic_is_refused(mosaic, cfa):
    with pytest.raises(ValueError):
        estimate_raw_noise(mosaic, cfa)


def file(mosaic, white_balance, **facts):
    whole = (0, 0, *SHAPE)
    return Raw(
        Path("a.dng"),
        mosaic.astype(np.float32),
        "RGGB",
        np.zeros(4),
        1.0,
        np.asarray(white_balance),
        whole,
        whole,
        **facts,
    )


def test_a_balanced_file_shows_its_gains_in_its_noise():
    gains = np.asarray([2.4, 1.0, 1.7])
    mosaic = shot(light() / 2.6)
    mosaic[::2, ::2] *= gains[0]
    mosaic[1::2, 1::2] *= gains[2]
    found = raw_noise(file(mosaic, [1.0, 1.0, 1.0], white_balanced=True))
    np.testing.assert_allclose(found.gains, gains, rtol=0.15)
    assert found.shot == pytest.approx(SHOT, rel=0.12) and found.measured


def test_what_a_file_states_is_taken():
    profile = np.asarray([(1e-3, 0.01), (2e-3, 0.02), (3e-3, 0.03)])
    found = raw_noise(file(shot(light()), [2.0, 1.0, 1.5], noise_profile=profile))
    assert found == (2e-3, 0.02, (2.0, 1.0, 1.5), False)
