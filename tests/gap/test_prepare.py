"""The plain camera of RAW+JPEG pairs finds how the pictures were demosaicked."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.camera import standard_camera
from jaxisp.gap.base.absorbed import absorbed_shares
from jaxisp.gap.base.plain_raw import choices, fit_base
from jaxisp.gap.base.raw_jpeg import camera_model
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.report.record import base_row
from jaxisp.gap.simulator.choices import with_choice
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.model import Variant, build, plain_camera, plain_freedom, rooted
from jaxisp.io.datasets import Loaded
from jaxisp.io.raw import Raw
from jaxisp.io.settings import Settings
from jaxisp.pipeline import Chain, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking
from tests.gap.scenes import scenes


def test_a_given_camera_has_the_stages_that_are_its_own():
    camera = standard_camera()
    raw = Raw(Path("a"), np.full((64, 64), 0.5, np.float32), "GRBG", np.zeros(4), 1.0, np.ones(3),
              (0, 0, 64, 64), (0, 0, 64, 64))  # fmt: skip
    loaded = Loaded("a", np.zeros((64, 64, 3), np.float32), None, raw, None, Settings(), False, None)
    model = camera_model(camera, [loaded], candidates("raw+jpeg"))
    row = base_row(model, np.zeros(len(model.coordinates)), {}, "camera")
    own = [n.name for n in camera.chain.nodes if not n.name.startswith(("demosaic", "rounding"))]
    stages = [name for name in row["stages"] if not name.startswith("refitted")]
    assert [name for name in stages if name != "demosaicking"] == own
    assert set(row["fitted"]) == set(row["stages"]) - set(stages) == {"refitted_matrix", "refitted_tone"}


@pytest.mark.parametrize(
    ("own", "algorithm"),
    [
        (stage("demosaic_rcd", cfa="GRBG"), "rcd"),
        (stage("demosaic_ahd", cfa="GRBG", delta=1, variant="libraw"), "ahd-libraw"),
        (stage("demosaic_ahd", cfa="GRBG", delta=3), None),
    ],
)
def test_a_cameras_demosaicker_is_one_of_the_choices(own, algorithm):
    (node,) = with_choice(Chain((own,))).nodes
    assert node.options.get("algorithm") == algorithm and node.options["cfa"] == "GRBG"


@pytest.mark.parametrize("roots", [pytest.param(False, marks=pytest.mark.slow), True])
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
    camera = model.chosen(Variant(truth.shared | rooted(roots), truth.per_pair))
    pictures = np.round(255 * camera.render(np.zeros(len(model.coordinates)), light)) / 255
    pairs = Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool))
    base = fit_base(model, pairs, [0, 2])
    found = base.model
    assert float(found.shared["use_companding"].on) == float(found.shared["use_expansion"].on) == roots
    assert np.argmax(found.shared["demosaicking"].shares) == which // 2
    np.testing.assert_array_equal(found.per_pair["mosaic_white_balance"].gains, 1)
    assert (
        "companding" in base_row(found, np.zeros(len(found.coordinates)), base.absorbed)["stages"]
    ) == roots
    assert all(0 <= share <= 1 for share in base.absorbed.values())
    assert base.absorbed["demosaicking"] > 0.5
    assert (base.rival is not None) == roots, "what is explained by roots may be an effect"
    assert len(base.choices) == 12 + 2, "the nearest of linear values, the best of square roots, and its own"


def test_an_unknown_demosaicker_is_stood_for_by_a_mix():
    """The mean of two, which none of the palette is; the nearest alone leaves twice the error."""
    rng = np.random.default_rng(6)
    light = np.clip(scenes(rng, 4, (96, 96))[..., 0] / 255, 0.01, 1) ** 2
    light = jnp.asarray(light + rng.normal(0, 0.01, light.shape), jnp.float32)
    flat = {
        n: WhiteBalance(gains=np.ones((4, 3), np.float32)) for n in ("mosaic_white_balance", "later_balance")
    }
    chain, params = plain_camera("GRBG")
    model = build(chain, params, flat, plain_freedom(), [])
    names = list(DEMOSAICKERS)
    shares = 0.5 * (np.eye(len(names))[names.index("rcd")] + np.eye(len(names))[names.index("menon")])
    camera = model.chosen(Variant({"demosaicking": Demosaicking(shares=np.float32(shares))}, {}))
    pictures = np.round(255 * camera.render(np.zeros(len(model.coordinates)), light)) / 255
    pairs = Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool))
    found = np.asarray(fit_base(model, pairs, [0, 2]).model.shared["demosaicking"].shares)
    np.testing.assert_allclose(found, shares, atol=0.16)
    assert (found > 0).sum() == 2


def test_what_a_base_takes_up_is_what_would_be_left_without_it():
    light = jnp.asarray(np.random.default_rng(0).uniform(0.1, 0.6, (2, 96, 96)), jnp.float32)
    chain, params = plain_camera("GRBG")
    balance = {
        n: WhiteBalance(gains=np.ones((2, 3), np.float32)) for n in ("mosaic_white_balance", "later_balance")
    }
    start = build(chain, params, balance, plain_freedom(), [])
    warm = {"color_matrix": ColorMatrix(matrix=np.diag([1.3, 1.0, 0.8]).astype(np.float32))}
    fitted = start.with_shared(start.shared | warm)
    z = np.zeros(len(start.coordinates))
    pairs = Pairs(("a", "b"), light, fitted.render(z, light), np.ones(light.shape, bool))
    shares = absorbed_shares(PixelObjective.of(pairs), fitted, start.shared, [0, 1])
    assert shares["white_balance"] == pytest.approx(1, abs=1e-4), "nothing is left with it"
    assert shares["color_matrix"] == shares["tone_curve"] == shares["black_level_offset"] == 0
