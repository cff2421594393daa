"""What an effect closes is its own, not that of the demosaicker that is chosen anew beside it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.axes.interval import few_scenes, interval
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.refit import refit
from jaxisp.gap.search.trial import Bars, Whole
from jaxisp.gap.simulator.effects import RAW_JPEG, candidates
from jaxisp.gap.simulator.model import Variant, build, plain_camera, plain_freedom
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking

CHOICES = [
    Variant({"demosaicking": Demosaicking(shares=shares)}, {})
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
    pairs = Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool))
    objective = PixelObjective.of(pairs, Split((0, 2), (1, 3)), CHOICES)
    at = objective.at(model, np.zeros(len(z)))
    at = objective.compute(at, model.indices(["optical_blur"]) + model.base_indices)
    parts = objective.units(at)[[1, 3]]
    whole = Whole(float(parts.mean()), parts)
    found = refit(objective, at, "optical_blur", whole, Bars(0.0), CRITERIA[RAW_JPEG])
    assert found.choice is CHOICES[0]
    assert least < found.closed < most


@pytest.mark.parametrize("scenes", [3, 5])
def test_what_is_drawn_from_few_scenes_is_too_narrow_and_nearly_right_when_stretched(scenes):
    """For the mean of so many Gaussian figures, 2000 times, of 90 %: percentiles of so few are coarse."""
    draws = np.random.default_rng(7).normal(1.0, 0.2, (2000, scenes, 1))
    covered = {1.0: 0, few_scenes(scenes): 0}
    for drop in draws:
        ends = interval(drop, 1.0)
        for factor in covered:
            low, high = (drop.mean() + factor * (end - drop.mean()) for end in ends)
            covered[factor] += low <= 1.0 <= high
    shares = [n / len(draws) for n in covered.values()]
    assert shares[0] < 0.8 and 0.84 < shares[1] < 0.93


def test_one_scene_and_tiles_are_left_as_they_are():
    assert few_scenes(1) == few_scenes(None) == 1.0
    assert few_scenes(3) == pytest.approx(
        np.sqrt(1.5) * 2.91999 / 1.64485, rel=1e-4
    )  # tables of t and normal
    assert few_scenes(2) > few_scenes(3) > few_scenes(30) == pytest.approx(1.0, abs=0.06)


def test_a_scene_with_more_of_the_gap_does_not_make_the_share_uncertain():
    parts = np.array([[1.0], [4.0], [10.0]])
    assert interval(0.8 * parts, parts) == pytest.approx((0.8, 0.8))
    low, high = interval(0.8 * parts, float(parts.mean()))
    assert high - low > 0.5
