"""What every registered stage must do. A stage that is added gets all of this."""

import functools
import re
import zlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.params import map_specs, specs
from jaxisp.pipeline import run, run_batch, sections, signature, stage
from jaxisp.stages import STAGES
from tests.conftest import smooth_image
from tests.stages.test_precision import loose

SHAPE = (21, 34)
NAMES = sorted(STAGES)
each_stage = pytest.mark.parametrize("name", NAMES, scope="module")
"""All tests of a stage one after another, on one worker: they share its programs."""


def image_for(name: str, seed: int = 0, dtype=np.float32) -> np.ndarray:
    shape = SHAPE if signature(STAGES[name]).domain_in.channels == 1 else (*SHAPE, 3)
    return smooth_image(shape, seed).astype(dtype)


def params_for(name: str, share=None, seed: int = 0, dtype=np.float32):
    """Parameters at a share of each range (0 and 1 are the bounds), random inside when None."""
    rng = np.random.default_rng(seed + zlib.crc32(name.encode()))

    def value(spec):
        s = rng.uniform(0.2, 0.8, spec.shape) if share is None else np.full(spec.shape, share)
        low, high = spec.bounds
        if spec.scale == "log":
            return np.asarray(np.exp(np.log(low) + s * np.log(high / low)), dtype).clip(low, high)
        return np.asarray(low + s * (high - low), dtype)

    return map_specs(lambda spec, _: value(spec), stage(name).init())


@functools.cache
def gradient(name: str):
    """A weighted sum of the output, and its gradient by parameters and image; compiled once for all tests."""
    s = stage(name)
    return jax.jit(jax.value_and_grad(lambda p, x, w, key: jnp.sum(s(p, x, key=key) * w), argnums=(0, 1)))


def weights_for(name: str) -> np.ndarray:
    shape = jax.eval_shape(stage(name), params_for(name), image_for(name), key=jax.random.key(0)).shape
    return np.random.default_rng(1).standard_normal(shape).astype(np.float32)


@each_stage
def test_declaration(name):
    fn, declared = STAGES[name], signature(STAGES[name])
    found = sections(fn)
    assert re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name)
    assert not name.startswith(("apply_", "do_", "get_"))
    for title in ("Summary", "Args", "Returns", "Gradient", "Source"):
        assert found.get(title), f"{name}: docstring lacks {title}"
    assert found["Gradient"].split()[0].strip(".,:;") in {"exact", "surrogate", "none"}, found["Gradient"]
    for argument in [n for n, _ in declared.static] + ["image"] + ["params"] * bool(declared.params):
        assert f"{argument}:" in found["Args"], f"{name}: Args lacks {argument}"
    if declared.params:
        assert all(s.unit and s.doc for s in specs(declared.params).values())


@each_stage
def test_total(name):
    """Finite values for every finite input: black, white, above 1, negative, parameters on their bounds."""
    ordinary = image_for(name)
    extremes = [np.zeros_like(ordinary), np.ones_like(ordinary), 4 * ordinary - 1]
    s = stage(name)
    for share in (None, 0.0, 1.0):
        params = params_for(name, share)
        for image in [ordinary, *extremes]:
            out = run(s, params, image, jax.random.key(0))
            assert out.dtype == jnp.float32
            assert np.isfinite(out).all(), f"share {share}"
            assert out.ndim == {1: 2, 3: 3, None: image.ndim}[s.domain_out.channels]


@each_stage
def test_gradient_is_finite(name):
    ordinary, weights, key = image_for(name), weights_for(name), jax.random.key(0)
    for share in (None, 0.0, 1.0):
        for image in (ordinary, np.zeros_like(ordinary), np.ones_like(ordinary), 4 * ordinary - 1):
            for leaf in jax.tree.leaves(gradient(name)(params_for(name, share), image, weights, key)[1]):
                assert np.isfinite(leaf).all(), f"share {share}"


@each_stage
def test_products_are_exact(name):
    params, image, key = params_for(name), image_for(name), jax.random.key(0)
    forward = jax.make_jaxpr(lambda p, x: stage(name)(p, x, key=key))(params, image)  # a rule has its own
    assert not loose(forward) and not loose(gradient(name).trace(params, image, weights_for(name), key).jaxpr)


@each_stage
def test_the_gradients_forward_pass_gives_the_value(name):
    """A custom rule has a forward pass of its own, which could be that of another function."""
    params, image, weights, key = params_for(name), image_for(name), weights_for(name), jax.random.key(0)
    terms = np.asarray(run(stage(name), params, image, key)) * weights
    got = gradient(name)(params, image, weights, key)[0]
    np.testing.assert_allclose(got, terms.sum(dtype=float), atol=1e-4 * np.abs(terms).sum())


@each_stage
def test_gradient_reaches_every_parameter(name):
    """No declared parameter is dead: its gradient (exact or surrogate) is not zero everywhere."""
    fn = STAGES[name]
    if signature(fn).params is None or sections(fn)["Gradient"].startswith("none"):
        return
    weights = weights_for(name)
    given = [(params_for(name, seed=i), image_for(name, i), weights, jax.random.key(i)) for i in range(3)]
    grads = [gradient(name)(*arguments)[1][0] for arguments in given]
    for field in specs(signature(fn).params):
        assert any(np.abs(getattr(g[name], field)).max() > 0 for g in grads), f"{field} has no gradient"


@each_stage
def test_gradient_matches_finite_differences(name, x64):
    """Directional derivatives in float64, of stages that declare an exact gradient."""
    s = stage(name)
    if not sections(s.fn)["Gradient"].startswith("exact"):
        return
    rng = np.random.default_rng(3)
    params, image = params_for(name, dtype=np.float64), image_for(name, dtype=np.float64)
    key = jax.random.key(0)
    weights = rng.standard_normal(jax.eval_shape(lambda: s(params, image, key=key)).shape)

    # one program: its values are differenced too
    both = jax.jit(jax.value_and_grad(lambda p, x: jnp.sum(s(p, x, key=key) * weights), argnums=(0, 1)))
    direction = jax.tree.map(lambda v: rng.standard_normal(np.shape(v)) * (np.abs(v) + 1e-3), (params, image))
    grads = both(params, image)[1]
    got = sum(float(np.sum(g * d)) for g, d in zip(jax.tree.leaves(grads), jax.tree.leaves(direction)))
    best = np.inf
    for h in (1e-5, 1e-6, 1e-7):
        moved = [jax.tree.map(lambda v, d: v + e * d, (params, image), direction) for e in (h, -h)]  # noqa: B023
        want = (float(both(*moved[0])[0]) - float(both(*moved[1])[0])) / (2 * h)
        best = min(best, abs(got - want) / (abs(want) + 1e-3))
    assert best < 1e-4, f"relative error {best:.2e}"


@each_stage
def test_jit_vmap_and_loop_agree(name):
    s = stage(name)
    images = np.stack([image_for(name, seed) for seed in range(3)])
    params = jax.tree.map(lambda *v: np.stack(v), *[params_for(name, seed=seed) for seed in range(3)])
    root = jax.random.key(7)
    batch = run_batch(s, params, images, root)
    for i in range(3):
        one = jax.tree.map(lambda v: v[i], params)  # noqa: B023
        jitted = run(s, one, images[i], jax.random.fold_in(root, i))
        np.testing.assert_allclose(batch[i], jitted, atol=2e-5, rtol=2e-5)
        if i == 0:
            plain = s(one, jnp.asarray(images[i]), key=jax.random.fold_in(root, i))
            np.testing.assert_allclose(jitted, plain, atol=2e-5, rtol=2e-5)


@each_stage
def test_new_values_do_not_retrace(name):
    s, traces = stage(name), []

    @jax.jit
    def counted(p, x, k):
        traces.append(name)
        return s(p, x, key=k)

    for seed in range(2):  # tracing is all that is asked; nothing is compiled
        counted.trace(params_for(name, seed=seed), image_for(name, seed), jax.random.key(seed))
    assert len(traces) == 1


@each_stage
def test_wrong_shapes_are_refused_by_name(name):
    for shape in ((2, 21, 34, 3), (21, 34, 4), (5,)):
        bad = np.zeros(shape, np.float32)
        with pytest.raises(TypeError, match=name):
            stage(name)(params_for(name), bad, key=jax.random.key(0))
    with pytest.raises(TypeError, match="float"):
        stage(name)(params_for(name), (image_for(name) * 255).astype(np.uint8), key=jax.random.key(0))
