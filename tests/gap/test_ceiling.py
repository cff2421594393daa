"""How far the gap could be lowered at all, on errors whose cause is known."""

import types

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import laplace
from scipy.stats import norm

from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.downstream import ceiling
from jaxisp.gap.features.tolerances import left_by_shift
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs, inner_steps
from jaxisp.gap.pairs.scenes import Split


class Still:
    """A simulator without parameters: its picture is the light in grey."""

    coordinates = effects = base_indices = ()

    def render(self, z, light):
        return np.repeat(np.asarray(light)[..., None], 3, -1)

    def in_steps(self, z, light):
        return np.asarray(inner_steps(self.render(z, light), len(light)))

    def take(self, which):
        return self


def off_by(error, n=4, side=96):
    """Pairs of a smooth picture and the same with this error (N, H, W) in 8-bit steps of luma."""
    rng = np.random.default_rng(3)
    light = rng.uniform(0.3, 0.6, (n, side, side)).astype(np.float32)
    pictures = np.repeat((light + error(light, rng) / 255)[..., None], 3, -1).astype(np.float32)
    names = tuple(f"scene{i}" for i in range(n))
    pairs = Pairs(names, jnp.asarray(light), pictures, np.ones(light.shape, bool))
    return PixelObjective.of(pairs, Split((0, 2), (1, 3)))


@pytest.mark.parametrize(
    ("steps", "most"), [(100, 0.3), pytest.param(ceiling._STEPS, 0.05, marks=pytest.mark.slow)]
)
def test_a_network_predicts_what_the_picture_tells_and_no_noise(monkeypatch, steps, most):
    """Nearly all of it, and already after a third of the training most of it."""
    monkeypatch.setattr(ceiling, "_STEPS", steps)
    monkeypatch.setattr(ceiling, "_program", ceiling._program.__wrapped__)  # that of these steps alone

    def error(light, rng):  # too much sharpening, every second row, and noise
        told = 20 * laplace(light, axes=(1, 2)) + 3 * (np.indices(light.shape)[1] % 2)
        return told + 1.5 * rng.standard_normal(light.shape)

    objective = off_by(error)
    point = objective.at(Still(), np.zeros(0))
    before = float(objective.units(point)[[1, 3]].mean())
    left = ceiling._network_leaves(objective, point)
    noise = 1.5**2
    assert before > 20 * noise
    assert 0.97 * noise < left < noise + most * (before - noise)


CASE = types.SimpleNamespace(pixels=None, statistics=None, criteria=CRITERIA["raw+jpeg"])


@pytest.mark.parametrize(("after", "share", "how"), [
    (2.0, 8 / 9, "an effect that was refused"), (1.0, 1.0, "the named effects"),
    (10.0, 0.0, "an effect that was refused"),
])  # fmt: skip
def test_what_is_named_is_a_share_of_what_flexible_models_close(after, share, how):
    found = ceiling.reducible(CASE, Gap(10.0, 1.0), None, after, [3.0, 1.0])
    models = {"the named effects": after, "an effect that was refused": 1.0}
    assert found == {"best": 1.0, "how": how, "models": models, "explained": pytest.approx(share)}


def test_where_nothing_can_be_lowered_no_share_is_said():
    found = ceiling.reducible(CASE, Gap(10.0, 1.0), None, 10.0, [9.95])
    assert found["best"] == 9.95 and found["explained"] is None
    assert ceiling.reducible(CASE, Gap(10.0, 1.0), None, 10.0, [])["best"] == 10.0


@pytest.mark.parametrize("alike", [3.0, 0.0])
def test_statistics_are_moved_by_what_the_fitted_pairs_have_in_common(alike):
    """What all pairs differ in goes, but for what chance does to four; where that is all little moves."""
    rng, statistics = np.random.default_rng(6), 20000
    chance = 2.0 * rng.standard_normal((8, statistics))  # of the mean of four: 1, as a unit is
    apart, scale = alike + chance, rng.uniform(0.5, 2, statistics) * np.ones((8, 1))
    left = left_by_shift(apart, scale, np.ones(statistics), range(4), range(4, 8))
    m = np.linspace(-9, 12, 200001)
    moved = np.where(np.abs(m) > 1, m - 1 / m, 0)
    expected = 1 + np.trapezoid((alike - moved) ** 2 * norm.pdf(m, alike), m)
    assert left == pytest.approx(expected, rel=0.05) and expected < 2.6


def test_pairs_that_are_measured_in_other_units_are_moved_by_as_much():
    """By 2 of the statistic's own, where a half of the pairs is measured ten times as finely."""
    scale = np.array([1.0, 1.0, 10.0, 10.0])[:, None] * np.ones((4, 50))
    left = left_by_shift(scale * 200.0, scale, np.ones(50), (0, 1), (2, 3))
    assert left == pytest.approx(0.05**2, rel=1e-3)  # 200 of a unit, shrunk by 1 / 200, ten times as large
