"""Before clean+noisy pairs every effect is the identity while it is off, and what shows there only shows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap import EFFECTS
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG, candidates
from jaxisp.pipeline import Chain, Gate, run, stage
from jaxisp.testing import smooth_image
from tests.gap.test_effects import VOCABULARY

ONLY_HERE = [e.name for e in EFFECTS.values() if e not in candidates(RAW_JPEG)]
"""Film grain too: beside a RAW its energy tells it (`jaxisp.gap.search.film_grain`), and no move."""


@pytest.fixture(scope="module")
def models():
    """Without effects and with all of them."""
    camera = Camera(None)
    mean = camera.mean_model({})
    return [camera.whole_model(mean, effects) for effects in ([], candidates(CLEAN_NOISY))]


@pytest.fixture(scope="module")
def light():
    """From black to beyond white, in colour."""
    ramp = np.linspace(0, 1.1, 48) ** 2
    detail = np.stack([smooth_image((40, 48), seed) for seed in range(2)])
    grey = np.clip(ramp + 0.3 * (detail - 0.5) * (ramp + 0.02), 0, None)
    return jnp.asarray(grey[..., None] * [1, 0.8, 0.6], jnp.float32)


KEYS = jax.random.split(jax.random.key(3), 2)


def test_the_vocabulary_is_covered(models):
    assert set(models[1].effects) == set(VOCABULARY)
    assert set(ONLY_HERE) | {e.name for e in candidates(RAW_JPEG)} == set(VOCABULARY)


@pytest.mark.optimised
def test_nothing_is_changed_while_all_are_off(models, light):
    plain, model = (m.render(np.zeros(len(m.coordinates)), light, KEYS) for m in models)
    np.testing.assert_array_equal(model, plain)


def test_stages_do_nothing_at_off(models, light):
    """But for compression, which has no quality that does nothing: only its switch is off."""
    model, picture = models[1], jnp.clip(light[0], 0, 1)
    nodes = [gate.node for gate in model.chain.nodes if isinstance(gate, Gate)]
    for node in nodes:
        if node.name not in ("double_compression", "jpeg_quantization"):
            image = picture[..., 1] if node.domain_in.channels == 1 else picture
            same = run(node, {node.name: model.shared[node.name]}, image, KEYS[0])
            np.testing.assert_allclose(same, image, atol=1e-6, err_msg=node.name)


@pytest.mark.parametrize("name", ONLY_HERE)
def test_every_move_of_what_shows_here_only_does(models, light, name):
    """Noise in the pictures of the same keys. What it is like shows beside its strength, the first move."""
    model = models[1]
    first, *others = model.indices([name])
    for i in (first, *others):
        start = np.zeros(len(model.coordinates))
        start[first] = 0 if i == first else model.ranges[1, first]
        z = start.copy()
        z[i] += model.steps[i]
        change = model.render(z, light, KEYS) - model.render(start, light, KEYS)
        assert np.abs(change).max() > 1e-4, model.coordinates[i]


def test_what_is_demosaicked_is_companded_and_expanded():
    camera = Camera(None, "GRBG", "bilinear", gamma=2.0)
    model = camera.whole_model(camera.mean_model({}), candidates("clean+noisy"))
    names = [node.name for node in model.chain.nodes]
    at = names.index("companding")
    assert names[at : at + 3] == ["companding", "demosaicking", "expansion"]  # no effect between
    mosaic = jnp.asarray(smooth_image((24, 26), 1), jnp.float32)
    found = run(Chain(model.chain.nodes[at : at + 3]), model.shared, mosaic)
    rooted = run(stage("demosaic_bilinear", cfa="GRBG"), {}, jnp.sqrt(mosaic))
    np.testing.assert_allclose(found, rooted**2, atol=1e-5)
