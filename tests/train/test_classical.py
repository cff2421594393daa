"""Classical denoisers: the noise level, strengths by it or given, and what they take off."""

import importlib.util

import numpy as np
import pytest
from scipy import ndimage

from experiments.denoisers.strengths import choose
from jaxisp.errors import InputError
from jaxisp.train.classical import LEVELS, METHODS, Classical, noise_level, parse_methods


def scene(h, w):
    """A ramp on the left, stripes on the right, steps across."""
    y, x = np.mgrid[:h, :w]
    plane = 0.35 + 0.1 * x / w + 0.2 * (y > h // 2) + 0.15 * np.sin(1.5 * x) * (x > w // 2)
    return np.stack([plane, plane - 0.05, 0.8 - plane], axis=-1)


HERE = [name for name in METHODS if not Classical(name).missing()]


@pytest.mark.parametrize("std", [1 / 255, 4 / 255, 0.1])
@pytest.mark.parametrize("soft", [0.0, 0.6])
def test_noise_is_measured_white_or_not(std, soft, rng):
    noise = ndimage.gaussian_filter(rng.standard_normal((160, 176, 3)), (soft, soft, 0))
    noisy = scene(160, 176) + std * noise / noise.std()
    assert noise_level(noisy) == pytest.approx(std, rel=0.25)
    assert noise_level(np.clip(noisy - 0.6, 0, 1)) > 0  # black nearly everywhere


@pytest.mark.parametrize("name", HERE)
def test_white_noise_is_taken_off(name, rng):
    clean = scene(64, 72)
    noisy = np.float32(np.clip(clean + 0.05 * rng.standard_normal(clean.shape), 0, 1))
    before, after = (((image - clean) ** 2).mean() for image in (noisy, Classical(name)(noisy)))
    assert after < 0.6 * before
    assert Classical(name, Classical(name).strength(noisy))(noisy) == pytest.approx(Classical(name)(noisy))


def test_a_gaussian_is_as_wide_as_asked(rng):
    image = np.zeros((41, 41, 3))
    image[20, 20] = 1
    out = Classical("gaussian", 2.0)(image)[..., 0].astype(float)
    y = np.arange(41) - 20
    assert out.sum() == pytest.approx(1, abs=1e-5)
    assert (out.sum(1) * y**2).sum() == pytest.approx(4, rel=0.01)


def test_strengths_go_with_the_noise(rng):
    images = [0.5 + std * rng.standard_normal((96, 96, 3)) for std in (0.3 / 255, 0.02, 0.4)]
    low, middle, high = (Classical("tv").strength(image) for image in images)
    ratios = METHODS["tv"].strengths
    assert low == pytest.approx(ratios[0] * noise_level(images[0]))  # beyond the table: the nearest ratio
    assert high == pytest.approx(ratios[-1] * noise_level(images[2]))
    assert low < middle < high


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["median"], "no method named 'median'"),
        (["tv=much"], "a number"),
        (["tv=0"], "above 0"),
        (["tv=nan"], "above 0"),
        (["tv", "tv=1"], "twice"),
        ([], "no method given"),
    ],
)
def test_methods_that_cannot_be(texts, message):
    with pytest.raises(InputError, match=message):
        parse_methods(texts)


def test_what_is_missing_is_said(monkeypatch):
    assert Classical("gaussian").missing() is None
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert Classical("wavelet").missing() == "PyWavelets"


def test_a_strength_is_chosen_by_pictures_of_that_noise():
    levels = np.repeat(LEVELS, 2)
    best = np.repeat(np.arange(len(LEVELS)), 2)
    figures = -np.abs(np.arange(len(LEVELS)) - best[:, None]) + np.linspace(20, 40, 12)[:, None]
    strengths = tuple(float(n) for n in range(len(LEVELS)))
    assert choose(levels, figures, strengths) == strengths
