"""Stages that move pixels, against OpenCV's map, SciPy's samples and cubic convolution."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxisp.pipeline import stage
from jaxisp.stages import optics
from jaxisp.stages.optics import displacement
from tests.gradients import both_modes

from .lens import CENTRE, H, W, apply, offsets, picture, squared_radius


def sampled(plane, dy, dx) -> np.ndarray:
    """SciPy's bilinear samples around the centre, borders replicated."""
    return ndimage.map_coordinates(plane, [dy + CENTRE[0], dx + CENTRE[1]], order=1, mode="nearest")


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


@pytest.mark.parametrize("shifts", [displacement._MOST_SHIFTS, -1])
@pytest.mark.parametrize("scale", [0.96, 0.97, 0.9999, 1.03, 1.04])
def test_the_gradient_to_the_image_is_the_transpose_at_the_bounds_too(scale, shifts, monkeypatch, rng, x64):
    """Where most pixels are taken by the fewest and the most others; beyond, both forms stay at the bound."""
    monkeypatch.setattr(displacement, "_MOST_SHIFTS", shifts)
    plane, weights = rng.random((2, 43, 260))
    magnified, pull = jax.vjp(jax.jit(lambda x: displacement._magnified(x, scale, 0.03)), plane)
    np.testing.assert_allclose(np.sum(magnified * weights), np.sum(plane * pull(weights)[0]), rtol=1e-12)


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
    "name",
    [
        "geometric_distortion",
        "lateral_chromatic_aberration",
        "radial_warp",
        "rectilinear_warp",
        "color_magnification",
    ],
)
def test_the_gradient_of_displacement_is_the_transpose_of_its_tangent(name, shape, monkeypatch, x64):
    """Forward and reverse mode are written separately; these few pixels are large enough for strips here."""
    monkeypatch.setattr(displacement, "_STRIP", 5 * shape[1])
    monkeypatch.setattr(displacement, "_MOST_SHIFTS", 1)  # the wide image is sampled, the others shifted
    node = stage(name)
    params = jax.tree.map(lambda v: jnp.asarray(v, float) + 0.0071, node.init())
    image, change, weights = np.random.default_rng(0).random((3, *shape))
    moved = jax.tree.map(lambda v: jnp.full_like(v, 0.5), params)

    @jax.jit
    def both_ways(given, turn, weights):
        return both_modes(lambda p, x: node(p, x), given, turn, weights)

    _, tangent, (by_params, by_image) = both_ways((params, image), (moved, change), weights)
    backward = sum(0.5 * jnp.sum(v) for v in jax.tree.leaves(by_params)) + jnp.sum(by_image * change)
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
    out = apply(optics.RadialWarp(k1=-0.11, k0=0.03, k2=0.02, sharpness=sharpness), image)
    factor = np.polynomial.Polynomial([1.03, -0.11, 0.02])(squared_radius())
    places = [c + d * factor for c, d in zip(CENTRE, offsets())]
    down, across = (weights(p, n, sharpness) for p, n in zip(places, (H, W)))
    want = np.einsum("hwa,hwb,abc->hwc", down, across, image)
    np.testing.assert_allclose(out[3:-3, 3:-3], want[3:-3, 3:-3], atol=1e-12)


RADIAL = np.array([[0.02, -0.11, 0.03, 0.01], [0.0, -0.08, 0.02, 0.0], [-0.01, -0.05, 0.0, 0.02]])
TANGENTIAL = np.array([[0.02, -0.03], [0.0, 0.01], [-0.02, 0.02]])


def corrected_places(y, x, row, column, reach, channel):
    """Where the DNG specification (1.4, WarpRectilinear) has a pixel come from, by complex numbers: with
    d = (u + i v) and t = t1 + i t0 the tangential part is |d|^2 t + 2 d Re(d conj(t))."""
    d, t = ((x - column) + 1j * (y - row)) / reach, complex(TANGENTIAL[channel, 1], TANGENTIAL[channel, 0])
    squared = np.abs(d) ** 2
    radial = 1 + np.polynomial.Polynomial(RADIAL[channel])(squared)
    found = radial * d + squared * t + 2 * d * (d * np.conj(t)).real
    return row + reach * found.imag, column + reach * found.real


@pytest.mark.parametrize("sharpness", [0.0, 1.0])
def test_rectilinear_warp_follows_the_dng_specification(sharpness, x64):
    image = picture(dtype=float)
    centre, farthest = np.array([0.4, 0.55]), 1.3
    params = optics.RectilinearWarp(
        radial=RADIAL, tangential=TANGENTIAL, centre=centre, farthest=farthest, sharpness=sharpness
    )
    out = apply(params, image)
    row, column = centre * (H - 1, W - 1)
    y, x = np.mgrid[:H, :W].astype(float)
    for channel in range(3):
        places = corrected_places(y, x, row, column, farthest * np.hypot(H - 1, W - 1) / 2, channel)
        inside = (
            np.abs(np.subtract(places, np.array(CENTRE)[:, None, None])) < [[[H / 2 - 3]], [[W / 2 - 3]]]
        ).all(0)
        down, across = (weights(p, n, sharpness) for p, n in zip(places, (H, W)))
        want = np.einsum("hwa,hwb,ab->hw", down, across, image[..., channel])
        assert inside.mean() > 0.4
        np.testing.assert_allclose(out[..., channel][inside], want[inside], atol=1e-12)


def test_a_part_of_a_frame_is_corrected_as_the_frame(x64):
    """Centre and reach are told from the part."""
    image = picture(dtype=float)
    polynomials = {"radial": 0.2 * RADIAL, "tangential": 0.2 * TANGENTIAL}
    part = image[4:, 6:-5]
    shares = (0.5 * np.subtract((H, W), 1) - (4, 6)) / np.subtract(part.shape[:2], 1)
    ratio = np.hypot(H - 1, W - 1) / np.hypot(*np.subtract(part.shape[:2], 1))
    whole = apply(optics.RectilinearWarp(**polynomials), image)[4:, 6:-5]
    own = apply(optics.RectilinearWarp(**polynomials, centre=shares, farthest=ratio), part)
    np.testing.assert_allclose(own[4:-4, 4:-4], whole[4:-4, 4:-4], atol=1e-12)


@pytest.mark.parametrize(("red", "blue"), [(0.975, 1.0), (1.01, 0.99)])
def test_color_magnification_reads_by_cubic_convolution(red, blue, x64):
    """`jax.image` has the same kernel; at borders it weighs what is there."""
    image = picture(dtype=float)

    @jax.jit
    def translated(plane, scales, shift):
        return jax.image.scale_and_translate(plane, (H, W), (0, 1), scales, shift, "cubic", antialias=False)

    out = apply(optics.ColorMagnification(red_scale=red, blue_scale=blue), image)
    for channel, scale in enumerate((red, 1.0, blue)):
        shift = (1 - scale) * (np.array(CENTRE) + 0.5)
        plain = jnp.asarray(image[..., channel])
        want = translated(plain, jnp.full(2, scale), jnp.asarray(shift))
        np.testing.assert_allclose(out[3:-3, 3:-3, channel], want[3:-3, 3:-3], atol=1e-9)


@pytest.mark.parametrize(
    "params", [optics.RadialWarp(), optics.RectilinearWarp(), optics.ColorMagnification()]
)
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
