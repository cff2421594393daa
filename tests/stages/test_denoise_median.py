"""The median filter against SciPy and OpenCV, its networks by the zero-one principle, its gradient."""

import itertools

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxisp.stages.denoise.median import Median, median, median_plane
from jaxisp.stages.denoise.networks import MEDIAN_3X3, MEDIAN_5, MEDIAN_5X5, SORT_3, SORT_5, compare
from jaxisp.testing import smooth_image
from tests.gradients import both_modes

FOOTPRINTS = {
    "cross": np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool),
    "3x3": np.ones((3, 3), bool),
    "5x5": np.ones((5, 5), bool),
}
filtered = jax.jit(median_plane, static_argnums=1)


@pytest.mark.parametrize("footprint", FOOTPRINTS)
@pytest.mark.parametrize("shape", [(21, 34), (5, 4), (2, 3), (1, 7)])
def test_plane_equals_scipy(footprint, shape, rng):
    for plane in (rng.standard_normal(shape), rng.integers(0, 4, shape)):  # the latter with many ties
        want = ndimage.median_filter(plane.astype(np.float32), footprint=FOOTPRINTS[footprint], mode="mirror")
        np.testing.assert_array_equal(filtered(plane.astype(np.float32), footprint), want)


@pytest.mark.parametrize("size", [3, 5])
def test_interior_equals_opencv(size):
    plane = smooth_image((21, 34)).astype(np.float32)
    inside = slice(size // 2, -(size // 2))
    got = np.asarray(filtered(plane, f"{size}x{size}"))
    np.testing.assert_array_equal(got[inside, inside], cv2.medianBlur(plane, size)[inside, inside])


def zero_one(counts: int, size: int) -> np.ndarray:
    """All zero-one columns of `size` sorted wires: how many ones each of `counts` columns holds."""
    ones = np.array(list(itertools.product(range(size + 1), repeat=counts))).T
    return (np.arange(size)[:, None, None] >= size - ones).reshape(size * counts, -1).astype(np.float32)


@pytest.mark.parametrize("size, network", [(3, MEDIAN_3X3), (5, MEDIAN_5X5)])
def test_square_networks_select_the_median(size, network):
    """A comparator network is right on all inputs where it is right on all of zeros and ones."""
    wires = zero_one(size, size)
    np.testing.assert_array_equal(compare(list(jnp.asarray(wires)), network)[4], np.median(wires, axis=0))


@pytest.mark.parametrize("network, wires", [(SORT_3, [0, 1, 2]), (SORT_5, [0, 1, 2, 3, 4]), (MEDIAN_5, [2])])
def test_column_networks_sort(network, wires):
    n = 3 if network is SORT_3 else 5
    inputs = np.array(list(itertools.product((0.0, 1.0), repeat=n)), np.float32).T
    got = compare(list(jnp.asarray(inputs)), network)
    for wire in wires:
        np.testing.assert_array_equal(got[wire], np.sort(inputs, axis=0)[wire])


@pytest.mark.parametrize("footprint", FOOTPRINTS)
@pytest.mark.parametrize("shape", [(13, 18), (3, 5), (1, 6)])
def test_gradient_equals_finite_differences(footprint, shape, rng, x64):
    """Pixel by pixel, borders and corners included; the values are far enough apart."""
    plane = rng.permutation(np.prod(shape)).reshape(shape) / np.prod(shape)
    weights = rng.standard_normal(shape)
    slope = jax.jit(jax.grad(lambda x: jnp.sum(median_plane(x, footprint) * weights)))(jnp.asarray(plane))
    reference = lambda x: np.sum(  # noqa: E731
        ndimage.median_filter(x, footprint=FOOTPRINTS[footprint], mode="mirror") * weights
    )
    h = 1e-4 / plane.size
    for y, x in np.ndindex(*shape):
        moved = np.zeros(shape)
        moved[y, x] = h
        want = (reference(plane + moved) - reference(plane - moved)) / (2 * h)
        np.testing.assert_allclose(slope[y, x], want, atol=1e-9)


@pytest.mark.parametrize("footprint", FOOTPRINTS)
def test_ties_share_the_gradient(footprint):
    """On a constant image every pixel of a window has an equal share: the adjoint of the mean."""
    offsets = np.argwhere(FOOTPRINTS[footprint]) - len(FOOTPRINTS[footprint]) // 2
    weights = np.random.default_rng(0).standard_normal((9, 12)).astype(np.float32)
    got = jax.jit(jax.grad(lambda x: jnp.sum(median_plane(x, footprint) * weights)))(jnp.full((9, 12), 0.5))

    def mean(x):
        padded = jnp.pad(x, 2, mode="reflect")
        return sum(padded[2 + dy : 11 + dy, 2 + dx : 14 + dx] for dy, dx in offsets) / len(offsets)

    want = jax.jit(jax.grad(lambda x: jnp.sum(mean(x) * weights)))(jnp.full((9, 12), 0.5))
    np.testing.assert_allclose(got, want, atol=1e-6)


@pytest.mark.parametrize("footprint", FOOTPRINTS)
@pytest.mark.parametrize("ties", [False, True])
def test_forward_mode_is_the_transpose_of_reverse_mode(footprint, ties, rng, x64):
    planes = rng.integers(0, 4, (2, 7, 9)).astype(float) if ties else rng.standard_normal((2, 7, 9))
    change, cotangent = rng.standard_normal((2, *planes.shape))
    batched = jax.vmap(lambda x: median_plane(x, footprint))
    both = jax.jit(lambda x: both_modes(batched, (x,), (change,), cotangent))
    _, tangent, (pulled,) = both(planes)
    np.testing.assert_allclose(np.sum(tangent * cotangent), np.sum(pulled * change), rtol=1e-11)
    if not ties:
        up, down = (np.asarray(both(planes + h * change)[0]) for h in (1e-7, -1e-7))
        np.testing.assert_allclose(tangent, (up - down) / 2e-7, atol=1e-6)


def test_strength_flags_and_iterations():
    image = smooth_image((21, 34, 3)).astype(np.float32)
    grey = np.stack([image[..., 0]] * 3, -1)
    run = jax.jit(
        lambda s, x, **static: median(Median(strength=s), x, **static),
        static_argnames=("footprint", "luma", "chroma", "iterations"),
    )
    half = ndimage.median_filter(grey[..., 0], size=3, mode="mirror")
    twice = ndimage.median_filter(half, size=3, mode="mirror")
    np.testing.assert_allclose(run(1.0, grey, chroma=False, iterations=2)[..., 1], twice, atol=1e-6)
    np.testing.assert_allclose(run(0.5, grey)[..., 1], (half + grey[..., 0]) / 2, atol=1e-6)
    np.testing.assert_allclose(run(1.0, grey, luma=False), grey, atol=1e-6)
    np.testing.assert_allclose(run(0.0, image), image, atol=1e-6)
    assert np.abs(run(1.0, image, luma=False) - image).max() > 0.01


def test_unknown_footprint_is_refused():
    with pytest.raises(ValueError, match="footprint '7x7'"):
        median(Median(), jnp.zeros((5, 6, 3)), footprint="7x7")
