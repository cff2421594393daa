"""A reference of clean+noisy pairs: which scenes it shares, and what is taken off the real statistics."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.base.clean_reference import _offset, _same_scenes, _taken_over, _with_pictures
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.effects import candidates


def pairs(*values):
    light = np.stack([np.full((8, 8, 3), v, np.float32) for v in values])
    names = tuple(f"s{i}" for i in range(len(values)))
    return Pairs(names, jnp.asarray(light), light, np.ones(light.shape[:3], bool))


def test_scenes_are_matched_by_their_clean_pictures():
    assert _same_scenes(pairs(0.3, 0.1, 0.7), pairs(0.1, 0.2, 0.3)) == [2, 0, None]
    small = pairs(0.1)
    assert _same_scenes(
        small.take([0]),
        Pairs(("a",), jnp.zeros((1, 4, 4, 3)), np.zeros((1, 4, 4, 3)), np.ones((1, 4, 4), bool)),
    ) == [None]


def case(off):
    measure = SimpleNamespace(
        real=np.asarray(off, float), simulated=lambda model, z: np.zeros_like(off, float)
    )
    return SimpleNamespace(
        statistics=SimpleNamespace(measure=measure), point=SimpleNamespace(model=None, z=None)
    )


def test_a_shared_scene_has_its_own_offset_and_others_the_sure_part_of_the_mean():
    rng = np.random.default_rng(0)
    off = np.stack(
        [2 + 0.1 * rng.standard_normal(6), 0.1 * rng.standard_normal(6)], 1
    )  # one sure, one chance
    found = _offset(case(off), [3, None], 2)
    np.testing.assert_array_equal(found[0], off[3])
    assert found[1, 0] == pytest.approx(off[:, 0].mean(), rel=0.01)
    assert abs(found[1, 1]) < abs(off[:, 1].mean())


def test_effects_act_on_the_base_and_nothing_else_is_free():
    effects = candidates("clean+noisy")
    camera, own = Camera(None), pairs(0.2, 0.3)
    model = _taken_over(camera.whole_model(camera.mean_model({}), effects), camera, own, ["prnu"])
    assert model.base == () and "prnu" not in model.effects
    assert {"tone_curve", "color_matrix", "sharpening", "row_noise"} <= set(model.effects)
    for name in ("tone_curve", "color_matrix"):
        assert all(c.move.low <= 0 <= c.move.high for c in model.effects[name])
    names = [n.name for n in model.chain.nodes]
    first = names.index("remainder")
    assert names.index("use_sharpening") > first and names.index("use_local_tone_mapping") > first
    assert names.index("use_optical_blur") < names.index("use_row_noise") < first


def test_the_references_pictures_are_made_noise_and_all():
    side = 64
    light = np.random.default_rng(0).uniform(0.2, 0.5, (2, side, side, 3)).astype(np.float32)
    own = Pairs(("a", "b"), jnp.asarray(light), light, np.ones((2, side, side), bool))
    camera = Camera(None)
    model = _taken_over(camera.whole_model(camera.mean_model({}), []), camera, own, [])
    wanted = np.round(255 * np.random.default_rng(1).uniform(0.1, 0.9, light.shape)).astype(np.float32) / 255
    keys = jax.random.split(jax.random.key(3), 2)
    found = _with_pictures(model, SimpleNamespace(pairs=own, keys=lambda: keys), wanted)
    made = found.render(np.zeros(len(found.coordinates)), own.light, keys)
    np.testing.assert_allclose(made, wanted, atol=2e-6)
    again = found.take([1]).render(np.zeros(len(found.coordinates)), own.light[1:], keys[1:])
    np.testing.assert_allclose(again, wanted[1:], atol=2e-6)
