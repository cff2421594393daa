"""How far simulated pictures are from real ones on average, whatever noise either has."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.clean_noisy import StatisticsProblem
from jaxisp.gap.measured import Split
from jaxisp.gap.noisy_base import Camera
from jaxisp.gap.noisy_codes import unknown_codes
from jaxisp.gap.noisy_start import noise_indices
from jaxisp.gap.prepare import candidates
from jaxisp.gap.residual import BORDER, Pairs, to_steps
from tests.conftest import smooth_image

SIDE, COUNT, SHIFT = 80, 2, 0.03


@pytest.fixture(scope="module")
def problem():
    """Two pictures of a camera whose lens distorts, before the camera without."""
    camera = Camera(None)
    effects = [
        e for e in candidates("clean+noisy") if e.name in ("geometric_distortion", "double_compression")
    ]
    model = camera.whole_model(camera.mean_model({}), effects)
    rng = np.random.default_rng(4)
    tiles = 0.3 * (rng.random((COUNT, SIDE // 8, SIDE // 8)) > 0.5).repeat(8, 1).repeat(8, 2)
    grey = [smooth_image((SIDE, SIDE), k) + own for k, own in enumerate(tiles)]
    light = jnp.asarray(np.stack([g[..., None] * [0.5, 0.45, 0.4] for g in grey]), jnp.float32)
    z = np.zeros(len(model.coordinates))
    pictures = model.render(distorted(model, z), light, jax.random.split(jax.random.key(7), COUNT))
    still = model.render(quiet(model, z), light, jax.random.split(jax.random.key(0), COUNT))
    pairs = Pairs(("a", "b"), light, pictures, np.ones((COUNT, SIDE, SIDE), bool))
    inner = SIDE - 2 * BORDER
    return StatisticsProblem(model, pairs, to_steps(still), Split((0,), (1,)), unknown_codes((inner, inner)))


def distorted(model, z, shift=SHIFT):
    moved = z.copy()
    moved[model.indices(["geometric_distortion"])] = shift
    return moved


def quiet(model, z):
    moved = z.copy()
    for i in noise_indices(model):
        moved[i] = min(model.ranges[0, i], 0.0) if model.base[i].move.field in ("shot", "read") else 0.0
    return moved


def test_at_the_truth_only_the_noise_of_the_pictures_is_left(problem):
    z = distorted(problem.model, problem.z)
    draws = np.stack([problem.picture(z, k) for k in range(2, 8)])
    noise = draws.var(0, ddof=1).mean((1, 2, 3))
    np.testing.assert_allclose(problem.distances(z), noise, rtol=0.06)
    np.testing.assert_allclose(problem.scatter(z), noise, rtol=0.06)
    at_rest = problem.distances(problem.z) - problem.scatter(problem.z)  # of edges that are elsewhere
    assert (at_rest > 0.3 * noise).all()


def test_a_warp_the_wrong_way_is_farther_than_none(problem):
    right, none, wrong = (
        problem.distances(distorted(problem.model, problem.z, v)).mean() for v in (SHIFT, 0, -SHIFT)
    )
    assert right < 0.7 * none and wrong > none


def test_what_may_smooth_noise_is_tried_with_more_of_it(problem):
    z, model = problem.z, problem.model
    shot = noise_indices(model)[0]
    tried = problem.noisier(z, model.indices(["double_compression"])[0])
    assert (tried[0] == z).all() and np.all(np.diff([p[shot] for p in tried]) > 0)
