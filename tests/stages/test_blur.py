"""Blurs against SciPy, points splatted one by one and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, ndimage, signal

from jaxisp.pipeline import stage
from jaxisp.stages import blur
from jaxisp.stages.smoothing import STEPS, DirectionalBlur

from .lens import SHAPE, H, W, apply, picture


@pytest.mark.parametrize("sigma", [0.3, 1.1, 4.0])
def test_optical_blur_against_scipy(sigma):
    image = picture()
    want = ndimage.gaussian_filter(image.astype(float), (sigma, sigma, 0), mode="mirror", radius=(12, 12, 0))
    np.testing.assert_allclose(apply(blur.OpticalBlur(sigma=sigma), image), want, atol=1e-6)
    np.testing.assert_array_equal(apply(blur.OpticalBlur(sigma=0.0), image), image)


def splatted(y: np.ndarray, x: np.ndarray, radius: int) -> np.ndarray:
    """Points of equal weight, each spread bilinearly over its four pixels."""
    psf = np.zeros((2 * radius + 3,) * 2)
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    for a, wy in ((0, 1 - (y - i)), (1, y - i)):
        for b, wx in ((0, 1 - (x - j)), (1, x - j)):
            np.add.at(psf, (i + a + radius + 1, j + b + radius + 1), wy * wx)
    assert psf[[0, -1]].sum() + psf[:, [0, -1]].sum() == 0, "it leaves the window"
    return psf[1:-1, 1:-1] / len(y)


JITTED_DISC = jax.jit(blur._disc, static_argnums=1)
JITTED_PATH = jax.jit(blur._path, static_argnums=2)


def disc(size) -> np.ndarray:
    return np.asarray(JITTED_DISC(jnp.asarray(size, float), 8))


def path(lengths, directions) -> np.ndarray:
    return np.asarray(
        JITTED_PATH(jnp.asarray(lengths, float), jnp.deg2rad(jnp.asarray(directions, float)), 12)
    )


def moments(psf: np.ndarray) -> np.ndarray:
    """The sum and the centre of mass."""
    k = np.arange(len(psf)) - len(psf) // 2
    return np.array([psf.sum(), k @ psf.sum(1), k @ psf.sum(0)])


def disc_of_points(size: float, rows: int = 4000) -> np.ndarray:
    """A square grid of points inside a circle, splatted row by row."""
    k = (np.arange(rows) + 0.5) * 2 / rows - 1
    chords = [k[np.abs(k) < half] for half in np.sqrt(1 - k**2)]
    parts = [splatted(np.full(len(x), size * y), size * x, 8) * len(x) for y, x in zip(k, chords) if len(x)]
    return np.sum(parts, axis=0) / sum(map(len, chords))


@pytest.mark.parametrize("size", [0.4, 7.9])
def test_disc_against_points(size, x64):
    psf = disc(size)
    np.testing.assert_allclose(psf, disc_of_points(size), atol=2e-4 * psf.max())
    np.testing.assert_allclose(moments(psf), [1, 0, 0], atol=1e-12)


def test_a_disc_of_no_size_is_a_delta_with_a_slope(x64):
    psf, slope = jax.jit(lambda r: jax.jvp(lambda r: blur._disc(r, 8), (r,), (1.0,)))(0.0)
    np.testing.assert_array_equal(psf, blur._delta(8, psf.dtype))
    for tap in ((8, 9), (8, 7), (9, 8), (7, 8)):  # the mean of max(x, 0) over a disc is 2 r / (3 pi)
        np.testing.assert_allclose(slope[tap], 2 / (3 * np.pi), rtol=0.03)
    edge = blur._SMALLEST_DISC
    below, above = disc(edge - 1e-9), disc(edge + 1e-9)
    np.testing.assert_allclose(below, above, atol=1e-8)


def test_defocus_spreads_a_point_into_the_disc():
    image = np.zeros((H, W, 3), np.float32)
    image[10, 15] = [1, 2, -3]
    out = apply(blur.Defocus(disc_radius=3.3), image)
    np.testing.assert_allclose(out[2:19, 7:24], disc(3.3)[..., None] * image[10, 15], atol=1e-6)
    sharp = 4 * picture() - 1
    np.testing.assert_array_equal(apply(blur.Defocus(), sharp), sharp)


@pytest.mark.parametrize("length", [0.3, 3.0, 8.0])
def test_one_segment_is_a_box(length, x64):
    """A horizontal segment: the box of its length, convolved with the tent and sampled."""
    psf = path([length], [0.0])
    for k in range(-12, 13):
        tent = lambda t, k=k: max(1 - abs(t - k), 0)  # noqa: E731
        ends = (-length / 2, length / 2)
        want = integrate.quad(tent, *ends, points=[p for p in (k - 1, k, k + 1) if abs(p) < length / 2])[0]
        np.testing.assert_allclose(psf[12, k + 12], want / length, atol=1e-12)
    assert np.abs(np.delete(psf, 12, axis=0)).max() < 1e-15
    np.testing.assert_allclose(path([length], [90.0]), psf.T, atol=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_path_against_points(seed, x64):
    rng = np.random.default_rng(seed)
    lengths, degrees = rng.uniform(0, 8, 3), rng.uniform(-180, 180, 3)
    steps = lengths * np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])
    corners = np.concatenate([np.zeros((2, 1)), steps.cumsum(1)], axis=1)
    walked = (np.arange(200_000) + 0.5) / 200_000 * lengths.sum()
    y, x = (np.interp(walked, np.concatenate([[0], lengths.cumsum()]), c) for c in corners)
    psf = path(lengths, degrees)
    np.testing.assert_allclose(psf, splatted(y - y.mean(), x - x.mean(), 12), atol=1e-7)
    np.testing.assert_allclose(moments(psf), [1, 0, 0], atol=1e-12)


def test_a_segment_of_no_length_is_absent(x64):
    two = path([3.0, 5.0], [20.0, 130.0])
    np.testing.assert_allclose(path([3.0, 0.0, 5.0], [20.0, -77.0, 130.0]), two, atol=1e-15)
    np.testing.assert_allclose(path([0.0, 3.0, 5.0, 0.0], [9.0, 20.0, 130.0, 1.0]), two, atol=1e-15)


def test_no_path_is_a_delta_with_a_slope(x64):
    along = lambda n: blur._path(n, jnp.zeros(1), 12)  # noqa: E731
    psf, slope = jax.jit(lambda n: jax.jvp(along, (n,), (jnp.ones(1),)))(jnp.zeros(1))
    np.testing.assert_array_equal(psf, blur._delta(12, psf.dtype))
    np.testing.assert_allclose(slope[12, 11:14], [1 / 8, -1 / 4, 1 / 8], rtol=1e-9)


def test_the_longest_path_fits_the_window(x64):
    psf = path([8.0, 8.0, 8.0], [180.0] * 3)
    np.testing.assert_allclose(psf, path([24.0], [0.0]), atol=1e-12)
    np.testing.assert_allclose(moments(psf), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("side", [1, 7, 25])
def test_convolution_and_its_gradient_against_scipy(side, x64):
    rng = np.random.default_rng(side)
    plane, psf, cotangent = rng.random(SHAPE), rng.random((side, side)), rng.random(SHAPE)
    out, back = jax.vjp(blur._convolve, jnp.asarray(plane), jnp.asarray(psf))
    np.testing.assert_allclose(out, ndimage.convolve(plane, psf, mode="mirror"), atol=1e-11)
    to_plane, to_psf = back(jnp.asarray(cotangent))
    padded = np.pad(plane, side // 2, mode="reflect")
    want = signal.correlate(padded, cotangent, mode="valid", method="direct")[::-1, ::-1]
    np.testing.assert_allclose(to_psf, want, atol=1e-10)
    moved = rng.random(SHAPE)  # the adjoint: <g, A x> = <A' g, x>
    inner = np.sum(cotangent * ndimage.convolve(moved, psf, mode="mirror"))
    np.testing.assert_allclose(np.sum(to_plane * moved), inner, rtol=1e-12)


def test_motion_blur_draws_the_path_and_does_not_move_the_image():
    image = np.zeros((41, 45, 3), np.float32)
    image[20, 22] = 1
    lengths, directions = [6.0, 3.5, 2.0], [0.0, 90.0, -160.0]
    out = apply(blur.MotionBlur(lengths=lengths, directions=directions), image)
    drawn = out[8:33, 10:35, 1]
    np.testing.assert_allclose(drawn, path(lengths, directions), atol=1e-6)
    np.testing.assert_allclose(moments(drawn), [1, 0, 0], atol=1e-5)
    assert drawn[:12].sum() > 0.4, "to the right first, so most of it is above the centre of mass"


def test_no_motion_is_the_identity():
    image = 4 * picture() - 1
    np.testing.assert_array_equal(apply(blur.MotionBlur(), image), image)


def test_motion_blur_without_boost_is_linear():
    image = 4 * picture() - 1
    params = blur.MotionBlur(lengths=[2.0, 5.0, 1.0], directions=[30.0, 100.0, 10.0], threshold=0.5)
    want = ndimage.convolve(
        image.astype(float), path([2.0, 5.0, 1.0], [30.0, 100.0, 10.0])[..., None], mode="mirror"
    )
    out = apply(params, image)
    np.testing.assert_allclose(out, want, atol=3e-6)
    assert out.max() > 1


def test_highlights_draw_bright_streaks():
    image = 0.5 * picture()
    image[9, 12] = 1.0
    lengths, directions = [6.0, 3.0, 0.0], [25.0, 80.0, 0.0]
    out = apply(blur.MotionBlur(lengths=lengths, directions=directions, threshold=0.9, boost=4.0), image)
    boosted = image.astype(float)
    boosted[9, 12] *= 5
    psf = path(lengths, directions)[..., None]
    want = ndimage.convolve(boosted, psf, mode="mirror")
    np.testing.assert_allclose(out, np.minimum(want, 1), atol=2e-6)
    plain = ndimage.convolve(image.astype(float), psf, mode="mirror")
    assert (out - plain)[8:11, 10:15].max() > 0.2
    white = apply(blur.MotionBlur(lengths=lengths, directions=directions, threshold=0.2, boost=100.0), image)
    assert white.max() == 1


def test_threshold_has_a_surrogate_gradient():
    """A higher threshold gives less light: the hard gate alone would have no slope."""
    image = 0.9 * picture()

    def light(threshold):
        params = blur.MotionBlur(threshold=threshold, boost=jnp.float32(0.01))
        return jnp.sum(blur.motion_blur(params, image))

    assert jax.jit(jax.grad(light))(jnp.float32(0.6)) < -0.01


def test_lengths_need_as_many_directions():
    params = blur.MotionBlur(lengths=np.ones(2, np.float32))
    with pytest.raises(TypeError, match=r"\(2,\) lengths but \(3,\) directions"):
        stage("motion_blur")({"motion_blur": params}, picture())


@pytest.mark.parametrize("along", range(len(STEPS)))
@pytest.mark.parametrize("length", [0.0, 2.5, 7.0])
def test_directional_blur_against_scipy(along, length, x64):
    (dy, dx), image = STEPS[along], picture(dtype=np.float64)
    share = np.clip(length / np.hypot(dy, dx) / 2 + 0.5 - np.abs(np.arange(-6, 7)), 0, 1)
    kernel = np.zeros((13, 13))
    for k, weight in zip(range(-6, 7), share / share.sum()):
        kernel[6 + k * dy, 6 + k * dx] = weight
    want = np.stack([ndimage.correlate(p, kernel, mode="mirror") for p in np.moveaxis(image, -1, 0)], -1)
    got = apply(DirectionalBlur(lengths=np.eye(len(STEPS))[along] * length), image)
    np.testing.assert_allclose(got, want, atol=1e-12)
