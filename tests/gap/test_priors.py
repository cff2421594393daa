"""What the plain base of clean+noisy pairs is where the fitted pictures say nothing of a colour or a tone."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.base import mean
from jaxisp.gap.base.mean import fit_mean
from jaxisp.gap.base.palette import TYPICAL
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.base.priors import Prior, plain_prior, usual_matrix
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.pipeline import Params
from jaxisp.stages.balance import ColorMatrix
from jaxisp.testing import smooth_image

pytestmark = pytest.mark.optimised

SIDE = 64


def encoded(linear: np.ndarray) -> np.ndarray:
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-6) ** (1 / 2.4) - 0.055)


def pairs_of_few_colours() -> Pairs:
    """Two dark brown crops that are fitted, and two bright ones of all colours."""
    rng = np.random.default_rng(1)
    plane = [smooth_image((SIDE, SIDE), k) for k in range(12)]
    light = np.stack([np.stack(plane[3 * n : 3 * n + 3], -1) for n in range(4)])
    brown = light[:2, ..., :1] * np.array([0.2, 0.12, 0.08])
    light[:2] = brown * (1 + 0.05 * light[:2])
    seen = light @ (np.eye(3) + TYPICAL).T
    noisy = encoded(seen) + 0.03 * rng.normal(size=light.shape)
    pictures = np.round(255 * np.clip(noisy, 0, 1)) / 255
    mask = np.ones(light.shape[:3], bool)
    return Pairs(tuple("abcd"), jnp.asarray(light, jnp.float32), pictures.astype(np.float32), mask)


@pytest.fixture
def start() -> tuple[PixelObjective, Point]:
    gains = np.array([1.0, 0.8, 1.1])
    params: Params = {"color_matrix": ColorMatrix(matrix=np.float32(usual_matrix(gains)))}
    model = Camera(None).mean_model(params)
    objective = PixelObjective.of(pairs_of_few_colours())
    return objective, objective.at(model, np.zeros(len(model.coordinates)))


def test_the_usual_camera_costs_nothing_and_moves_nothing(start):
    prior = plain_prior(*start, np.array([1.0, 0.8, 1.1]), (0, 1))
    z = np.zeros(len(start[1].model.base))
    assert prior.weight > 0 and prior.penalty(z) == pytest.approx(0, abs=1e-9 * prior.weight)
    np.testing.assert_allclose(prior.normal(z)[1], 0, atol=1e-4 * prior.weight)
    z[2] = 1.0  # red takes as much from green
    assert prior.penalty(z) > prior.weight


def test_its_gradient_is_that_of_its_penalty(start):
    prior = plain_prior(*start, np.ones(3), (0, 1))
    z, step = np.random.default_rng(0).normal(size=len(start[1].model.base)), 1e-3
    slope = [(prior.penalty(z - d) - prior.penalty(z + d)) / (2 * step) for d in step * np.eye(len(z))]
    gram, right = prior.normal(z)
    np.testing.assert_allclose(2 * right, slope, rtol=1e-6, atol=1e-6 * np.abs(right).max())
    np.testing.assert_allclose(prior.normal(z + 0.1)[1], right - 0.1 * gram.sum(1), rtol=1e-6, atol=1e-9)


def test_colours_that_were_not_fitted_come_out_as_a_camera_has_them(monkeypatch):
    pairs = pairs_of_few_colours()

    def far_off() -> float:
        errors = fit_mean(None, pairs, Split((0, 1), (2, 3)), "RGGB").point.errors
        return float(errors[2:].mean() / errors[:2].mean())

    with_prior = far_off()
    nothing = Prior(np.zeros((1, 22)), np.zeros(1), 0.0)
    monkeypatch.setattr(mean, "plain_prior", lambda *a: nothing)
    assert with_prior < 0.6 * far_off()
