"""Noise by its moments and by exact quantiles of SciPy's Poisson law."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from scipy import stats

from benchmarks.exact.row import Row, largest
from jaxisp.cfa import PATTERNS
from jaxisp.pipeline import run, stage
from jaxisp.stages import noise
from jaxisp.stages.noise import light
from tests.stages.test_demosaic import mosaic_of

SCIPY = f"SciPy {scipy.__version__}"
LEVELS = (0.0, 0.02, 0.18, 0.5, 1.0, 1.5)
SHAPE = (256, 257)
Law = Callable[[float], float]
"""Light to a moment of the noise."""


def rows() -> Iterator[Row]:
    yield moments("gaussian_noise", noise.GaussianNoise(std=np.float32(0.1)), lambda x: 0.01, lambda x: 0.0)
    shot_read = noise.ShotReadNoise(shot=np.float32(0.04), read=np.float32(0.02))
    yield moments("shot_read_noise", shot_read, lambda x: 0.04 * x + 4e-4, lambda x: 0.0)
    poisson = noise.PoissonNoise(gain=np.float32(0.04), read=np.float32(0.02))
    yield moments("poisson_noise", poisson, lambda x: 0.04 * x + 4e-4, lambda x: 0.04**3 * x)
    yield quantiles()
    yield distribution()
    yield counts()


def moments(name: str, params: object, variance: Law, fourth_cumulant: Law) -> Row:
    """Mean and variance at the sites of each colour, in standard errors; colours at other levels."""
    node, z = stage(name), []
    for seed, cfa in enumerate(PATTERNS):
        for shift in range(len(LEVELS)):
            flat = np.roll(LEVELS, shift)[:3].astype(np.float32)
            mosaic = mosaic_of(np.broadcast_to(flat, (*SHAPE, 3)), cfa)
            noisy = run(node, {name: params}, mosaic, jax.random.key(100 * seed + shift))
            added = np.asarray(noisy, np.float64) - mosaic
            for level in map(float, flat):
                here, var = added[mosaic == np.float32(level)], variance(level)
                spread = np.sqrt((2 * var**2 + fourth_cumulant(level)) / here.size)
                z += [here.mean() / np.sqrt(var / here.size), (here.var() - var) / spread]
    bound = float(stats.norm.isf(0.005 / len(z)))
    ran = f"means and variances at the sites of each colour, four CFAs, light 0 to 1.5: {len(z)} figures"
    return Row(name, "its own law; bound for 1 % over all", ran, float(np.max(np.abs(z))), bound, "z")


def quantiles() -> Row:
    """Below a mean of 16 the quantile function is summed: counts are exact."""
    u, wrong = (np.arange(20001) + 0.5) / 20001, 0
    with jax.enable_x64(True):
        for mean in (0.01, 0.3, 1.3, 4.0, 8.0, 12.5, 15.99):
            got = np.round(light._summed(jnp.asarray(u), jnp.full(u.shape, mean)) + mean)
            wrong += int(np.sum(got != stats.poisson.ppf(u, mean)))
    ran = "20001 quantiles each of means 0.01 to 15.99, double precision"
    return Row("poisson_noise, quantiles", SCIPY, ran, wrong, 0, "counts that differ")


def distribution() -> Row:
    """From 16 on it is an expansion: the largest error of a probability."""
    u = (np.arange(1_000_000) + 0.5) / 1_000_000
    expanded, worst = jax.jit(light._expanded), []
    with jax.enable_x64(True):
        for mean in (16.0, 16.7, 30.0, 100.3, 1e3, 1e4):
            values = np.round(np.asarray(expanded(2 * u - 1, np.full(u.shape, mean))) + mean)
            k, first = np.unique(values, return_index=True)
            worst.append(largest(first[1:] / u.size, stats.poisson.cdf(k[:-1], mean)))
    ran = "a million quantiles each of means 16 to 10000, double precision: cumulative probability"
    return Row("poisson_noise, distribution", SCIPY, ran, max(worst), 2.1e-5)


def counts() -> Row:
    """Drawn counts in up to 25 bins of the law; the smallest p-value times the number of tests."""
    means, gain, p = (0.05, 0.7, 5.0, 15.9, 16.1, 60.0, 1500.0), np.float32(2.0**-10), []
    for seed, mean in enumerate(means):
        params = noise.PoissonNoise(gain=gain, read=np.float32(0))
        image = np.full(SHAPE, mean * gain, np.float32)
        drawn = run(stage("poisson_noise"), {"poisson_noise": params}, image, jax.random.key(seed))
        law, drawn = stats.poisson(mean), np.round(np.asarray(drawn, np.float64) / gain)
        edges = np.unique(law.ppf(np.linspace(0.01, 0.99, 25)))
        observed = np.bincount(np.searchsorted(edges, drawn.ravel()), minlength=len(edges) + 1)
        expected = np.diff([0.0, *law.cdf(edges), 1.0]) * drawn.size
        p.append(float(stats.chisquare(observed, expected).pvalue))
    ran = f"{len(means)} chi-square tests of {drawn.size} draws, means 0.05 to 1500, single precision"
    smallest = min(1.0, min(p) * len(p))
    return Row("poisson_noise, draws", SCIPY, ran, smallest, 0.01, "corrected p", at_least=True)
