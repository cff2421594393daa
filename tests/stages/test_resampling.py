"""Resizing against Pillow and OpenCV."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxisp.stages import resampling as stages
from jaxisp.stages.resampling import Resampling, Rescaling, _there_and_back, _Way
from jaxisp.testing import smooth_image
from tests.jitted import jitted

resampling, rescaling, resize = map(jitted, (stages.resampling, stages.rescaling, stages.resize))

FILTERS = {
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos3": Image.Resampling.LANCZOS,
}
IMAGE = smooth_image((24, 40, 3)).astype(np.float32)


def pillow(image: np.ndarray, shape: tuple[int, int], method: str) -> np.ndarray:
    size = shape[::-1]
    return np.stack([Image.fromarray(image[..., c]).resize(size, FILTERS[method]) for c in range(3)], -1)


@pytest.mark.parametrize("method", sorted(FILTERS))
@pytest.mark.parametrize("factor", [0.37, 0.5, 0.7, 1.6])
def test_resize_is_pillows(method, factor):
    got = resize(IMAGE, factor=factor, method=method)
    assert got.shape == (round(24 * factor), round(40 * factor), 3)
    np.testing.assert_allclose(got, pillow(IMAGE, got.shape[:2], method), atol=1e-6)


@pytest.mark.parametrize("factor", [1 / 3, 2 / 3, 2.0])
def test_nearest_is_opencvs(factor):
    image = smooth_image((24, 48, 3)).astype(np.float32)  # at these sizes no centre falls between two pixels
    got = resize(image, factor=factor, method="nearest")
    want = cv2.resize(image, got.shape[1::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize("factor", [0.37, 0.5, 0.75])
def test_area_is_opencvs(factor):
    got = resize(IMAGE, factor=factor, method="area")
    want = cv2.resize(IMAGE, got.shape[1::-1], interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(got, want, atol=1e-6)


def test_without_antialiasing_is_opencvs_interpolation():
    got = resize(IMAGE, factor=0.37, method="bilinear", antialias=False)
    want = cv2.resize(IMAGE, got.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(got, want, atol=1e-4)  # OpenCV's float weights are coarser


@pytest.mark.parametrize("method", [*FILTERS, "nearest", "area"])
def test_factor_one_is_the_identity(method):
    np.testing.assert_allclose(resize(IMAGE[:21, :33], factor=1.0, method=method), IMAGE[:21, :33], atol=1e-6)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_resampling_is_pillow_there_and_back(method):
    run = jax.jit(lambda f, x: resampling(Resampling(factor=f), x, method=method))
    np.testing.assert_array_equal(run(jnp.float32(1), IMAGE), IMAGE)
    for factor in (2.0, 1.6, 4.0, 4 / 3):
        small = pillow(IMAGE, (round(24 / factor), round(40 / factor)), method)
        want = pillow(small, (24, 40), method)
        np.testing.assert_allclose(run(jnp.float32(factor), IMAGE), want, atol=1e-6)


@pytest.mark.parametrize("factor", [2.0, 1.6, 4.0])
def test_resampling_that_is_not_antialiased_is_opencvs(factor):
    cv2 = pytest.importorskip("cv2")
    small = cv2.resize(IMAGE, (round(40 / factor), round(24 / factor)), interpolation=cv2.INTER_LINEAR)
    want = cv2.resize(small, (40, 24), interpolation=cv2.INTER_LINEAR)
    got = resampling(Resampling(factor=np.float32(factor)), IMAGE, antialias=False)
    np.testing.assert_allclose(got, want, atol=1e-6)


def test_rescaling_mixes_ways():
    factor, shares = np.float32(1.6), np.float32([0.25, 0, 0.5])
    ways = [
        {},
        {"back": "bicubic", "antialias": False},
        {"method": "bicubic", "back": "bilinear", "antialias": False},
    ]
    first, second, last = (np.asarray(resampling(Resampling(factor=factor), IMAGE, **way)) for way in ways)
    want = first + 0.25 * (second - first) + 0.5 * (last - first)
    np.testing.assert_allclose(rescaling(Rescaling(factor=factor, shares=shares), IMAGE), want, atol=1e-6)
    off = Rescaling(factor=np.float32(1), shares=np.zeros(3, np.float32))
    np.testing.assert_array_equal(rescaling(off, IMAGE), IMAGE)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_resampling_of_a_large_image_is_banded_and_the_same(method):
    """In blocks, beside Pillow and beside the full matrices, and so are the gradients."""
    image = smooth_image((240, 301, 3), 3).astype(np.float32)
    weights = np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)

    def whole(factor, x):
        rows, columns = (_there_and_back(n, n, factor, _Way(method, method, True)) for n in x.shape[:2])
        return jnp.einsum("ab,bcd,ec->aed", rows, x, columns, precision="highest")

    def blocks(factor, x):
        return resampling(Resampling(factor=factor), x, method=method)

    calls = [
        jax.jit(jax.grad(lambda f, x, c=c: jnp.sum(weights * c(f, x)), argnums=(0, 1)))
        for c in (blocks, whole)
    ]
    for factor in (1.0, 1.37, 2.0, 4.0):
        got, want = (call(jnp.float32(factor), image) for call in calls)
        np.testing.assert_allclose(got[1], want[1], atol=2e-6)
    got, want = (call(jnp.float32(1.9), image) for call in calls)
    np.testing.assert_allclose(got[0], want[0], rtol=1e-3)
    even = image[:, :300]
    want = pillow(pillow(even, (120, 150), method), even.shape[:2], method)
    np.testing.assert_allclose(jax.jit(blocks)(jnp.float32(2.0), even), want, atol=2e-6)


def test_resampling_keeps_constants_at_any_factor_and_size():
    for factor in (1.0, 1.01, 1.37, 3.3, 4.0):
        flat = np.full((7, 1, 3), 0.4, np.float32)
        np.testing.assert_allclose(resampling(Resampling(factor=jnp.float32(factor)), flat), flat, atol=1e-6)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_large_constants_are_kept_where_the_last_sample_stands_outside(method):
    flat = np.full((301, 257, 3), 0.4, np.float32)
    run = jax.jit(lambda f: resampling(Resampling(factor=f), flat, method=method))
    slope = jax.jit(jax.grad(lambda f: run(f).sum()))
    for factor in (1.0033, 1.0128, 1.0132, 1.0199, 1.0553):
        np.testing.assert_allclose(run(jnp.float32(factor)), flat, atol=1e-6)
        assert abs(slope(jnp.float32(factor))) < 1


@pytest.mark.parametrize("start", [1.78, 2.06])
def test_factor_is_found_by_gradient(start):
    image = smooth_image((16, 16, 3), 2).astype(np.float32)
    target = resampling(Resampling(factor=jnp.float32(1.9)), image)

    def error(factor):
        return jnp.mean((resampling(Resampling(factor=factor), image) - target) ** 2)

    gradient, factor = jax.jit(jax.grad(error)), jnp.float32(start)
    for i in range(30):
        factor -= 0.02 * 0.95**i * jnp.sign(gradient(factor))
    assert abs(float(factor) - 1.9) < 0.01


def test_unknown_methods_are_refused():
    with pytest.raises(ValueError, match="method"):
        resize(IMAGE, method="sinc")
    with pytest.raises(ValueError, match="factor"):
        resize(IMAGE, factor=0.0)
    with pytest.raises(ValueError, match="method"):
        resampling(Resampling(), IMAGE, method="area")
