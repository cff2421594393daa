"""Deconvolution against scikit-image and White's formula."""

import jax
import numpy as np
import pytest
from scipy.ndimage import correlate1d
from skimage.restoration import richardson_lucy

from jaxisp.color import luma
from jaxisp.pipeline import run, stage
from jaxisp.stages.detail import RichardsonLucy, deconvolved
from jaxisp.testing import smooth_image

RADIUS = 4


def blurred(plane, sigma):
    taps = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / sigma) ** 2)
    return correlate1d(
        correlate1d(plane, taps / taps.sum(), 0, mode="mirror"), taps / taps.sum(), 1, mode="mirror"
    )


def sharp(shape=(72, 80)):
    scene = smooth_image(shape)
    scene[20:44, 30:60] *= 0.3  # an edge, and a corner
    return np.clip(scene, 0.05, None)


def test_iterations_are_those_of_scikit_image():
    """From its start, which is flat; it pads with zeros, so that the inside is compared."""
    iterations, data = 3, blurred(sharp(), 1.2).astype(np.float32)
    taps = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / 1.2) ** 2)
    psf = np.outer(taps, taps) / taps.sum() ** 2
    want = richardson_lucy(data, psf.astype(np.float32), num_iter=iterations, clip=False)
    start = np.full_like(data, 0.5)
    got = jax.jit(deconvolved, static_argnums=(4, 5))(data, start, 1.2, 0.0, iterations, RADIUS)
    inside = np.s_[2 * iterations * RADIUS : -2 * iterations * RADIUS,] * 2
    np.testing.assert_allclose(np.asarray(got)[inside], want[inside], rtol=1e-5)
    assert np.abs(want - data)[inside].max() > 0.02


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.1])
def test_damping_is_whites(damping):
    picture = np.random.default_rng(3).normal(blurred(sharp(), 0.9)[..., None], 0.01, (72, 80, 3))
    picture = picture.astype(np.float32)
    y = np.asarray(luma(*np.moveaxis(picture.astype(float), -1, 0)))
    found = y.copy()
    for _ in range(4):
        model = blurred(found, 0.9)
        u = np.ones_like(y)
        if damping:
            u = np.minimum(-2 / damping**2 * (y * np.log(model / y) - model + y), 1)
        found *= blurred(1 + u**9 * (10 - 9 * u) * (y - model) / model, 0.9)
    want = picture * (1 + 0.8 * (found / y - 1))[..., None]
    params = {k: np.float32(v) for k, v in (("sigma", 0.9), ("amount", 0.8), ("damping", damping))}
    node = stage("richardson_lucy", iterations=4, radius=RADIUS)
    got = run(node, {node.name: RichardsonLucy(**params)}, picture)
    np.testing.assert_allclose(got, want, atol=2e-5)


def test_it_undoes_the_blur_and_damping_leaves_noise_alone():
    def far(plane, truth, damping=0.0):
        own = RichardsonLucy(sigma=np.float32(1), amount=np.float32(1), damping=np.float32(damping))
        node = stage("richardson_lucy", iterations=20, radius=RADIUS)
        picture = np.repeat(plane[..., None], 3, -1).astype(np.float32)
        found = np.asarray(run(node, {node.name: own}, picture))[..., 0]
        return float(np.sqrt(np.mean((found - truth) ** 2)))

    scene = np.full((72, 80), 0.7)
    scene[20:44, 30:60] = 0.2
    scene = blurred(scene, 0.8)  # finer detail does not come back
    soft = blurred(scene, 1.0)
    assert far(soft, scene) < 0.4 * np.sqrt(np.mean((soft - scene) ** 2))
    noisy = 0.4 + 0.005 * np.random.default_rng(0).standard_normal(scene.shape)
    assert far(noisy, noisy, 0.05) < 0.05 * far(noisy, noisy)


def test_the_picture_is_kept_where_nothing_is_to_be_done():
    picture = smooth_image((20, 24, 3)).astype(np.float32)
    node = stage("richardson_lucy", iterations=3)
    for params in (RichardsonLucy(amount=np.float32(0)), RichardsonLucy(sigma=np.float32(0.1))):
        np.testing.assert_allclose(run(node, {node.name: params}, picture), picture, rtol=1e-6)
