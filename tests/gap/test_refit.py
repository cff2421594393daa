"""What an effect closes is its own, not that of the demosaicker that is chosen anew beside it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.effects import RAW_JPEG
from jaxisp.gap.measured import Split
from jaxisp.gap.model import Choice, build, plain_camera, plain_freedom
from jaxisp.gap.prepare import candidates
from jaxisp.gap.refit import refit
from jaxisp.gap.residual import Pairs, Problem
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking

CHOICES = [
    Choice({"demosaicking": Demosaicking(shares=shares)}, {})
    for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)[:3]
]


@pytest.mark.parametrize(("blur", "least", "most"), [(0.0, -0.02, 0.02), (0.5, 0.1, 0.5)])
def test_a_choice_is_not_credited_to_the_effect(blur, least, most):
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((4, 3), 1.1, np.float32))}
    effects = [e for e in candidates(RAW_JPEG) if e.name == "optical_blur"]
    model = build(chain, params, gains, plain_freedom(), effects)
    light = jnp.asarray(np.random.default_rng(3).random((4, 96, 96)) ** 2, jnp.float32)
    z = np.zeros(len(model.coordinates))
    z[model.indices(["optical_blur"])] = blur
    pictures = model.chosen(CHOICES[0]).render(z, light)  # bilinear; the base starts from Malvar's
    problem = Problem(
        model, Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool)), CHOICES
    )
    problem.compute(model.indices(["optical_blur"]) + model.base_indices)
    found = refit(
        problem, "optical_blur", Split((0, 2), (1, 3)), float(problem.errors(problem.z).mean()), 0.0
    )
    assert found.choice is CHOICES[0]
    assert least < found.closed < most
