"""Stencils against SciPy, and their adjoints against autodiff of the plain form and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage as ndi
from jax.test_util import check_grads

from jaxisp.windows import filter_rows_columns, gaussian_blur, gaussian_taps, pad, square, views


@pytest.mark.parametrize("shape", [(21, 34), (9, 5), (3, 40), (1, 7), (2, 2)])
def test_filter_matches_scipy(shape, rng, x64):
    x, ty, tx = rng.standard_normal(shape), rng.standard_normal(7), rng.standard_normal(3)
    want = ndi.correlate1d(ndi.correlate1d(x, ty, axis=0, mode="mirror"), tx, axis=1, mode="mirror")
    np.testing.assert_allclose(filter_rows_columns(x, jnp.asarray(ty), jnp.asarray(tx)), want, atol=1e-12)


@pytest.mark.parametrize("shape", [(11, 8), (4, 9), (3, 3), (1, 6)])
def test_filter_gradient(shape, rng, x64):
    x, ty, tx = (jnp.asarray(rng.standard_normal(s)) for s in (shape, 7, 5))
    check_grads(filter_rows_columns, (x, ty, tx), order=1, modes=["rev"], rtol=1e-6)


def test_filter_gradient_under_vmap_is_that_of_a_loop(rng):
    x = jnp.asarray(rng.standard_normal((3, 12, 9)), jnp.float32)
    slope = jax.grad(lambda p: jnp.sum(gaussian_blur(p, 1.3, 4) ** 3))
    np.testing.assert_allclose(jax.vmap(slope)(x), jnp.stack([slope(p) for p in x]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("sigma", [0.3, 1.0, 2.5])
def test_gaussian_blur_matches_scipy(sigma, rng, x64):
    x = rng.standard_normal((30, 41))
    want = ndi.gaussian_filter(x, sigma, mode="mirror", radius=10)
    np.testing.assert_allclose(gaussian_blur(x, sigma, 10), want, atol=1e-12)


def test_gaussian_taps_end_in_a_delta(x64):
    np.testing.assert_array_equal(gaussian_taps(0.0, 3), [0, 0, 0, 1, 0, 0, 0])
    assert np.isfinite(jax.grad(lambda s: gaussian_taps(s, 3)[3])(0.0))


def test_views_move_the_right_way(rng):
    x = jnp.asarray(rng.standard_normal((6, 7)))
    padded = pad(x, 1)
    np.testing.assert_array_equal(padded, np.pad(x, 1, mode="reflect"))
    for (dy, dx), view in zip(square(1), views(padded, square(1), 1)):
        assert view[2, 3] == x[2 + dy, 3 + dx]
    assert pad(x[:1], 2).shape == (5, 11)
