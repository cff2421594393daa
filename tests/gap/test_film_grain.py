"""Grain is told from what only looks random."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.film_grain import Residual, grain_trial, with_grain
from jaxisp.gap.search.trial import Bars, Trial

RAW = CRITERIA["raw+jpeg"]
_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16 - 0.47


@pytest.fixture(scope="module")
def pictures():
    """(4, 136, 136, 3) RGB in [0, 1]: smooth colours with a little texture."""
    rng = np.random.default_rng(0)
    wide, fine = (gaussian_filter(rng.standard_normal((4, 136, 136, 3)), (0, s, s, 0)) for s in (16, 2))
    return np.clip(0.5 + 0.15 * wide / wide.std() + 0.02 * fine / fine.std(), 0.05, 0.95)


def grain(pictures):
    noise = np.random.default_rng(1).standard_normal(pictures.shape[:-1])
    return pictures + 0.015 * noise[..., None]


def posterised(pictures):
    return np.rint(pictures * 20) / 20


def dithered(pictures):
    return np.rint(pictures * 14 + np.tile(_BAYER, (34, 34))[..., None]) / 14


def greyed(pictures):
    """Chroma beyond a limit is cut to it."""
    grey = pictures.mean(-1, keepdims=True)
    chroma = np.abs(pictures - grey).max(-1, keepdims=True)
    return grey + (pictures - grey) * np.minimum(1, 0.08 / chroma)


def found(shown, filed, explained=None):
    current, target = to_steps(shown).astype(float), to_steps(filed).astype(float)
    counts = np.full(len(shown), 136.0**2)
    seen = Residual(target, current, np.ones(target.shape[:-1]), counts, Split((0, 2), (1, 3)))
    scale = float(((target - current) ** 2).sum(-1).mean())
    best = current if explained is None else to_steps(explained).astype(float)
    return grain_trial(seen, np.zeros_like(target), np.zeros(1), scale, 0.05, best)


def test_noise_is_grain(pictures):
    trial = found(pictures, grain(pictures))
    assert trial.accepted(RAW) and trial.closed > 0.8
    assert trial.params["std"] * np.sqrt(3) == pytest.approx(0.015, rel=0.15)


def noisy(seed=3):
    """Uniform noise of a sensor in a smooth picture, demosaicked by a filter, and by a choice of two."""
    rng = np.random.default_rng(seed)
    wide = gaussian_filter(rng.standard_normal((4, 136, 136, 3)), (0, 16, 16, 0))
    noise = 0.02 * rng.standard_normal(wide.shape)
    across, down = (gaussian_filter(noise, (0, *size, 0)) for size in ((0.3, 1.0), (1.0, 0.3)))
    chosen = np.where(
        np.abs(across).sum(-1, keepdims=True) < np.abs(down).sum(-1, keepdims=True), across, down
    )
    smooth = 0.5 + 0.1 * wide / wide.std()
    return smooth + 0.5 * (across + down), smooth + chosen


def test_another_demosaicker_is_not_grain():
    """Its error is as fine as grain and no filter of the picture predicts it, but it grows with the noise."""
    shown, filed = noisy()
    assert with_grain([], found(shown, filed), 0.0, RAW) == []
    assert found(shown, filed).closed < 0.15
    grainy = found(shown, grain(filed))
    assert grainy.params["std"] * np.sqrt(3) == pytest.approx(0.015, rel=0.2)


def test_what_an_effect_explains_is_not_grain():
    """Here the effect is noise that is known: all of it, and then all but grain."""
    shown, _ = noisy()
    known = shown + 0.01 * np.random.default_rng(5).standard_normal(shown.shape)
    assert found(shown, known).closed > 0.8
    assert found(shown, known, known).closed == 0
    beside = found(shown, grain(known), known)
    assert beside.params["std"] * np.sqrt(3) == pytest.approx(0.015, rel=0.15)


@pytest.mark.parametrize("filed", [posterised, dithered, greyed])
def test_what_follows_the_picture_is_not(pictures, filed):
    trial = found(pictures, filed(pictures))
    assert trial.closed < 0.4
    assert with_grain([], trial, 0.0, RAW) == []


def trial(before, after):
    closed = (before - after) / 10
    return Trial("film_grain", np.zeros(1), before, after, closed, closed - 0.05, closed + 0.05, Bars(0.05))


def test_grain_must_make_half_of_what_is_left():
    assert with_grain([], trial(11.0, 7.0), 1.0, RAW) == []
    assert with_grain([], trial(11.0, 5.0), 1.0, RAW)
