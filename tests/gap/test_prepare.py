"""The plain camera of RAW+JPEG pairs finds how the pictures were demosaicked."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.model import Choice, build, plain_camera, plain_freedom, rooted
from jaxisp.gap.prepare import choices, fit_base
from jaxisp.gap.residual import Pairs
from jaxisp.gap.rows import base_row
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS
from tests.gap.scenes import scenes


@pytest.mark.parametrize("roots", [False, True])
def test_it_knows_whether_square_roots_were_demosaicked(roots):
    rng = np.random.default_rng(5)
    light = np.clip(scenes(rng, 4, (96, 96))[..., 0] / 255, 0.01, 1) ** 2
    light = jnp.asarray(light + rng.normal(0, 0.005, light.shape), jnp.float32)
    gains = np.full((4, 3), (1.8, 1.0, 1.5), np.float32)
    balance = {"mosaic_white_balance": WhiteBalance(gains=gains)}
    balance["later_balance"] = WhiteBalance(gains=np.ones_like(gains))
    chain, params = plain_camera("GRBG")
    model = build(chain, params, balance, plain_freedom(), [])
    which = 2 * list(DEMOSAICKERS).index("hamilton-adams") + 1  # white balanced last
    truth = choices(model)[which]
    camera = model.chosen(Choice(truth.shared | rooted(roots), truth.per_pair))
    pictures = np.round(255 * camera.render(np.zeros(len(model.coordinates)), light)) / 255
    pairs = Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool))
    base = fit_base(model, pairs, [0, 2])
    found = base.model
    assert float(found.shared["use_companding"].on) == float(found.shared["use_expansion"].on) == roots
    assert np.argmax(found.shared["demosaicking"].shares) == which // 2
    np.testing.assert_array_equal(found.per_pair["mosaic_white_balance"].gains, 1)
    assert ("companding" in base_row(found, base.absorbed)["stages"]) == roots
    assert (base.rival is not None) == roots, "what is explained by roots may be an effect"
    assert len(base.choices) == 2 * len(DEMOSAICKERS) + 1, (
        "all of linear values, and the best of square roots"
    )
