"""Optics against SciPy, OpenCV and closed forms."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, ndimage, signal

from jaxisp.pipeline import run, stage
from jaxisp.stages import blur, optics
from jaxisp.stages.optics import displacement
from tests.conftest import smooth_image

H, W = SHAPE = (21, 34)
CENTRE = np.array([(H - 1) / 2, (W - 1) / 2])


def picture(seed: int = 0, dtype=np.float32, shape=SHAPE) -> np.ndarray:
    return smooth_image((*shape, 3), seed).astype(dtype)


def apply(params, image, **static) -> np.ndarray:
    """Run the stage that takes these parameters."""
    names = {
        optics.Exposure: "exposure",
        optics.AffineExposure: "affine_exposure",
        optics.LateralChromaticAberration: "lateral_chromatic_aberration",
        optics.GeometricDistortion: "geometric_distortion",
        optics.RadialWarp: "radial_warp",
        optics.ColorMagnification: "color_magnification",
        optics.Vignetting: "vignetting",
        optics.ColorShading: "color_shading",
        optics.VeilingGlare: "veiling_glare",
        blur.OpticalBlur: "optical_blur",
        blur.Defocus: "defocus",
        blur.MotionBlur: "motion_blur",
    }
    s = stage(names[type(params)], **static)
    return np.asarray(run(s, {s.name: jax.tree.map(lambda v: np.asarray(v, image.dtype), params)}, image))


def offsets() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:H, :W].astype(float)
    return y - CENTRE[0], x - CENTRE[1]


def squared_radius() -> np.ndarray:
    y, x = offsets()
    return (y**2 + x**2) / (CENTRE**2).sum()


def sampled(plane, dy, dx) -> np.ndarray:
    """SciPy's bilinear samples around the centre, borders replicated."""
    return ndimage.map_coordinates(plane, [dy + CENTRE[0], dx + CENTRE[1]], order=1, mode="nearest")


# ---- gains


@pytest.mark.parametrize("ev", [-8.0, -1.5, 1.0, 8.0])
def test_exposure_is_a_power_of_two(ev):
    image = 4 * picture() - 1
    np.testing.assert_allclose(apply(optics.Exposure(exposure_ev=ev), image), image * 2.0**ev, rtol=2e-6)
    np.testing.assert_array_equal(apply(optics.Exposure(), image), image)


def test_affine_exposure():
    image = 4 * picture() - 1
    out = apply(optics.AffineExposure(gain=1.7, offset=-0.2), image)
    np.testing.assert_allclose(out, 1.7 * image.astype(float) - 0.2, atol=1e-6)
    np.testing.assert_array_equal(apply(optics.AffineExposure(), image), image)


def test_vignetting_gain():
    a2, a4, a6 = -1.2, 0.7, -0.9
    gain = apply(optics.Vignetting(a2=a2, a4=a4, a6=a6), np.ones((H, W, 3), np.float32))
    r2 = squared_radius()
    np.testing.assert_allclose(gain[..., 1], 2 ** (a2 * r2 + a4 * r2**2 + a6 * r2**3), rtol=1e-6)
    np.testing.assert_allclose(gain[[0, 0, -1, -1], [0, -1, 0, -1]], 2 ** (a2 + a4 + a6), rtol=1e-6)
    assert (gain == gain[..., :1]).all()


def test_vignetting_of_an_ideal_lens():
    """Two even powers of r follow the cos**4 law of a 90 degree field to 1.2 %."""
    cosine = 1 / np.sqrt(1 + squared_radius())
    gain = apply(optics.Vignetting(a2=-2.72, a4=0.73), np.ones((H, W, 3), np.float32))
    np.testing.assert_allclose(gain[..., 0], cosine**4, rtol=0.012)


def test_opposite_vignetting_corrects():
    image = 4 * picture() - 1
    there = apply(optics.Vignetting(a2=-2.0, a4=1.0, a6=-1.5), image)
    back = apply(optics.Vignetting(a2=2.0, a4=-1.0, a6=1.5), there)
    np.testing.assert_allclose(back, image, atol=2e-6)
    np.testing.assert_array_equal(apply(optics.Vignetting(), image), image)


def test_color_shading_is_vignetting_of_red_and_blue():
    image = picture()
    out = apply(optics.ColorShading(red_a2=0.5, red_a4=-0.9, blue_a2=-0.4, blue_a4=1.1), image)
    np.testing.assert_allclose(
        out[..., 0], apply(optics.Vignetting(a2=0.5, a4=-0.9), image)[..., 0], rtol=1e-6
    )
    np.testing.assert_array_equal(out[..., 1], image[..., 1])
    np.testing.assert_allclose(
        out[..., 2], apply(optics.Vignetting(a2=-0.4, a4=1.1), image)[..., 2], rtol=1e-6
    )


def test_veiling_glare_keeps_the_mean_and_lifts_blacks():
    image = picture()
    image[3, 4] = 0
    out = apply(optics.VeilingGlare(share=0.1), image)
    np.testing.assert_allclose(out.mean((0, 1)), image.mean((0, 1)), rtol=1e-6)
    np.testing.assert_allclose(out[3, 4], 0.1 * image.mean((0, 1), dtype=float), rtol=1e-6)
    np.testing.assert_allclose(out, 0.9 * image + 0.1 * image.mean((0, 1)), atol=1e-6)
    np.testing.assert_array_equal(apply(optics.VeilingGlare(), image), image)


# ---- geometry


@pytest.mark.parametrize("shifts", [displacement._MOST_SHIFTS, -1])
@pytest.mark.parametrize(
    ("red", "blue", "most"), [(0.99, 1.01, 0.01), (1.004, 0.994, 0.01), (1.03, 0.97, 0.03)]
)
def test_lateral_chromatic_aberration(red, blue, most, shifts, monkeypatch, x64):
    """Both forms, shifted views and gathers, on an image large enough to move by more than a pixel."""
    monkeypatch.setattr(displacement, "_MOST_SHIFTS", shifts)
    image = picture(dtype=float, shape=(53, 260))
    params = optics.LateralChromaticAberration(red_scale=red, blue_scale=blue)
    out = jax.jit(optics.lateral_chromatic_aberration, static_argnames="most")(params, image, most=most)
    y, x = np.mgrid[:53, :260].astype(float)
    for channel, scale in ((0, red), (2, blue)):
        places = [26 + (y - 26) / scale, 129.5 + (x - 129.5) / scale]
        want = ndimage.map_coordinates(image[..., channel], places, order=1, mode="nearest")
        np.testing.assert_allclose(out[..., channel], want, atol=1e-12)
    np.testing.assert_array_equal(out[..., 1], image[..., 1])


def test_a_scale_above_one_magnifies():
    image = np.zeros((H, 201, 3), np.float32)
    image[10, [20, 180]] = 1  # 80 px to both sides of the centre
    out = apply(optics.LateralChromaticAberration(red_scale=1.006, blue_scale=0.995), image)
    columns = np.arange(201) - 100
    right = out[..., 101:, :].sum(0) / out[..., 101:, :].sum((0, 1))
    np.testing.assert_allclose(columns[101:] @ right, [80 * 1.006, 80, 80 * 0.995], atol=0.02)


def test_no_scaling_is_the_identity_with_a_central_gradient(x64):
    image = picture(dtype=float)
    weights = np.zeros((H, W))
    weights[2:-2, 2:-2] = np.random.default_rng(1).standard_normal((H - 4, W - 4))

    def loss(scale):
        params = optics.LateralChromaticAberration(red_scale=scale, blue_scale=jnp.ones(()))
        out = optics.lateral_chromatic_aberration(params, jnp.asarray(image))
        return jnp.sum(out[..., 0] * weights), out

    got, out = jax.jit(jax.grad(loss, has_aux=True))(1.0)
    np.testing.assert_array_equal(out, image)
    slope_y, slope_x = np.gradient(image[..., 0])
    y, x = offsets()
    np.testing.assert_allclose(got, -np.sum(weights * (y * slope_y + x * slope_x)), rtol=1e-10)


@pytest.mark.parametrize(("k1", "k2"), [(0.2, 0.07), (-0.2, -0.07), (0.11, -0.03)])
def test_geometric_distortion_is_brown_s_model(k1, k2, x64):
    """OpenCV gives the map (its focal length is half the diagonal), SciPy the samples."""
    image = picture(dtype=float)
    focal = np.hypot(*CENTRE)
    camera = np.array([[focal, 0, CENTRE[1]], [0, focal, CENTRE[0]], [0, 0, 1]])
    lens = np.array([k1, k2, 0, 0])
    x, y = cv2.initUndistortRectifyMap(camera, lens, None, camera, (W, H), cv2.CV_32FC1)
    out = apply(optics.GeometricDistortion(k1=k1, k2=k2), image)
    for channel in range(3):
        want = ndimage.map_coordinates(image[..., channel], [y, x], order=1, mode="nearest")
        np.testing.assert_allclose(out[..., channel], want, atol=3e-6)  # OpenCV's map is float32
    factor = 1 + k1 * squared_radius() + k2 * squared_radius() ** 2
    dy, dx = offsets()
    np.testing.assert_allclose(out[..., 0], sampled(image[..., 0], dy * factor, dx * factor), atol=1e-12)


def test_no_distortion_is_the_identity():
    image = 4 * picture() - 1
    np.testing.assert_array_equal(apply(optics.GeometricDistortion(), image), image)


@pytest.mark.parametrize("shape", [(23, 31, 3), (23, 401, 3), (1, 9, 3), (9, 1, 3)])
@pytest.mark.parametrize(
    "name", ["geometric_distortion", "lateral_chromatic_aberration", "radial_warp", "color_magnification"]
)
def test_the_gradient_of_displacement_is_the_transpose_of_its_tangent(name, shape, monkeypatch, x64):
    """Forward and reverse mode are written separately; these few pixels are large enough for strips here."""
    monkeypatch.setattr(displacement, "_STRIP", 5 * shape[1])
    monkeypatch.setattr(displacement, "_MOST_SHIFTS", 1)  # the wide image is sampled, the others shifted
    node = stage(name)
    params = jax.tree.map(lambda v: jnp.asarray(v, float) + 0.0071, node.init())
    image, change, weights = np.random.default_rng(0).random((3, *shape))
    moved = jax.tree.map(lambda v: jnp.full_like(v, 0.5), params)
    _, tangent = jax.jvp(lambda p, x: node(p, x), (params, image), (moved, change))
    by_params, by_image = jax.vjp(lambda p, x: node(p, x), params, image)[1](jnp.asarray(weights))
    backward = sum(0.5 * v for v in jax.tree.leaves(by_params)) + jnp.sum(by_image * change)
    np.testing.assert_allclose(jnp.sum(tangent * weights), backward, rtol=1e-9)


def weights(places, count, sharpness):
    """(..., count) what each pixel counts at these places: the tent, and Keys' (1981) eq. 15 in its stead."""
    t = np.abs(places[..., None] - np.arange(count))
    tent = np.maximum(1 - t, 0)
    far = -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    return (1 - sharpness) * tent + sharpness * np.where(
        t < 1, 1.5 * t**3 - 2.5 * t**2 + 1, np.where(t < 2, far, 0)
    )


@pytest.mark.parametrize("sharpness", [0.4, 1.0, 2.0])
def test_radial_warp_reads_by_cubic_convolution(sharpness, x64):
    image = picture(dtype=float)
    out = apply(optics.RadialWarp(k1=-0.11, sharpness=sharpness), image)
    places = [c + d * (1 - 0.11 * squared_radius()) for c, d in zip(CENTRE, offsets())]
    down, across = (weights(p, n, sharpness) for p, n in zip(places, (H, W)))
    want = np.einsum("hwa,hwb,abc->hwc", down, across, image)
    np.testing.assert_allclose(out[3:-3, 3:-3], want[3:-3, 3:-3], atol=1e-12)


@pytest.mark.parametrize(("red", "blue"), [(0.975, 1.0), (1.01, 0.99)])
def test_color_magnification_reads_by_cubic_convolution(red, blue, x64):
    """`jax.image` has the same kernel; at borders it weighs what is there."""
    image = picture(dtype=float)
    out = apply(optics.ColorMagnification(red_scale=red, blue_scale=blue), image)
    for channel, scale in enumerate((red, 1.0, blue)):
        shift = (1 - scale) * (np.array(CENTRE) + 0.5)
        plain = jnp.asarray(image[..., channel])
        want = jax.image.scale_and_translate(
            plain, (H, W), (0, 1), jnp.full(2, scale), jnp.asarray(shift), "cubic", antialias=False
        )
        np.testing.assert_allclose(out[3:-3, 3:-3, channel], want[3:-3, 3:-3], atol=1e-9)


@pytest.mark.parametrize("params", [optics.RadialWarp(), optics.ColorMagnification()])
def test_a_warp_that_moves_nothing_is_the_identity(params):
    image = 4 * picture() - 1
    np.testing.assert_array_equal(apply(params, image), image)


def test_without_sharpness_warps_are_those_of_a_lens():
    image = picture()
    warp, lens = optics.RadialWarp(k1=0.1, sharpness=0.0), optics.GeometricDistortion(k1=0.1)
    np.testing.assert_allclose(apply(warp, image), apply(lens, image), atol=1e-6)
    scales = {"red_scale": 0.992, "blue_scale": 1.004}
    warp = optics.ColorMagnification(**scales, sharpness=0.0)
    np.testing.assert_allclose(
        apply(warp, image), apply(optics.LateralChromaticAberration(**scales), image), atol=1e-6
    )


@pytest.mark.parametrize("k1", [-0.2, 0.2])
def test_distortion_never_folds(k1):
    """At the bounds the sampled radius still grows outwards."""
    ramp = np.abs(offsets()[1]).astype(np.float32)
    out = apply(optics.GeometricDistortion(k1=k1, k2=np.sign(k1) * 0.07), np.stack([ramp] * 3, -1))
    assert (np.diff(out[H // 2, W // 2 :, 0]) > (0 if k1 < 0 else -1e-6)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (2, 2)])
def test_geometry_of_tiny_images(shape):
    image = picture(shape=shape)
    for params in (
        optics.GeometricDistortion(k1=0.2, k2=-0.07),
        optics.LateralChromaticAberration(red_scale=1.01, blue_scale=0.99),
        optics.RadialWarp(k1=0.2, sharpness=0.0),
        optics.ColorMagnification(red_scale=1.03, sharpness=0.0),
        optics.Vignetting(a2=-1.0),
    ):
        out = apply(params, image)
        assert out.shape == image.shape
        assert np.isfinite(out).all()
        assert out.min() >= 0.4 * image.min()
        assert out.max() <= image.max() + 1e-6


# ---- blurs


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
