"""Stencils against SciPy, and their adjoints against autodiff of the plain form and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage as ndi

from jaxisp.arrays.stencils import (
    _MOST_TAPS,
    _NARROW,
    filter_rows_columns,
    gaussian_blur,
    gaussian_taps,
    pad,
    square,
    views,
)
from tests.gradients import check_grads


@pytest.mark.parametrize("mode", ["reflect", "symmetric", "edge", "constant"])
@pytest.mark.parametrize(
    "shape, radius",
    [
        ((11, 8), (2, 1)), ((2, 3), (3, 4)), ((5, _NARROW + 1), (2, 1)), ((6, 4, 3), (3, 0)),
        ((7, 5), ((2, 3), (0, 1))), ((4, _NARROW + 1), ((1, 0), (2, 3))),
    ],
)  # fmt: skip
@pytest.mark.parametrize("whole", [False, True])
def test_pad_is_numpys_and_its_gradient_that_of_the_plain_form(shape, radius, mode, whole, rng, x64):
    margins = [(r, r) if isinstance(r, int) else r for r in radius]
    x, width = rng.standard_normal(shape), margins + [(0, 0)] * (len(shape) - 2)
    want = np.pad(x, width, mode=mode)

    @jax.jit
    def both(v, weights):
        padded, pull = jax.vjp(lambda v: pad(v, radius, mode, whole=whole), v)
        return padded, pull(weights), jax.vjp(lambda v: jnp.pad(v, width, mode=mode), v)[1](weights)

    padded, got, plain = both(x, rng.standard_normal(want.shape))
    np.testing.assert_array_equal(padded, want)
    np.testing.assert_allclose(got, plain, rtol=1e-12)


@pytest.mark.parametrize("shape", [(21, 34), (9, 5), (3, 40), (1, 7), (2, 2)])
def test_filter_matches_scipy(shape, rng, x64):
    x, ty, tx = rng.standard_normal(shape), rng.standard_normal(7), rng.standard_normal(3)
    want = ndi.correlate1d(ndi.correlate1d(x, ty, axis=0, mode="mirror"), tx, axis=1, mode="mirror")
    np.testing.assert_allclose(jax.jit(filter_rows_columns)(x, ty, tx), want, atol=1e-12)


@pytest.mark.parametrize(
    "mode, scipys", [("reflect", "mirror"), ("symmetric", "reflect"), ("edge", "nearest")]
)
def test_filter_of_an_interleaved_image(mode, scipys, rng, x64):
    x, ty, tx = rng.standard_normal((9, 14, 3)), rng.standard_normal(5), rng.standard_normal(7)
    want = ndi.correlate1d(ndi.correlate1d(x, ty, axis=0, mode=scipys), tx, axis=1, mode=scipys)
    got = jax.jit(filter_rows_columns, static_argnums=3)(x, ty, tx, mode)
    np.testing.assert_allclose(got, want, atol=1e-12)


def test_filter_with_more_taps_than_a_kernel_takes(rng, x64):
    x, taps = rng.standard_normal((90, 83)), rng.standard_normal(2 * _MOST_TAPS + 3)
    want = ndi.correlate1d(ndi.correlate1d(x, taps, axis=0, mode="mirror"), taps, axis=1, mode="mirror")
    np.testing.assert_allclose(jax.jit(filter_rows_columns)(x, taps, taps), want, atol=1e-10)


@pytest.mark.parametrize("mode", ["reflect", "symmetric", "edge"])
@pytest.mark.parametrize("shape", [(11, 8), (4, 9, 3), (3, 3), (1, 6)])
def test_filter_gradient(shape, mode, rng, x64):
    x, ty, tx = (jnp.asarray(rng.standard_normal(s)) for s in (shape, 7, 5))
    fn = jax.jit(lambda *v: filter_rows_columns(*v, mode))
    check_grads(fn, (x, ty, tx), order=1, rtol=1e-6)


@pytest.mark.parametrize("axes", [(0, 0), (None, 0), (0, None)])
def test_blur_gradient_in_both_modes_and_twice(axes, rng, x64):
    """Under vmap too, with a sigma per image or one for all: the forms that fitting and diagnosis use."""
    x, sigma = jnp.asarray(rng.standard_normal((2, 6, 5, 3))), jnp.array([0.8, 1.7])
    arguments = [v if a == 0 else v[0] for v, a in zip((x, sigma), axes)]
    fn = jax.jit(jax.vmap(lambda v, s: gaussian_blur(v, s, 2), axes))
    check_grads(fn, arguments, order=2 if axes == (0, 0) else 1, rtol=1e-5)


def test_blur_tangent_agrees_with_its_cotangent_in_single_precision(rng):
    x, w = jnp.asarray(rng.random((2, 40, 33, 3)), jnp.float32)
    sigma = jnp.float32(1.4)
    forward = jax.jit(lambda s: jax.jvp(lambda s: gaussian_blur(x, s, 6), (s,), (jnp.ones_like(s),))[1])(
        sigma
    )
    backward = jax.jit(jax.grad(lambda s: jnp.sum(gaussian_blur(x, s, 6) * w)))(sigma)
    np.testing.assert_allclose(backward, np.sum(forward * w), rtol=1e-4)


def test_filter_gradient_under_vmap_is_that_of_a_loop(rng):
    x = jnp.asarray(rng.standard_normal((3, 12, 9)), jnp.float32)
    slope = jax.jit(jax.grad(lambda p: jnp.sum(gaussian_blur(p, 1.3, 4) ** 3)))
    together = jax.jit(jax.vmap(slope))(x)
    np.testing.assert_allclose(together, jnp.stack([slope(p) for p in x]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("sigma", [0.3, 1.0, 2.5])
def test_gaussian_blur_matches_scipy(sigma, rng, x64):
    x = rng.standard_normal((30, 41))
    want = ndi.gaussian_filter(x, sigma, mode="mirror", radius=10)
    np.testing.assert_allclose(jax.jit(gaussian_blur, static_argnums=2)(x, sigma, 10), want, atol=1e-12)


def test_gaussian_taps_end_in_a_delta(x64):
    taps = jax.jit(gaussian_taps, static_argnums=1)
    np.testing.assert_array_equal(taps(0.0, 3), [0, 0, 0, 1, 0, 0, 0])
    assert np.isfinite(jax.jit(jax.grad(lambda s: taps(s, 3)[3]))(0.0))


def test_views_move_the_right_way(rng):
    x = jnp.asarray(rng.standard_normal((6, 7)))
    padded = pad(x, 1)
    np.testing.assert_array_equal(padded, np.pad(x, 1, mode="reflect"))
    for (dy, dx), view in zip(square(1), views(padded, square(1), 1)):
        assert view[2, 3] == x[2 + dy, 3 + dx]
    single = np.pad(np.repeat(x[:1], 5, axis=0), ((0, 0), (2, 2)), mode="reflect")
    np.testing.assert_array_equal(pad(x[:1], 2), single)  # a row alone is repeated, its columns reflected
