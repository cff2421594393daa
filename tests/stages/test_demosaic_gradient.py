"""Demosaicking: the derivative in both modes."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.pipeline import stage
from jaxisp.testing import smooth_image
from tests.gradients import both_modes
from tests.stages.test_demosaic import SHAPE, compiled

VARIANTS = [
    ("demosaic_bilinear", {"cfa": "GBRG"}),
    ("demosaic_malvar", {"cfa": "BGGR"}),
    ("demosaic_hibbard", {"cfa": "GRBG"}),
    ("demosaic_menon", {"cfa": "GBRG"}),
    ("demosaic_menon", {"refining": False}),
    ("demosaic_ahd", {"cfa": "BGGR"}),
    ("demosaic_ahd", {"delta": 1, "variant": "libraw", "cfa": "GRBG"}),
    ("demosaic_ahd", {"median_passes": 1}),
    ("demosaic_hamilton_adams", {"cfa": "GBRG"}),
    ("demosaic_vng", {"cfa": "GRBG"}),
    ("demosaic_edge_aware", {"cfa": "BGGR"}),
    ("demosaic_ppg", {"cfa": "GRBG"}),
    ("demosaic_dcb", {"cfa": "GBRG"}),
    ("demosaic_rcd", {"cfa": "BGGR"}),
    ("demosaic_lmmse", {"cfa": "GRBG"}),
]


@pytest.mark.parametrize(
    "name",
    [
        f"demosaic_{n}"
        for n in ("hibbard", "ahd", "menon", "hamilton_adams", "vng", "edge_aware", "ppg", "dcb")
    ],
)
def test_gradient_holds_the_choice_constant(name, x64):
    """Between two changes of a choice the output is linear in the mosaic: the derivative says by how much."""
    mosaic, step = smooth_image(SHAPE), np.random.default_rng(1).standard_normal(SHAPE)
    weights, h = np.random.default_rng(2).standard_normal((*SHAPE, 3)), 1e-8
    both = jax.jit(lambda m: both_modes(partial(stage(name), {}), (m,), (step,), weights))
    _, tangent, (grad,) = both(mosaic)
    moved = np.asarray(both(mosaic + h * step)[0] - both(mosaic - h * step)[0]) / (2 * h)
    np.testing.assert_allclose(moved, tangent, atol=1e-5)
    np.testing.assert_allclose(np.sum(grad * step), np.sum(tangent * weights), rtol=1e-10)


@pytest.mark.parametrize(("name", "static"), VARIANTS)
def test_reverse_mode_is_the_transpose_of_forward_mode(name, static, x64):
    """Under vmap; on sizes at which a border is reflected more than once or not at all, too."""
    rng = np.random.default_rng(0)
    cheap = ("bilinear", "hibbard", "vng", "hamilton_adams", "edge_aware")
    tiny = [(2, 3), (1, 4)] if name.removeprefix("demosaic_") in cheap else []
    for shape in [(9, 12), *tiny]:
        mosaics = np.stack([1.5 * smooth_image(shape, seed) - 0.2 for seed in range(2)])
        fn = jax.vmap(lambda m: stage(name, **static)({}, m))

        @jax.jit
        def both(mosaics, tangent, cotangent, fn=fn):
            return both_modes(fn, (mosaics,), (tangent,), cotangent)

        for _ in range(3):
            tangent, cotangent = rng.standard_normal(mosaics.shape), rng.standard_normal((*mosaics.shape, 3))
            _, moved, (collected,) = both(mosaics, tangent, cotangent)
            np.testing.assert_allclose(np.vdot(collected, tangent), np.vdot(cotangent, moved), rtol=1e-10)


@pytest.mark.parametrize("name", ["demosaic_rcd", "demosaic_lmmse"])
def test_weights_are_held_constant(name, x64):
    """With its weights held, the picture is linear in the mosaic: the derivative along it is the picture."""
    mosaic = smooth_image(SHAPE)
    value, tangent = jax.jvp(compiled(name), (mosaic,), (mosaic,))
    np.testing.assert_allclose(tangent, value, atol=1e-12)


def test_clipping_of_libraws_variant_ends_the_gradient(x64):
    """Where a candidate is clipped the derivative is that of the clipped value."""
    mosaic, step = 2.0 * smooth_image(SHAPE) - 0.5, np.random.default_rng(1).standard_normal(SHAPE)
    fn, h = compiled("demosaic_ahd", delta=1, variant="libraw"), 1e-8
    value, tangent = jax.jvp(fn, (mosaic,), (step,))
    assert np.asarray(value)[..., ::2].min() == 0 and np.asarray(value)[..., ::2].max() == 1
    moved = np.asarray(fn(mosaic + h * step) - fn(mosaic - h * step)) / (2 * h)
    np.testing.assert_allclose(moved, tangent, atol=1e-5)


def test_gradient_of_the_gradient(x64):
    """The map and its adjoint are linear: a quadratic has a constant second derivative."""
    mosaic, step = smooth_image((7, 10)), np.random.default_rng(1).standard_normal((7, 10))
    fn = compiled("demosaic_malvar")
    gradient = jax.grad(lambda m: jnp.sum(fn(m) ** 2))
    curved = jax.jit(jax.grad(lambda m: jnp.vdot(gradient(m), step)))(mosaic)
    np.testing.assert_allclose(curved, jax.jit(gradient)(step), atol=1e-12)
