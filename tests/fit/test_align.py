"""Registration of photographs that SciPy and OpenCV moved; the warp against SciPy and its own definition."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
import skimage.data

from jaxisp.fit.align import Alignment, best_orientation, covered, estimate, same_scene, warp
from jaxisp.io.orientation import unorient
from jaxisp.testing import smooth_image

ASTRONAUT, CHELSEA, COFFEE = (getattr(skimage.data, n)() / 255 for n in ("astronaut", "chelsea", "coffee"))


def moved(photograph, true, shape, corner=(40, 60)):
    """(reference, moving): cut out of a photograph so that `true` relates them."""
    h, w = shape
    rows = (h - 1) / 2 + true.scale_y * (np.arange(h) - (h - 1) / 2) + true.dy + corner[0]
    columns = (w - 1) / 2 + true.scale_x * (np.arange(w) - (w - 1) / 2) + true.dx + corner[1]
    grid = np.meshgrid(rows, columns, indexing="ij")
    planes = [scipy.ndimage.map_coordinates(photograph[..., c], grid, order=5) for c in range(3)]
    return np.stack(planes, -1), photograph[corner[0] : corner[0] + h, corner[1] : corner[1] + w]


def rendered(rng, reference, moving, gamma=2.2, noise=0.01):
    """The same with another tone and colour, and noise on both."""
    moving = (moving**gamma) @ np.array([[0.9, 0.1, 0], [0.05, 0.9, 0.05], [0, 0.1, 0.9]]).T
    return tuple(x + noise * rng.standard_normal(x.shape) for x in (reference, moving))


def center_error(found, true):
    return max(abs(found.dy - true.dy), abs(found.dx - true.dx))


@pytest.mark.parametrize("photograph", [ASTRONAUT, CHELSEA, COFFEE], ids=["astronaut", "chelsea", "coffee"])
@pytest.mark.parametrize(
    "true",
    [
        Alignment(0.0, 0.0, 1.0, 1.0),
        Alignment(0.37, -1.22, 1.0, 1.004),
        Alignment(-11.6, 8.45, 0.997, 1.006),
    ],
    ids=["none", "small", "large"],
)
def test_shift_and_scale_of_another_rendering_are_found(rng, photograph, true):
    reference, moving = rendered(rng, *moved(photograph, true, (201, 260)))
    found = estimate(reference, moving)
    assert center_error(found, true) < 0.05
    assert abs(found.scale_y - true.scale_y) * 100 < 0.1  # px at the border
    assert abs(found.scale_x - true.scale_x) * 130 < 0.1
    assert same_scene(found, moving.shape)


@pytest.mark.parametrize("dy, dx", [(0.25, -0.40625), (-6.5, 3.3125)])
def test_a_shift_by_opencv_is_found(dy, dx):
    """OpenCV moves by multiples of 1/32 px."""
    image = np.float32(CHELSEA)
    matrix = np.float64([[1, 0, dx], [0, 1, dy]])  # reads at (x + dx, y + dy)
    flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
    reference = cv2.warpAffine(image, matrix, image.shape[1::-1], flags=flags)
    found = estimate(reference[20:250, 30:400], image[20:250, 30:400])
    assert center_error(found, Alignment(dy, dx)) < 0.02


def test_a_small_noisy_patch_keeps_its_scale(rng):
    true = Alignment(1.3, -0.6, 1.0, 1.0)
    reference, moving = rendered(rng, *moved(CHELSEA, true, (80, 97), (90, 120)), noise=0.05)
    found = estimate(reference, moving)
    assert center_error(found, true) < 0.15
    assert max(abs(found.scale_y - 1), abs(found.scale_x - 1)) < 0.005


def test_pictures_of_other_sizes():
    cut = estimate(COFFEE[10:-20, 5:-30], COFFEE)
    assert center_error(cut, Alignment(-5, -12.5)) < 0.01
    np.testing.assert_allclose([cut.scale_y, cut.scale_x], 1, atol=1e-4)
    half = cv2.resize(COFFEE, (300, 200), interpolation=cv2.INTER_AREA)
    for found, scale in ((estimate(half, COFFEE), 2.0), (estimate(COFFEE, half), 0.5)):
        assert center_error(found, Alignment(0, 0)) < 0.05
        np.testing.assert_allclose([found.scale_y, found.scale_x], scale, rtol=1e-3)
        assert found.correlation <= 1
    large = cv2.resize(ASTRONAUT, (2600, 1500), interpolation=cv2.INTER_CUBIC)
    found = estimate(large[3:-8, 11:-6], large)  # worked on at half the size, of odd numbers
    assert center_error(found, Alignment(-2.5, 2.5)) < 0.05


def test_different_scenes_are_told_from_one(rng):
    photographs = [ASTRONAUT, CHELSEA, COFFEE]
    for i, a in enumerate(photographs):
        for b in photographs[i + 1 :]:
            for size in (80, 200):
                y, x = rng.integers(0, 90, 2)
                one, other = a[y : y + size, x : x + size], b[y : y + size, x : x + size]
                assert not same_scene(estimate(one, other), one.shape)
                assert same_scene(estimate(one, rng.normal(np.sqrt(one), 0.03)), one.shape)
    noise, flat = rng.uniform(size=(64, 80)), np.full((64, 80), 0.5)
    assert not same_scene(estimate(noise, flat), flat.shape)
    assert not same_scene(estimate(flat, flat), flat.shape)


@pytest.mark.parametrize("scale", [1.0, 0.88, 1.2])
@pytest.mark.parametrize(
    "corner, shape", [((50, 40), (400, 350)), ((375, 825), (400, 350)), ((200, 400), (350, 400))]
)
def test_a_part_is_found_wherever_it_was_cut(rng, corner, shape, scale):
    """Upright of a wide picture, from a corner and from the middle, resized by OpenCV."""
    whole = np.clip(cv2.resize(COFFEE, (1200, 800), interpolation=cv2.INTER_CUBIC), 0, 1)
    (y, x), (h, w) = corner, shape
    part = cv2.resize(whole[y : y + h, x : x + w], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    part, moving = rendered(rng, part, whole)
    true = Alignment(y + (h - 1) / 2 - 399.5, x + (w - 1) / 2 - 599.5, 1 / scale, 1 / scale)
    for found, where in (
        (estimate(part, moving), true),
        (estimate(moving, part), Alignment(-true.dy * scale, -true.dx * scale, scale, scale)),
    ):
        assert center_error(found, where) < 0.3
        np.testing.assert_allclose([found.scale_y, found.scale_x], where.scale_y, rtol=2e-3)
        assert same_scene(found, part.shape, moving.shape)


def test_no_place_is_found_for_a_part_of_another_scene(rng):
    whole, other = (cv2.resize(p, (1200, 800), interpolation=cv2.INTER_CUBIC) for p in (COFFEE, CHELSEA))
    for part in (other[50:450, 40:390], other[:200, :200], cv2.resize(whole[200:600, 300:700], (200, 200))):
        found = estimate(part, whole)
        assert 0 <= found.correlation < 0.5 and not same_scene(found, part.shape, whole.shape)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_is_found(rng, orientation):
    reference, moving = rendered(rng, *moved(COFFEE, Alignment(2.3, -1.6, 1.0, 1.0), (120, 181)))
    assert best_orientation(reference, unorient(moving, orientation)) == orientation


laid = jax.jit(warp, static_argnames="shape")
within = jax.jit(covered, static_argnums=1)


@pytest.mark.parametrize("shape", [(21, 34, 3), (34, 21), (5, 4)])
def test_the_identity_warp_is_exact(shape):
    image = jnp.float32(smooth_image(shape))
    np.testing.assert_array_equal(laid(image, Alignment()), image)
    assert within(Alignment(), shape).all()


def test_warp_reads_where_the_alignment_says(x64):
    y, x = np.mgrid[:21, :34]
    ramp = 0.3 + 0.01 * y + 0.02 * x + 1e-3 * x * y  # cubic convolution keeps what is linear on each axis
    where = Alignment(0.7, -1.6, 0.9, 1.03)
    out = laid(ramp, where, shape=(15, 24))
    rows = 10 + 0.9 * (np.arange(15) - 7) + 0.7
    columns = 16.5 + 1.03 * (np.arange(24) - 11.5) - 1.6
    expected = 0.3 + 0.01 * rows[:, None] + 0.02 * columns + 1e-3 * np.outer(rows, columns)
    np.testing.assert_allclose(out, expected)


def test_warp_beyond_the_border_repeats_it(x64):
    image = smooth_image((9, 12))
    far = Alignment(dy=-1e12, dx=3.0)
    np.testing.assert_allclose(laid(image, far)[:, :6], np.broadcast_to(image[0, 3:9], (9, 6)), atol=1e-12)
    inside = within(Alignment(dy=-1.5, dx=3.0), (9, 12))
    np.testing.assert_array_equal(inside, np.outer(np.arange(9) >= 2, np.arange(12) < 9))


def test_the_gradients_of_warp_are_exact(x64):
    image = smooth_image((13, 18))
    weight = np.random.default_rng(2).standard_normal((13, 18))

    def loss(values, image):
        return (weight * warp(image, Alignment(*values))).sum()

    both = jax.jit(jax.value_and_grad(loss, (0, 1)))
    at = np.array([0.31, -1.27, 0.996, 1.011])
    numeric = [(both(at + h, image)[0] - both(at - h, image)[0]) / 2e-6 for h in 1e-6 * np.eye(4)]
    value, (by_values, by_image) = both(at, image)
    np.testing.assert_allclose(by_values, numeric, rtol=1e-6)
    np.testing.assert_allclose((by_image * image).sum(), value, rtol=1e-9)  # it is linear in the image


def test_unusable_pictures_are_named():
    with pytest.raises(ValueError, match="moving: 15x40 px is too small"):
        estimate(np.zeros((40, 40)), np.zeros((15, 40)))
    with pytest.raises(ValueError, match="reference: holds NaN"):
        estimate(np.full((40, 40), np.nan), np.zeros((40, 40)))
