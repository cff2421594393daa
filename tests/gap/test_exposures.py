"""Pictures that a camera brightens each by its own measure."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.base.exposures import exposed, with_exposures
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.model import build, plain_camera, plain_freedom
from jaxisp.stages.balance import WhiteBalance
from tests.gap.test_floor import mosaics

FITTED = (0, 2)
STOPS = np.array([0.3, -0.1, -0.25, 0.05])


@pytest.fixture(scope="module")
def camera():
    """The plain camera with the light of four pairs, a little dark so that nothing clips."""
    chain, params = plain_camera("RGGB")
    gains = WhiteBalance(gains=np.full((4, 3), 0.7, np.float32))
    model = build(chain, params, {"later_balance": gains}, plain_freedom(), [])
    return model, jnp.asarray(mosaics(np.random.default_rng(5), 4))


def objective(model, light, stops):
    """Of the pictures that the camera makes with a brightness each."""
    own = dataclasses.replace(model, per_pair=exposed(model.per_pair, stops))
    pictures = np.round(255 * own.render(np.zeros(len(model.coordinates)), light)) / 255
    names = ("a", "b", "c", "d")
    return PixelObjective.of(Pairs(names, light, pictures.astype(np.float32), np.ones(light.shape, bool)))


def test_the_brightness_of_each_picture_is_found(camera):
    model, light = camera
    there = objective(model, light, STOPS)
    z = np.zeros(len(model.coordinates))
    found = with_exposures(there, model, FITTED)
    np.testing.assert_allclose(found.stops, STOPS - STOPS.mean(), atol=0.01)
    errors = there.at(found.model, z).errors
    assert (errors < 0.02 * there.at(model, z).errors.mean()).all()  # held-out pairs among them


def test_pictures_alike_have_none(camera):
    model, light = camera
    there = objective(model, light, np.zeros(4))
    assert with_exposures(there, model, FITTED) is None
