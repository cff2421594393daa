"""Recipes of the literature against their formulas in float64 NumPy and SciPy, and their tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage, stats

import jaxisp
from jaxisp.errors import InputError
from jaxisp.pipeline import Chain, run, stage
from jaxisp.published import LOW_LIGHT, PUBLISHED, bsrgan, cbdnet, darmstadt, low_light, rsblur, unprocessing
from jaxisp.recipe import Recipe, check_photographs, check_traces
from jaxisp.stages.blur import AnisotropicBlur, IsotropicBlur
from jaxisp.stages.noise import LowLightNoise, ShotReadLaw
from jaxisp.testing import smooth_image
from jaxisp.unprocess import CameraColors, Unprocessed

KEY = jax.random.key(5)


def float32(kind, **values):
    return kind(**{name: np.asarray(value, np.float32) for name, value in values.items()})


@pytest.mark.parametrize("name", PUBLISHED)
def test_each_is_a_recipe_for_photographs_and_reads_back(name):
    recipe = PUBLISHED[name]()
    assert recipe.name == name
    check_photographs(recipe)
    check_traces(recipe)
    assert Recipe.from_toml(recipe.to_toml()) == recipe


def test_they_are_found_where_the_other_recipes_are():
    for make in (bsrgan, cbdnet, darmstadt, low_light, rsblur, unprocessing):
        assert getattr(jaxisp.recipes, make.__name__) is make


def unprocessed(image, weights, red, blue, dimming, preserve=True):
    """Brooks et al. 2019, sections 3.2 to 3.5: RGB to what the sensor sees, and the matrix."""
    each = np.array(
        [
            [[1.0234, -0.2969, -0.2266], [-0.5625, 1.6328, -0.0469], [-0.0703, 0.2188, 0.6406]],
            [[0.4913, -0.0541, -0.0202], [-0.613, 1.3513, 0.2906], [-0.1564, 0.2151, 0.7183]],
            [[0.838, -0.263, -0.0639], [-0.2887, 1.0725, 0.2496], [-0.0627, 0.1427, 0.5438]],
            [[0.6596, -0.2079, -0.0562], [-0.4782, 1.3016, 0.1933], [-0.097, 0.1581, 0.5181]],
        ]
    )
    rgb_to_xyz = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.072175],
            [0.0193339, 0.119192, 0.9503041],
        ]
    )
    matrix = np.average(each, 0, weights) @ rgb_to_xyz
    matrix /= matrix.sum(1, keepdims=True)
    camera = image @ matrix.T
    gains = np.array([1 / red, 1, 1 / blue]) * dimming
    grey = camera.mean(-1, keepdims=True)
    mask = (np.maximum(grey - 0.9, 0) / 0.1) ** 2 if preserve else 0.0
    return np.clip(camera * np.maximum(mask + (1 - mask) * gains, gains), 0, 1), gains, matrix


@pytest.mark.parametrize("preserve", [True, False])
def test_unprocessing_is_the_published_formula(preserve):
    """Without noise: tone, gamma, matrix, gains, mosaic; gains, the reference's demosaicking, matrix."""
    bayer = pytest.importorskip("colour_demosaicing")
    image = smooth_image((32, 40, 3), 3)
    image[8:20, 8:30] = 0.96 + 0.04 * image[8:20, 8:30]  # highlights
    weights, red, blue, dimming = (0.2, 0.9, 0.4, 0.7), 2.3, 1.6, 0.7
    node = Unprocessed(
        Chain((stage("mosaic", cfa="RGGB"), stage("demosaic_bilinear", cfa="RGGB")), "sensor"),
        preserve=preserve,
    )
    chain = Chain((stage("inverse_smoothstep"), stage("gamma22_eotf"), node), "unprocessing")
    colors = float32(CameraColors, weights=weights, red=red, blue=blue, dimming=dimming)
    got = run(chain, {"unprocessed": colors}, jnp.asarray(image, jnp.float32))

    tone = 0.5 - np.sin(np.arcsin(1 - 2 * np.clip(image.astype(float), 0, 1)) / 3)
    seen, gains, matrix = unprocessed(np.maximum(tone, 1e-8) ** 2.2, weights, red, blue, dimming, preserve)
    mosaic = bayer.mosaicing_CFA_Bayer(np.clip(seen / gains, 0, 1), "RGGB")
    want = bayer.demosaicing_CFA_Bayer_bilinear(mosaic, "RGGB") @ np.linalg.inv(matrix).T
    inner = slice(2, -2)
    np.testing.assert_allclose(np.asarray(got)[inner, inner], want[inner, inner], atol=3e-5)


def test_the_tone_curves_undo_each_other():
    x = np.linspace(0, 1, 300, dtype=np.float32).reshape(10, 10, 3)
    both = Chain((stage("inverse_smoothstep"), stage("smoothstep")), "both")
    np.testing.assert_allclose(run(both, {}, x), x, atol=1e-6)
    np.testing.assert_allclose(run(stage("smoothstep"), {}, x), 3 * x**2 - 2 * x**3, atol=1e-6)


def test_the_noise_law_is_the_published_one():
    """With one key the noise of any two settings differs by the ratio of standard deviations alone."""
    image = smooth_image((40, 56), 1)
    settings = [(1e-4, 0.0), (0.012, 0.3), (1e-3, -0.5)]
    drawn = []
    for shot, deviation in settings:
        params = float32(ShotReadLaw, shot=shot, slope=2.18, intercept=1.2, deviation=deviation)
        y = run(stage("shot_read_law"), {"shot_read_law": params}, image, KEY)
        variance = shot * image.astype(float) + np.exp(2.18 * np.log(shot) + 1.2 + deviation)
        drawn.append((np.asarray(y, float) - image) / np.sqrt(variance))
    scale = np.abs(drawn[1]).max()
    np.testing.assert_allclose(drawn[1], drawn[2], atol=1e-4 * scale)
    np.testing.assert_allclose(drawn[1], drawn[0], atol=2e-3 * scale)  # 1e-4 is near what float32 resolves
    assert stats.kstest(drawn[1].ravel(), "norm").pvalue > 1e-3


def test_its_parameters_follow_the_published_laws():
    recipe = unprocessing()
    params = jax.jit(jax.vmap(recipe.draw))(jax.random.split(KEY, 4000))
    law, colors = params["shot_read_law"], params["unprocessed"]
    for values, distribution in (
        (np.log(law.shot), stats.uniform(np.log(1e-4), np.log(0.012 / 1e-4))),
        (law.deviation, stats.norm(0, 0.26)),
        (colors.dimming, stats.norm(0.8, 0.1)),
        (colors.red, stats.uniform(1.9, 0.5)),
        (colors.blue, stats.uniform(1.5, 0.4)),
    ):
        assert stats.kstest(np.asarray(values, float), distribution.cdf).pvalue > 1e-3
    assert (float(law.slope[0]), float(law.intercept[0])) == pytest.approx((2.18, 1.2))


@pytest.mark.parametrize(("gain", "level"), [(0.2, 0.3), (6.0, 0.8), (6.0, 0.02)])
def test_low_light_noise_has_the_published_moments(gain, level):
    shape, ratio, white = 0.1, 100.0, 15871.0
    read, row = np.exp(0.7 * np.log(gain) + 0.5), np.exp(0.6 * np.log(gain) - 0.5)
    params = float32(
        LowLightNoise, gain=gain, read_slope=0.7, read_intercept=0.4, read_deviation=0.1, read_shape=shape,
        row_slope=0.6, row_intercept=-0.4, row_deviation=-0.1, ratio=ratio, white=white,
    )  # fmt: skip
    image = np.full((320, 320), level, np.float32)
    out = np.asarray(run(stage("low_light_noise"), {"low_light_noise": params}, image, KEY), float)
    noise = (out - level) * white / ratio
    pixels = gain * level * white / ratio + read**2 * stats.tukeylambda.var(shape) + 1 / 12
    left = noise - noise.mean(1, keepdims=True)
    assert left.var() * 320 / 319 == pytest.approx(pixels, rel=0.03)
    assert noise.mean(1).var() == pytest.approx(row**2 + pixels / 320, rel=0.3)
    assert abs(noise.mean()) < 5 * np.sqrt(row**2 / 320 + pixels / 320**2)


@pytest.mark.parametrize("shape", [-0.2, 0.0, 0.14])
def test_read_noise_in_low_light_is_tukeys_lambda(shape):
    params = float32(
        LowLightNoise, gain=1.0, read_intercept=3.0, read_shape=shape, row_intercept=-4.0, ratio=100.0,
        white=15871.0,
    )  # fmt: skip
    dark = np.zeros((64, 64), np.float32)
    noise = np.asarray(run(stage("low_light_noise"), {"low_light_noise": params}, dark, KEY), float)
    drawn = (noise * 158.71 / np.exp(3.0)).ravel()
    assert stats.kstest(drawn, lambda x: stats.tukeylambda.cdf(x, shape)).pvalue > 1e-3


@pytest.mark.parametrize("name", LOW_LIGHT)
def test_low_light_draws_on_the_published_lines(name):
    """log s = a log K + b + N(0, sigma), as the calibrations state it; K log-uniform."""
    (low, high), read, row, shapes, white = LOW_LIGHT[name]
    found = jax.jit(jax.vmap(low_light(name).draw))(jax.random.split(KEY, 3000))["low_light_noise"]
    log_gain = np.log(np.asarray(found.gain, float))
    assert stats.kstest(log_gain, stats.uniform(np.log(low), np.log(high / low)).cdf).pvalue > 1e-3
    for (slope, intercept, sigma), part in ((read, "read"), (row, "row")):
        a, b, d = (
            np.asarray(getattr(found, f"{part}_{n}"), float) for n in ("slope", "intercept", "deviation")
        )
        log_scale = a * log_gain + b + d
        fit = stats.linregress(log_gain, log_scale)
        assert fit.slope == pytest.approx(slope, abs=5 * fit.stderr)
        assert (log_scale - slope * log_gain - intercept).std() == pytest.approx(sigma, rel=0.06)
    assert set(np.round(np.asarray(found.read_shape, float), 5)) <= set(np.round(shapes, 5))
    assert float(found.white[0]) == white and found.ratio.min() >= 100 and found.ratio.max() <= 300


def test_tables_of_published_numbers():
    noise = cbdnet().prior["shot_read_noise"]
    assert noise.shot.support == pytest.approx((0, 0.16**2)) and noise.read.support == (0, 0.06)
    assert cbdnet().prior["jpeg"].quality.support == (60, 100)
    blurred = rsblur().prior
    assert blurred["motion_blur"].boost.support == (0.25, 1.75)
    assert blurred["shot_read_noise"].shot == pytest.approx(8.8915e-05)
    assert blurred["shot_read_noise"].read ** 2 == pytest.approx(2.9430e-05)
    own = PUBLISHED["bsrgan"]().prior
    assert own["gaussian_noise"].std.support == pytest.approx((1 / 255, 25 / 255))
    assert own["isotropic_blur"].sigma.support == (0.1, 2.8)
    assert own["anisotropic_blur"].along.support == (0.5, 8)
    assert own["jpeg"].quality.support == (30, 95) and own["use_camera"].on.p == 0.25


def test_blurs_of_encoded_pictures_are_gaussians():
    image = smooth_image((40, 48, 3), 2)
    got = run(stage("isotropic_blur", radius=8), {"isotropic_blur": float32(IsotropicBlur, sigma=1.7)}, image)
    want = ndimage.gaussian_filter(image.astype(float), (1.7, 1.7, 0), mode="mirror", radius=(8, 8, 0))
    np.testing.assert_allclose(got, want, atol=2e-6)
    along, across, angle = 3.0, 0.8, 30.0
    params = float32(AnisotropicBlur, along=along, across=across, angle=angle)
    got = run(stage("anisotropic_blur"), {"anisotropic_blur": params}, image)
    y, x = np.mgrid[-10:11, -10:11].astype(float)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.array([[c, -s], [s, c]])
    inverse = np.linalg.inv(turn @ np.diag([along**2, across**2]) @ turn.T)  # of (x, y)
    place = np.stack([x, y], -1)
    kernel = np.exp(-0.5 * np.einsum("ijk,kl,ijl->ij", place, inverse, place))
    want = ndimage.convolve(image.astype(float), (kernel / kernel.sum())[..., None], mode="mirror")
    np.testing.assert_allclose(got, want, atol=2e-6)


def test_unprocessed_refuses_what_has_no_mosaic():
    with pytest.raises(TypeError, match="from a mosaic"):
        Unprocessed(Chain((stage("clip"),), "none"))
    text = unprocessing().to_toml().replace("[stages.unprocessed]", "[stages.unprocessed]")
    with pytest.raises(InputError, match="preserve"):
        Recipe.from_toml(
            text.replace('name = "unprocessed"', 'name = "unprocessed"\noptions = { preserve = 3 }')
        )
