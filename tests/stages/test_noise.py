"""Noise against its distributions: moments within 4 standard errors, SciPy's tests, closed forms."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
from scipy import special, stats

from jaxisp.pipeline import run, stage
from jaxisp.stages import noise
from jaxisp.stages.noise import light
from jaxisp.testing import smooth_image

SHAPE = (128, 257)
PIXELS = SHAPE[0] * SHAPE[1]
LEVELS = (-0.2, 0.0, 0.02, 0.18, 0.5, 1.0, 1.5)


def draw(name, image, seed=0, options=(), **values):
    """What the stage adds, in float64; compiled once per stage."""
    fn = getattr(noise, name)
    cls = fn.__annotations__["params"]
    params = cls(**{k: np.float32(v) for k, v in values.items()})
    out = run(stage(fn, **dict(options)), {name: params}, image, jax.random.key(seed))
    return np.asarray(out, np.float64) - np.asarray(image, np.float64)


def flat(level, shape=SHAPE):
    return np.full(shape, level, np.float32)


def check_moments(added, variance, fourth=None):
    """Mean 0 and the variance, each within 4 standard errors; `fourth` is the central moment."""
    fourth = 3 * variance**2 if fourth is None else fourth
    assert abs(added.mean()) < 4 * np.sqrt(variance / added.size)
    assert abs(added.var() - variance) < 4 * np.sqrt((fourth - variance**2) / added.size)


STRENGTHS = {
    "gaussian_noise": {"std": 0.0},
    "shot_read_noise": {"shot": 0.0, "read": 0.0},
    "row_noise": {"std": 0.0},
    "column_noise": {"std": 0.0},
    "prnu": {"std": 0.0},
    "correlated_noise": {"std": 0.0},
    "heavy_tailed_noise": {"std": 0.0},
    "film_grain": {"std": 0.0},
}


@pytest.mark.parametrize("name", STRENGTHS)
def test_no_strength_is_the_identity(name):
    image = (2 * smooth_image((21, 34, 3)) - 0.5).astype(np.float32)
    assert not draw(name, image, **STRENGTHS[name]).any()


def test_gaussian_noise_is_gaussian_and_white():
    image = smooth_image((*SHAPE, 3)).astype(np.float32)
    added = draw("gaussian_noise", image, std=0.1)
    check_moments(added, 0.01)
    assert stats.kstest(added.ravel() / 0.1, "norm").pvalue > 0.01
    assert np.abs(np.corrcoef(added.reshape(-1, 3).T) - np.eye(3)).max() < 4 / np.sqrt(PIXELS)
    assert abs(np.mean(added[:, 1:] * added[:, :-1])) < 4 * 0.01 / np.sqrt(added.size)


@pytest.mark.parametrize("name, first", [("shot_read_noise", "shot"), ("poisson_noise", "gain")])
@pytest.mark.parametrize("level", LEVELS)
def test_variance_is_affine_in_light(name, first, level):
    for scale, read in ((0.04, 0.02), (0.0004, 0.0)):
        added = draw(name, flat(level), **{first: scale, "read": read})
        light = max(level, 0.0)
        variance = scale * light + read**2
        if variance == 0:
            assert not added.any()
            continue
        poisson = scale**3 * light if name == "poisson_noise" else 0.0  # fourth cumulant
        check_moments(added, variance, 3 * variance**2 + poisson)


def test_noise_of_a_photograph_is_normalised_by_its_own_variance():
    image = smooth_image((*SHAPE, 3)).astype(np.float32)
    added = draw("shot_read_noise", image, shot=0.01, read=0.02)
    z = added / np.sqrt(0.01 * image.astype(np.float64) + 0.02**2)
    assert stats.kstest(z.ravel()[:100_000], "norm").pvalue > 0.01


@pytest.mark.parametrize("mean", [0.05, 0.7, 5.0, 15.9, 16.1, 60.0, 1500.0])
def test_counts_are_poisson(mean):
    gain = 2.0**-10
    counts = (draw("poisson_noise", flat(mean * gain), gain=gain, read=0) + np.float32(mean * gain)) / gain
    np.testing.assert_allclose(counts, np.round(counts), atol=2e-3)
    counts = np.round(counts).astype(int)
    assert counts.min() >= 0
    law = stats.poisson(mean)
    edges = np.unique(law.ppf(np.linspace(0.01, 0.99, 25)))  # bins up to each edge, and beyond the last
    observed = np.bincount(np.searchsorted(edges, counts.ravel()), minlength=len(edges) + 1)
    expected = np.diff([0.0, *law.cdf(edges), 1.0]) * PIXELS
    assert stats.chisquare(observed, expected).pvalue > 0.01


def test_summed_quantiles_are_scipys(x64):
    u = (np.arange(4001) + 0.5) / 4001
    summed = jax.jit(light._summed)
    for mean in (0.0, 0.01, 1.3, 8.0, 15.99):
        got = summed(jnp.asarray(u), jnp.full(u.shape, mean)) + mean
        np.testing.assert_array_equal(np.round(got), stats.poisson.ppf(u, mean) if mean else 0 * u)


def test_expanded_quantiles_have_the_right_distribution(x64):
    u = (np.arange(1_000_000) + 0.5) / 1_000_000
    expanded = jax.jit(light._expanded)
    for mean, bound in ((16.0, 2e-5), (16.7, 2e-5), (100.3, 2e-6), (1e4, 1.1e-6)):
        counts = np.round(np.asarray(expanded(2 * u - 1, np.full(u.shape, mean))) + mean)
        k, first = np.unique(counts, return_index=True)
        assert np.abs(first[1:] / u.size - stats.poisson.cdf(k[:-1], mean)).max() < bound + 1e-6
    tails = np.asarray(expanded(np.array([-1 + 1e-7, 1 - 1e-7]), np.full(2, 16.0))) + 16
    np.testing.assert_allclose(tails, stats.poisson.ppf([5e-8, 1 - 5e-8], 16), atol=1)


def test_poisson_takes_every_kind_of_key_and_any_light():
    params = noise.PoissonNoise()
    image = np.array([[-1e9, 0.0, 1e-30], [1.0, 1e6, 1e12]], np.float32)
    run = jax.jit(noise.poisson_noise)
    for kind in ("threefry2x32", "rbg", "unsafe_rbg"):
        out = run(params, image, key=jax.random.key(0, impl=kind))
        assert np.isfinite(out).all()
    np.testing.assert_allclose(out[1, 1:], image[1, 1:], rtol=1e-3)


def test_poisson_gradient_is_the_declared_surrogate(x64):
    image, key = smooth_image((21, 34)), jax.random.key(0)

    def loss(params, x):
        noisy = noise.poisson_noise(params, x, key=key)
        return jnp.sum(noisy**2), noisy

    gain, read = 0.01, 0.02
    params = noise.PoissonNoise(gain=jnp.asarray(gain), read=jnp.asarray(read))
    quiet = noise.PoissonNoise(gain=jnp.asarray(gain), read=jnp.asarray(0.0))
    both = jax.jit(jax.grad(loss, (0, 1), has_aux=True))
    (to_params, to_image), noisy = both(params, image)
    noisy, counted = np.asarray(noisy), np.asarray(both(quiet, image)[1])
    np.testing.assert_allclose(to_image, 2 * noisy, rtol=1e-9)
    np.testing.assert_allclose(to_params.gain, np.sum(2 * noisy * (counted - image)) / (2 * gain), rtol=1e-7)
    np.testing.assert_allclose(to_params.read, np.sum(2 * noisy * (noisy - counted)) / read, rtol=1e-7)


def test_gradient_of_the_variance_agrees_with_its_formula():
    """Fitting by gradient: d E[(y - x)**2] / d gain = x, though counts have no derivative."""
    image = flat(0.3)

    def power(params):
        return jnp.mean((noise.poisson_noise(params, image, key=jax.random.key(0)) - image) ** 2)

    grads = jax.jit(jax.grad(power))(noise.PoissonNoise(gain=np.float32(0.01), read=np.float32(0.02)))
    np.testing.assert_allclose(grads.gain, 0.3, rtol=0.04)
    np.testing.assert_allclose(grads.read, 0.04, rtol=0.04)


@pytest.mark.parametrize("name, axis", [("row_noise", 1), ("column_noise", 0)])
def test_rows_and_columns_share_an_offset(name, axis):
    image = smooth_image((640, 641, 3)).astype(np.float32)
    added = draw(name, image, std=0.05)
    offsets = np.moveaxis(added, axis, 0)
    np.testing.assert_allclose(offsets - offsets[0, :, :1], 0, atol=2e-7)
    check_moments(offsets[0, :, 0], 0.05**2)
    assert stats.kstest(offsets[0, :, 0] / 0.05, "norm").pvalue > 0.01


def test_prnu_grows_with_light():
    for level in LEVELS:
        added = draw("prnu", flat(level), std=0.03)
        check_moments(added, (0.03 * level) ** 2) if level else np.testing.assert_array_equal(added, 0)


@pytest.mark.parametrize("name", ["prnu", "column_noise"])
def test_a_sensor_keeps_its_pattern(name):
    image = flat(0.5, (32, 33))
    draw_for = functools.partial(draw, name, image, std=0.05)
    mine = draw_for(seed=0, options=(("sensor", 7),))
    np.testing.assert_array_equal(mine, draw_for(seed=1, options=(("sensor", 7),)))
    assert np.abs(mine - draw_for(seed=0, options=(("sensor", 8),))).max() > 0.01
    assert np.abs(draw_for(seed=0) - draw_for(seed=1)).max() > 0.01


@pytest.mark.parametrize("horizontal, vertical", [(0.5, -0.3), (-0.65, 0.65), (0.0, 0.0)])
def test_correlation_with_neighbours(horizontal, vertical):
    added = draw("correlated_noise", flat(0.5), std=0.1, horizontal=horizontal, vertical=vertical) / 0.1

    def lags(r):
        side = 0.0 if r == 0 else (1 - np.sqrt(1 - 2 * r * r)) / (2 * r)
        return {-1: r, 0: 1.0, 1: r, 2: side**2 / (1 + 2 * side**2), -2: side**2 / (1 + 2 * side**2), 3: 0.0}

    spread = 4 * 2.2 / np.sqrt(PIXELS)  # Bartlett: at most 2.2 times that of white noise here
    for dy in (0, 1, 2, 3):
        for dx in (0, 1, 2, 3):
            a, b = added[dy:, dx:], added[: SHAPE[0] - dy, : SHAPE[1] - dx]
            want = lags(vertical)[dy] * lags(horizontal)[dx]
            assert abs(np.mean(a * b) - want) < spread, (dy, dx)
    assert stats.kstest(added[::3, ::3].ravel(), "norm").pvalue > 0.01
    border = np.concatenate([added[0], added[-1], added[:, 0], added[:, -1]])
    assert abs(border.var() - 1) < 4 * np.sqrt(2 * 2.2 / border.size), "borders are as the rest"


def test_correlated_channels_have_noise_of_their_own():
    added = draw("correlated_noise", flat(0.5, (64, 65, 3)), std=0.1, horizontal=0.5)
    assert np.abs(np.corrcoef(added.reshape(-1, 3).T) - np.eye(3)).max() < 4 * 1.3 / np.sqrt(64 * 65)


def tukey_h_cdf(x, tail):
    """Closed form through Lambert's W; the argument has unit variance."""
    x = x / (1 - 2 * tail) ** 0.75
    z = np.sign(x) * np.sqrt(special.lambertw(tail * x * x).real / tail) if tail else x
    return stats.norm.cdf(z)


@pytest.mark.parametrize("tail", [0.0, 0.1, 0.25, 0.4])
def test_heavy_tails_follow_tukeys_h(tail):
    added = draw("heavy_tailed_noise", flat(0.5), std=0.1, tail=tail) / 0.1
    # 3e-6 off: float32 rounding of the sum with the image
    assert stats.kstest(added.ravel(), lambda x: tukey_h_cdf(x, tail)).pvalue > 0.01
    if tail < 0.125:  # above, the fourth moment's own spread is too wide
        kurtosis = 3 * (1 - 2 * tail) ** 3 / (1 - 4 * tail) ** 2.5
        check_moments(added, 1.0, kurtosis)
    assert (np.abs(added) > 6).sum() == 0 if tail == 0 else (np.abs(added) > 6).any()


@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.0])
def test_grain_is_noise_blurred_by_scipy(sigma):
    shape, key = (21, 34), jax.random.key(3)
    params = noise.FilmGrain(std=np.float32(0.1), sigma=np.float32(sigma))
    image = flat(0.5, (*shape, 3))
    got = np.asarray(jax.jit(noise.film_grain)(params, image, key=key), np.float64) - 0.5
    white = np.asarray(jax.random.normal(key, (21 + 12, 34 + 12)), np.float64)
    taps = scipy.ndimage.gaussian_filter(np.eye(1, 13, 6)[0], sigma, radius=6, mode="constant")
    blurred = scipy.ndimage.gaussian_filter(white, sigma, radius=6)[6:-6, 6:-6] / np.sum(taps**2)
    np.testing.assert_allclose(got, 0.1 * blurred[..., None] * np.ones(3), atol=5e-7)


def test_grain_keeps_its_strength_at_every_size():
    for sigma in (0.3, 0.8, 2.0):
        added = draw("film_grain", flat(0.5, (*SHAPE, 3)), std=0.1, sigma=sigma)[..., 0]
        independent = PIXELS / max(1.0, 2 * np.pi * sigma**2)  # Bartlett
        assert abs(added.var() / 0.01 - 1) < 4 * np.sqrt(2 / independent)


def test_grain_follows_luma_and_spares_black_and_white():
    for color in ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.9, 0.3, 0.1), (0.1, 0.1, 0.1)):
        image = np.broadcast_to(np.asarray(color, np.float32), (*SHAPE, 3))
        y = np.dot(color, (0.299, 0.587, 0.114))
        added = draw("film_grain", image, std=0.1, sigma=0.8)
        want = 0.2 * np.sqrt(max(y * (1 - y), 0))
        np.testing.assert_allclose(added[..., 1].std(), want, rtol=0.04, atol=1e-4)


def test_gradients_at_no_variance_are_finite():
    def total(params, x):
        return jnp.sum(noise.shot_read_noise(params, x, key=jax.random.key(0)) ** 2)

    dark = noise.ShotReadNoise(shot=np.float32(0), read=np.float32(0))
    to_params, to_image = jax.jit(jax.grad(total, (0, 1)))(dark, smooth_image((9, 8)).astype(np.float32))
    assert np.isfinite(to_params.read) and np.isfinite(to_params.shot) and np.isfinite(to_image).all()
