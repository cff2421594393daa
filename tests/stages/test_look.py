"""The tone curve against SciPy's splines, local tone mapping against its formula with SciPy's Gaussian."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.interpolate import BSpline
from scipy.ndimage import correlate1d, gaussian_filter

from jaxisp.pipeline import run, stage
from jaxisp.stages.look import (
    SECTORS,
    LocalToneMapping,
    SelectiveColor,
    SplineCurve,
    _by_hue,
    _reflected_gaussian,
)
from jaxisp.testing import smooth_image

LUMA = np.array([0.299, 0.587, 0.114])


def mapped(image, **params):
    node = stage("local_tone_mapping")
    return np.asarray(run(node, {node.name: LocalToneMapping(**params)}, image.astype(np.float32)))


def wanted(image, compression, detail, sigma, edges):
    def mean(plane):
        return gaussian_filter(plane, sigma, mode="nearest")

    y = image @ LUMA
    even, log = np.log2(np.maximum(mean(y), 0.004)), np.log2(np.maximum(y, 0.004))
    variance = mean((log - mean(log)) ** 2)
    share = variance / (variance + 1)
    kept = mean(share) * log + mean((1 - share) * mean(log))
    surround = even + edges * (kept - even)
    gain = 2 ** (-compression * (surround - surround.mean()))
    return image * gain[..., None] + (detail * (y - mean(y)))[..., None]


@pytest.mark.parametrize("edges", [0, 0.4, 1])
@pytest.mark.parametrize("sigma", [6, 14])
def test_local_tone_mapping_is_its_formula(sigma, edges):
    image = np.stack([smooth_image((128, 160), seed) for seed in range(3)], -1) ** 2
    image[:, 80:] *= 0.05
    params = {"compression": 0.3, "detail": 0.2, "sigma": sigma, "edges": edges}
    out, want = mapped(image, **params), wanted(image, **params)
    inner = np.s_[24:-24, 24:-24]  # its means are of 4x4 blocks, borders of which differ
    error, change = (np.sqrt(np.mean((out - a)[inner] ** 2)) for a in (want, image))
    assert error < 0.01 * change


def test_an_edge_of_several_stops_has_less_of_a_halo_beside_an_edge_aware_surround():
    image = np.full((96, 128, 3), 0.8)
    image[:, 64:] = 0.01
    even, aware = (mapped(image, compression=0.4, edges=e)[48, :, 1] for e in (0, 1))
    halo = [np.ptp(np.log2(out[40:64])) + np.ptp(np.log2(out[64:88])) for out in (even, aware)]
    assert halo[1] < 0.5 * halo[0]


def test_it_is_the_identity_at_zero():
    image = np.random.default_rng(0).random((40, 44, 3)).astype(np.float32)
    np.testing.assert_array_equal(mapped(image, edges=1, sigma=5), image)


@pytest.mark.parametrize("count", [2, 3, 12])
def test_the_tone_curve_is_scipy_s_spline_and_so_is_its_gradient(count):
    rng = np.random.default_rng(count)
    offsets = rng.normal(0, 0.2, count).astype(np.float32)
    centres = np.linspace(0, 1, count)
    x = np.concatenate([centres, [-0.3, 1.4], rng.random(200)]).astype(np.float32)
    # a basis spline a centre, and one beyond either end with the end's weight
    knots = (np.arange(count + 6) - 3) / (count - 1)
    spline = BSpline(knots, np.pad(offsets.astype(float), 1, mode="edge"), 3)
    inside = np.clip(x.astype(float), 0, 1)
    node, image = stage("spline_curve"), np.tile(x[None, :, None], (1, 1, 3))

    def curved(offsets, image):
        return run(node, {node.name: SplineCurve(offsets=offsets)}, image)

    np.testing.assert_allclose(curved(offsets, image)[0, :, 0], x + spline(inside), atol=1e-6)
    weights = rng.normal(size=image.shape).astype(np.float32)
    gradient = jax.jit(jax.grad(lambda o, v: (curved(o, v) * weights).sum(), (0, 1)))
    own, slope = gradient(offsets, image)
    basis = BSpline(knots, np.eye(count + 2), 3)(inside)
    basis = np.concatenate([basis[:, :2].sum(1)[:, None], basis[:, 2:-2], basis[:, -2:].sum(1)[:, None]], 1)
    np.testing.assert_allclose(own, weights.sum((0, 2)) @ basis, rtol=1e-4, atol=1e-4)
    within = (x > 0) & (x < 1) & ~np.isin(x, centres.astype(np.float32))
    wanted = 1 + spline.derivative()(inside)
    np.testing.assert_allclose(
        (slope / weights)[0, within, 0], wanted[within], rtol=1e-4, atol=1e-4 * (count - 1)
    )


def test_tables_by_hue_have_the_slopes_of_finite_differences(rng, x64):
    """Hues a little inside of their sectors, the first and the last of the circle among them."""
    middles = 2 * np.pi / SECTORS * (np.arange(-SECTORS // 2, SECTORS // 2) + 0.4)
    hue = jnp.asarray(np.tile(middles, (2, 1)))
    tables = tuple(jnp.asarray(t) for t in rng.standard_normal((3, SECTORS)))
    check_grads(jax.jit(_by_hue), (hue, tables), order=2, modes=["fwd", "rev"], rtol=1e-5)


def test_tables_in_single_precision_beside_a_picture_in_double(x64):
    node, image = stage("selective_color"), smooth_image((6, 8, 3)).astype(float)
    tables = jax.tree.map(jnp.float32, SelectiveColor())
    slopes = jax.grad(lambda p: jnp.sum(run(node, {node.name: p}, image) ** 2))(tables)
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(slopes))


@pytest.mark.parametrize("shape", [(20, 17), (1, 7), (2, 3), (31, 62)])
@pytest.mark.parametrize("variance", [0.1, 4.0, 100.0])
def test_the_wide_blur_is_a_gaussian_of_reflected_borders(shape, variance, rng, x64):
    """Also where the window meets a sample several times."""
    plane = rng.random(shape)
    k = np.arange(-30, 31)
    taps = np.exp(-0.5 * k**2 / variance)
    want = plane
    for axis in range(2):
        edge = "mirror" if shape[axis] > 1 else "nearest"
        want = correlate1d(want, taps / taps.sum(), axis, mode=edge)
    taps_of = jax.jit(_reflected_gaussian, static_argnums=(0, 2))
    down, across = (taps_of(n, jnp.float64(variance), 30) for n in shape)
    np.testing.assert_allclose(down @ plane @ across.T, want, atol=1e-12)
