"""The forms that other devices than a CPU run, computed on a CPU, against the CPU's own."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxisp.arrays import platforms
from jaxisp.arrays.stencils import filter_rows_columns
from jaxisp.pipeline import over_batch
from jaxisp.recipes import RECIPES
from jaxisp.stages.denoise.bilateral import bilateral_planes
from jaxisp.stages.denoise.grid import grid_planes
from jaxisp.stages.jpeg import Jpeg, jpeg
from jaxisp.testing import smooth_image


@pytest.fixture
def elsewhere(monkeypatch):
    """Call a function, jitted, as a device that is not a CPU would."""
    taken = []

    def other(*args, default, **_):
        taken.append(default)
        return default(*args)

    def call(fn, *args):
        with monkeypatch.context() as patched:
            patched.setattr(lax, "platform_dependent", other)
            patched.setattr(platforms, "has_cpus_alone", lambda: False)
            jax.clear_caches()  # helpers keep what they were traced to
            y = jax.jit(lambda *args: fn(*args))(*args)
        jax.clear_caches()
        assert taken, "nothing asked for the device"
        return y

    return call


def value_and_gradients(fn):
    """Of a function of arrays to planes: the planes, and the gradients of a sum over them."""

    def both(*args):
        y, pull = jax.vjp(fn, *args)
        return y, pull(jax.tree.map(jnp.cos, y))

    return both


def close(got, want, atol):
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=atol * max(1, float(np.abs(b).max())))


def picture(shape, seed=0):
    return jnp.asarray(smooth_image(shape, seed), jnp.float32)


# 4:2:0 halves both axes, of which 4:2:2 has one; values of 4:4:4 are those of black and white below
@pytest.mark.parametrize(
    "subsampling", [*(pytest.param(s, marks=pytest.mark.slow) for s in ("4:4:4", "4:2:2")), "4:2:0"]
)
def test_jpeg_is_the_same_to_the_bit(elsewhere, subsampling):
    images = jnp.stack([picture((33, 41, 3), seed) for seed in range(3)])
    params = Jpeg(quality=jnp.float32([5, 60, 95]))
    coded = jax.vmap(lambda p, x: jpeg(p, x, subsampling=subsampling))
    slopes = value_and_gradients(coded)

    def both(params, images):
        return coded(params, images), slopes(params, images)

    (got, *found), (want, *wanted) = elsewhere(both, params, images), jax.jit(both)(params, images)
    np.testing.assert_array_equal(got, want)
    close(found, wanted, 1e-4)


def test_jpeg_of_black_and_white_is_the_same_to_the_bit(elsewhere, rng):
    """Where coefficients and sums are as large as they get."""
    noise = rng.integers(0, 2, (40, 48, 3))
    wave = np.cos(np.pi / 8 * (np.arange(48) + 0.5)) > 0  # of a block's lowest frequency
    checks = wave[:40, None] ^ wave ^ (np.indices((40, 48)).sum(0) % 2 > 0)
    images = noise, np.stack([checks] * 3, -1), wave[:, None] * [1, 0, 1] + 0 * noise
    coded = jax.vmap(lambda p, x: jpeg(p, x, subsampling="4:4:4"))
    qualities = np.float32([1, 2, 30, 93, 100])
    params = Jpeg(quality=np.tile(qualities, len(images)))
    each = np.repeat(np.float32(images), len(qualities), 0)
    np.testing.assert_array_equal(elsewhere(coded, params, each), jax.jit(coded)(params, each))


@pytest.mark.parametrize("mode", ["reflect", "edge", "constant"])
@pytest.mark.parametrize("shape", [(23, 31), (23, 31, 3), (4, 5, 3)])
def test_separable_filters(elsewhere, mode, shape, rng, x64):
    def filtered(image, down, across):
        return filter_rows_columns(image, down, across, mode)

    args = tuple(jnp.asarray(rng.uniform(size=s)) for s in (shape, 7, 11))
    slopes = value_and_gradients(filtered)
    close(elsewhere(slopes, *args), jax.jit(slopes)(*args), 1e-12)


@pytest.mark.parametrize(
    "filtered", [partial(grid_planes, cell=4, bins=12), partial(bilateral_planes, radius=5)]
)
def test_bilateral_filters(elsewhere, filtered, x64):
    guide, *planes = (jnp.asarray(smooth_image((38, 45), seed)) for seed in range(3))

    def both(planes, guide, space, range_):
        return filtered(planes, guide, space, range_)

    args = tuple(planes), guide, jnp.asarray(4.0), jnp.asarray(0.2)
    slopes = value_and_gradients(both)
    close(elsewhere(slopes, *args), jax.jit(slopes)(*args), 1e-10)


def test_chain(elsewhere):
    recipe = RECIPES["phone-no-post"]()
    keys = jax.random.split(jax.random.key(0))
    images = jnp.stack([picture((24, 30, 3), seed) for seed in range(2)])
    params = jax.vmap(recipe.draw)(keys)
    degraded = partial(over_batch, recipe.chain)  # not `run_batch`, which is traced once for both
    close(elsewhere(degraded, params, images, keys), jax.jit(degraded)(params, images, keys), 1e-5)
