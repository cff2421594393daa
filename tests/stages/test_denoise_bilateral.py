"""The bilateral filter against OpenCV, a loop in float64, and plain autodiff."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.stages.denoise.bilateral import (
    Bilateral,
    _exp2,
    bilateral,
    bilateral_plane,
    bilateral_planes,
)
from jaxisp.testing import smooth_image
from tests.gradients import both_modes

SIZES = ((9, 14), (1, 6), (2, 7))  # radius 2 also reaches beyond both borders
filtered = jax.jit(bilateral_plane, static_argnums=4)


def naive(planes, guide, sigma_space, sigma_range, radius, xp=np):
    """The definition, one tap after another, in NumPy or for autodiff in JAX."""
    h, w = guide.shape

    def padded(x):
        for axis, n in enumerate(x.shape):
            width = [(radius, radius) if a == axis else (0, 0) for a in range(2)]
            x = xp.pad(x, width, mode="reflect" if n > 1 else "edge")
        return x

    wide, total, norm = [padded(x) for x in (guide, *planes)], [0.0] * len(planes), 0.0
    span = range(-radius, radius + 1)
    for dy, dx in [(dy, dx) for dy in span for dx in span if dy**2 + dx**2 <= radius**2]:
        near, *values = (x[radius + dy : radius + dy + h, radius + dx : radius + dx + w] for x in wide)
        exponent = (dy**2 + dx**2) / sigma_space**2 + (near - guide) ** 2 / sigma_range**2
        weight = xp.exp(-exponent / 2)
        total, norm = [t + weight * v for t, v in zip(total, values)], norm + weight
    return [t / norm for t in total]


@pytest.mark.parametrize("radius, sigma_space, sigma_range", [(2, 1.0, 0.1), (5, 1.5, 0.05), (5, 8.0, 0.5)])
def test_plane_equals_opencv(radius, sigma_space, sigma_range):
    plane = smooth_image((37, 52)).astype(np.float32)
    want = cv2.bilateralFilter(
        plane, 2 * radius + 1, sigma_range, sigma_space, borderType=cv2.BORDER_REFLECT_101
    )
    got = filtered(plane, plane, sigma_space, sigma_range, radius)
    assert np.abs(want - plane).max() > 0.01
    np.testing.assert_allclose(got, want, atol=2e-6)


@pytest.mark.parametrize("shape", SIZES)
def test_joint_planes_equal_the_loop(shape, rng, x64):
    a, b, guide = rng.uniform(-0.5, 1.5, (3, *shape))
    got = bilateral_planes((jnp.asarray(a), jnp.asarray(b)), jnp.asarray(guide), 1.3, 0.2, 3)
    np.testing.assert_allclose(got, naive((a, b), guide, 1.3, 0.2, 3), atol=1e-13)


def test_float32_equals_the_loop():
    """Also where weights underflow, and where the disc takes several kernels."""
    plane, guide = (smooth_image((25, 31), seed).astype(np.float32) for seed in (0, 1))
    for sigma_range in (5e-5, 0.03, 1e2):
        got = filtered(plane, guide, 4.0, sigma_range, 6)
        want = naive((plane.astype(float),), guide.astype(float), 4.0, sigma_range, 6)[0]
        np.testing.assert_allclose(got, want, atol=2e-6)


@pytest.mark.parametrize("shape", SIZES)
def test_gradient_equals_plain_autodiff(shape, rng, x64):
    """To both planes, the guide and both sigmas; borders included."""
    a, b, guide, weight_a, weight_b = (jnp.asarray(x) for x in rng.uniform(-0.5, 1.5, (5, *shape)))
    arguments = a, b, guide, jnp.asarray(1.3), jnp.asarray(0.3)

    def ours(a, b, guide, space, range_):
        out = bilateral_planes((a, b), guide, space, range_, 2)
        return jnp.sum(out[0] * weight_a + out[1] ** 2 * weight_b)

    def plain(a, b, guide, space, range_):
        first, second = naive((a, b), guide, space, range_, 2, jnp)
        return jnp.sum(first * weight_a + second**2 * weight_b)

    argnums = tuple(range(5))
    got, want = (jax.jit(jax.grad(f, argnums))(*arguments) for f in (ours, plain))
    for g, w in zip(got, want):
        assert np.abs(w).max() > 1e-3
        np.testing.assert_allclose(g, w, atol=1e-12)


def test_gradient_equals_finite_differences(rng, x64):
    """Of the plane as its own guide, with a disc that takes several kernels."""
    plane, direction, weights = rng.uniform(0, 1, (3, 11, 14))
    sigmas, turn, h = np.array([2.0, 0.2]), np.array([0.7, -0.4]), 1e-6

    @jax.jit
    def loss(plane, sigmas):
        return jnp.sum(bilateral_plane(plane, plane, sigmas[0], sigmas[1], 4) * weights)

    slope, by_sigma = jax.jit(jax.grad(loss, (0, 1)))(plane, sigmas)
    ends = [loss(plane + e * direction, sigmas + e * turn) for e in (h, -h)]
    got = np.sum(slope * direction) + np.sum(by_sigma * turn)
    np.testing.assert_allclose(got, (ends[0] - ends[1]) / (2 * h), rtol=1e-7)


def test_forward_mode_is_the_transpose_of_reverse_mode(rng, x64):
    """To all arguments, jitted and vmapped: <J v, c> = <v, J' c>, and J v by finite differences."""
    a, b, guide = rng.uniform(0, 1, (3, 2, 9, 13))
    arguments = (a, b), guide, np.array([1.2, 2.5]), np.array([0.2, 0.4])
    change = jax.tree.map(lambda x: rng.standard_normal(x.shape), arguments)
    cotangent = tuple(rng.standard_normal((2, *a.shape)))
    batched = jax.vmap(lambda *x: bilateral_planes(*x, 2))
    both = jax.jit(lambda *x: both_modes(batched, x, change, cotangent))
    out, tangent, pulled = both(*arguments)
    leaves = jax.tree.leaves
    inner = sum(np.sum(x * y) for x, y in zip(leaves(pulled), leaves(change)))
    np.testing.assert_allclose(sum(np.sum(t * c) for t, c in zip(tangent, cotangent)), inner, rtol=1e-10)
    ends = [both(*jax.tree.map(lambda x, d: x + h * d, arguments, change))[0] for h in (1e-6, -1e-6)]  # noqa: B023
    for now, t, up, down in zip(out, tangent, *ends):
        np.testing.assert_allclose(t, (up - down) / 2e-6, atol=1e-6)
        assert np.abs(now - (up + down) / 2).max() < 1e-6


def test_second_derivatives_in_single_precision(rng):
    """Whose weights are polynomials and bits, which autodiff sees nothing of."""
    plane = jnp.asarray(rng.random((9, 11)), jnp.float32)

    def twice(call):
        second = jax.grad(jax.grad(lambda s: jnp.sum(call(plane, 1.2, s) ** 2)))
        return jax.jit(second)(jnp.float32(0.3))

    got = twice(lambda p, space, sigma: bilateral_plane(p, p, space, sigma, 2))
    want = twice(lambda p, space, sigma: naive((p,), p, space, sigma, 2, jnp)[0])
    assert abs(want) > 0.1
    np.testing.assert_allclose(got, want, rtol=1e-3)


def test_single_precision_stays_where_double_is_enabled(rng, x64):
    plane = jnp.asarray(rng.random((7, 9)), jnp.float32)
    value, slope = jax.value_and_grad(lambda p, s: jnp.sum(bilateral_plane(p, p, s, 0.2, 2)), (0, 1))(
        plane, jnp.float32(1.2)
    )
    assert value.dtype == slope[0].dtype == slope[1].dtype == jnp.float32


def test_powers_of_two():
    """Against float64, over all that single precision holds; less is as good as nothing."""
    x = np.linspace(-130, 0, 100_001).astype(np.float32)
    got, normal = jax.jit(_exp2)(x), x > -125
    np.testing.assert_allclose(got[normal], np.exp2(x[normal].astype(float)), rtol=3e-7)
    assert np.all((got[~normal] >= 0) & (got[~normal] < 1e-37))


def test_float32_gradient_of_sigmas(rng):
    """sigma_range goes by a scaling identity, which must not cost precision."""
    plane = smooth_image((25, 34))
    weights = rng.standard_normal(plane.shape)

    def slope(dtype):
        p, w = (jnp.asarray(x, dtype) for x in (plane, weights))
        loss = lambda s: jnp.sum(bilateral_plane(p + 5, p + 5, s[0], s[1], 2) * w)  # noqa: E731
        return np.asarray(jax.jit(jax.grad(loss))(jnp.asarray([1.5, 0.05], dtype)))

    single = slope(np.float32)
    with jax.enable_x64(True):
        double = slope(np.float64)
    np.testing.assert_allclose(single, double, rtol=2e-3)


run = jax.jit(bilateral, static_argnames=("radius", "chroma_radius", "iterations"))


def stage(params, image, **static):
    return np.asarray(run(params, image, **static))


def test_grey_image_equals_opencv():
    """Without chroma and at gamma 1 the stage is the plain filter of luma."""
    plane = smooth_image((21, 34)).astype(np.float32)
    params = Bilateral(luma_sigma_space=2.0, luma_sigma_range=0.1, guide_gamma=1.0)
    out = stage(params, np.stack([plane] * 3, -1), radius=3, chroma_radius=1, iterations=2)
    want = plane
    for _ in range(2):
        want = cv2.bilateralFilter(want, 7, 0.1, 2.0, borderType=cv2.BORDER_REFLECT_101)
    np.testing.assert_allclose(out, np.stack([want] * 3, -1), atol=5e-6)


def test_chroma_follows_the_filtered_luma(x64):
    image = smooth_image((17, 22, 3))
    params = Bilateral(
        luma_sigma_space=1.2,
        luma_sigma_range=0.08,
        chroma_sigma_space=2.5,
        chroma_sigma_range=0.3,
        guide_gamma=0.5,
    )
    out = stage(params, jnp.asarray(image), radius=2, chroma_radius=3)
    y, cb, cr = (np.asarray(p) for p in rgb_to_ycbcr_planes(*np.moveaxis(image, -1, 0)))
    (guide,) = naive((y,), np.sqrt(y + 1e-4), 1.2, 0.08, 2)
    got = rgb_to_ycbcr_planes(*np.moveaxis(out, -1, 0))
    want = (guide, *naive((cb, cr), guide, 2.5, 0.3, 3))
    for g, w in zip(got, want):
        np.testing.assert_allclose(g, w, atol=1e-6)  # parameters are float32


def test_guide_below_one_spares_shadows():
    """The same step in light survives in the shadows and is smoothed in the highlights."""
    step = 0.04 * (np.arange(24) >= 12) * np.ones((9, 1))
    params = Bilateral(luma_sigma_range=0.03, guide_gamma=0.4)

    def left(base):
        out = stage(params, np.stack([(base + step).astype(np.float32)] * 3, -1), radius=3, chroma_radius=1)[
            4, :, 0
        ]
        return out[12] - out[11]

    assert left(0.01) > 0.035
    assert left(0.8) < 0.02
