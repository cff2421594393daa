"""Gradient-safe primitives, and that `materialize` still does what it is for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays.barriers import materialize, on_all_cores
from jaxisp.arrays.rows import as_rows, elementwise, from_rows
from jaxisp.arrays.safe_math import (
    clip,
    clip_through,
    nearest_int,
    round_through,
    safe_divide,
    safe_sqrt,
    straight_through,
)
from tests.gradients import check_grads


@pytest.mark.parametrize("transform", [lambda f: f, jax.vmap, lambda f: jax.grad(lambda x: f(x).sum())])
def test_materialize_survives_compilation(transform):
    """JAX or XLA may learn to remove it; then whole chains become many times slower, with right results."""
    x = jnp.ones((4, 64))
    text = jax.jit(transform(lambda v: jnp.sin(materialize(jnp.cos(v))))).lower(x).compile().as_text()
    assert "conditional(" in text


def test_materialize_is_the_identity(rng):
    x = jnp.asarray(rng.standard_normal((3, 5)))
    np.testing.assert_array_equal(jax.jit(materialize)(x), x)
    np.testing.assert_array_equal(jax.grad(lambda v: (materialize(v) ** 2).sum())(x), 2 * x)


def test_a_loop_of_materialized_work_is_left_to_all_cores():
    """jaxlib from 0.11 on takes such a loop for small, marks it and runs it on one core."""

    def body(i, x):
        return materialize(jnp.sin(x)) + on_all_cores(i)

    def loop(x):
        return jax.lax.fori_loop(0, 5, body, x)

    x = jnp.linspace(0, 1, 4096).reshape(64, 64)
    text = jax.jit(loop).lower(x).compile().as_text()
    assert "xla_cpu_small_call" not in text and " sort(" in text
    want = x
    for i in range(5):
        want = jnp.sin(want) + i
    np.testing.assert_allclose(jax.jit(loop)(x), want, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_nearest_integers_are_numpys(dtype, rng, x64):
    most = 2**11 if dtype == np.float16 else 2**22
    numbers = np.r_[np.linspace(-most, most, 4097), np.arange(-9, 9.5, 0.5), rng.uniform(-99, 99, 1000)]
    numbers = numbers.astype(dtype)
    got = jax.jit(nearest_int)(numbers)
    assert got.dtype == np.int32
    np.testing.assert_array_equal(got, np.round(numbers).astype(int))


@pytest.mark.parametrize("fn", [safe_sqrt, lambda x: safe_divide(1.0, x)])
def test_total_at_and_below_zero(fn):
    for x in (-1.0, 0.0, 1e-30, 4.0):
        assert np.isfinite(fn(jnp.float32(x))) and np.isfinite(jax.grad(fn)(jnp.float32(x)))


def test_values():
    assert safe_sqrt(jnp.float32(9)) == 3
    assert safe_divide(1.0, jnp.float32(4)) == 0.25 and safe_divide(1.0, jnp.float32(0)) == 0


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.float32])
def test_clip_is_jax_s_also_on_the_bounds(dtype):
    x = jnp.asarray([-np.inf, -0.4, 0.25, 0.5, 0.75, 2, np.inf, np.nan], dtype)
    bounds = jnp.asarray(0.25, dtype), jnp.asarray(0.75, dtype)
    weights = jnp.arange(1, 9, dtype=dtype)

    @jax.jit
    def both(x, bounds):
        def all_of(fn):
            y, pull = jax.vjp(fn, x, *bounds)
            return [y, *pull(weights), jax.jvp(fn, (x, *bounds), (weights, *bounds))[1]]

        return all_of(clip), all_of(jnp.clip)

    for a, b in zip(*both(x, bounds), strict=True):
        assert a.dtype == dtype
        np.testing.assert_array_equal(a, b)
    assert clip(jnp.float32(3), 0, 1) == 1 and jax.grad(clip)(jnp.float32(0), 0, 1) == 0.5


def test_straight_through_has_the_exact_value_and_the_other_gradient():
    hard, soft = jnp.float32(0.1), lambda x: 1e8 * x
    value, slope = jax.value_and_grad(lambda x: straight_through(hard, soft(x)))(jnp.float32(3))
    assert value == hard and slope == 1e8
    assert jax.grad(round_through)(0.3) == 1 and round_through(jnp.float32(2.5)) == 2
    assert jax.grad(lambda x: clip_through(x, 0, 1))(2.0) == 0
    assert jax.grad(lambda x: clip_through(x, 0, 1, leak=0.1))(2.0) == pytest.approx(0.1)
    assert clip_through(jnp.float32(2), 0, 1, leak=0.1) == 1


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (4, 5, 7, 3)])
def test_elementwise_is_the_function(shape, rng):
    x, y = jnp.asarray(rng.random((2, *shape)), jnp.float32)

    def curve(x, y):
        return jnp.exp(x) * y

    fn = jax.jit(lambda x, y: elementwise(curve, x, y))
    np.testing.assert_allclose(fn(x, y), curve(x, y), rtol=1e-6)
    check_grads(fn, (x, y), order=1, rtol=2e-2, atol=2e-2)
    np.testing.assert_allclose(jax.vmap(fn)(x, y), curve(x, y), rtol=1e-6)


def test_rows_are_the_image_s_and_go_back():
    image = jnp.arange(24.0).reshape(2, 4, 3)
    np.testing.assert_array_equal(as_rows(image), np.arange(24.0).reshape(2, 12))
    np.testing.assert_array_equal(from_rows(as_rows(image), image.shape), image)
