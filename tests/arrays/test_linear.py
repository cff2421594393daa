"""Linear maps with their own transpose: both modes, every nesting, and that the transpose given is used."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays.linear import fused_sum, inner_product, linear_call, mean, pointwise, scaled, sums
from tests.gradients import check_grads

MATRIX = np.random.default_rng(0).standard_normal((4, 3))


@jax.custom_jvp
def product(matrix, x):
    return matrix @ x


@product.defjvp
def _product_jvp(primals, tangents):
    by_x = linear_call(lambda m, v: m @ v, lambda m, y: y @ m, primals[0], tangents[1])
    by_matrix = linear_call(lambda x, m: m @ x, lambda x, y: y[:, None] * x, primals[1], tangents[0])
    return product(*primals), by_x + by_matrix


def test_every_order_and_mode(rng, x64):
    x = jnp.asarray(rng.standard_normal(3))
    fn = jax.jit(lambda m, v: jnp.sin(product(m, v)))
    check_grads(fn, (MATRIX, x), order=2)


@pytest.mark.parametrize("axes", [(0, 0), (None, 0), (0, None), (2, 1)])
def test_vmap_in_both_modes(axes, rng, x64):
    def batched(value, axis):
        return value if axis is None else jnp.moveaxis(jnp.stack([value, 2 * value, value + 1]), 0, axis)

    arguments = (batched(jnp.asarray(MATRIX), axes[0]), batched(jnp.asarray(rng.standard_normal(3)), axes[1]))
    check_grads(jax.jit(jax.vmap(product, axes)), arguments, order=2)
    per_sample = jax.jit(jax.vmap(jax.grad(lambda m, v: jnp.sum(product(m, v) ** 2), (0, 1)), axes))
    plain = jax.jit(jax.vmap(jax.grad(lambda m, v: jnp.sum((m @ v) ** 2), (0, 1)), axes))
    for got, want in zip(per_sample(*arguments), plain(*arguments)):
        np.testing.assert_allclose(got, want, atol=1e-12)


def test_the_transpose_given_is_the_one_that_runs():
    def doubled(x):  # a transpose that lies shows that it is used, also under vmap and jit
        return linear_call(lambda _, v: v, lambda _, y: 2 * y, (), x)

    assert jax.grad(doubled)(1.0) == 2
    np.testing.assert_array_equal(jax.vmap(jax.grad(doubled))(jnp.ones(3)), 2)
    assert jax.jit(jax.jvp, static_argnums=0)(doubled, (1.0,), (1.0,))[1] == 1
    back = jax.linear_transpose(doubled, 1.0)
    assert back(1.0)[0] == 2 and jax.linear_transpose(lambda y: back(y)[0], 1.0)(1.0)[0] == 1


def test_trees_go_in_and_out(x64):
    def swap(factor, pair):
        return {"b": factor * pair[0], "a": pair[1].sum()}

    def back(factor, y):
        return (factor * y["b"], jnp.broadcast_to(y["a"], (2,)))

    def fn(pair):
        y = linear_call(swap, back, jnp.float64(3), pair)
        return jnp.sum(y["b"] ** 2) + y["a"] ** 3

    check_grads(jax.jit(fn), ((jnp.array([1.0, 2.0]), jnp.array([0.5, 1.5])),), order=2)


@pytest.mark.parametrize("shape", [(5,), (4, 6), (4, 6, 3)])
def test_inner_product_and_scaled(shape, rng, x64):
    x, y = rng.standard_normal((2, *shape))
    np.testing.assert_allclose(inner_product(x, y), np.sum(x * y), rtol=1e-12)
    check_grads(jax.jit(scaled), (jnp.asarray(0.7), jnp.asarray(x)), order=2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_fused_sum(axis, rng, x64):
    x = jnp.asarray(rng.standard_normal((3, 8, 5)))
    np.testing.assert_allclose(jax.jit(lambda v: fused_sum(v, axis))(x), x.sum(axis), rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(lambda v: fused_sum(v, axis))(x[None])[0], x.sum(axis), rtol=1e-12)
    check_grads(jax.jit(lambda v: fused_sum(v**3, axis)), (x,), order=2)


@pytest.mark.parametrize("shape", [(4, 6), (1, 5, 3), (7, 1)])
def test_sums(shape, rng, x64):
    """Over the rows of each image of a batch, also as a part of a program that is differentiated."""
    x, y = rng.standard_normal((2, 2, *shape))

    def fn(x, y):
        return x * y, jnp.sin(x), y**2

    for got, want in zip(jax.jit(jax.vmap(lambda *v: sums(fn, *v)))(x, y), fn(x, y), strict=True):
        np.testing.assert_allclose(got, want.sum(1), rtol=1e-12)
    check_grads(jax.jit(lambda *v: sums(fn, *v)), (x[0], y[0]), order=2)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_the_mean_of_more_than_its_type_can_count(dtype, rng):
    x = rng.random((300, 300)).astype(dtype)
    got = mean(jnp.asarray(x))
    assert got.dtype == dtype
    np.testing.assert_allclose(got, x.mean(dtype=float), rtol=2e-3 if dtype == np.float16 else 1e-5)


def test_pointwise_has_the_gradients_of_the_plain_form(rng, x64):
    x, y = (jnp.asarray(v) for v in rng.uniform(0.1, 1, (2, 5, 4, 3)))

    def curve(x, y, a, b):
        return jnp.sin(a * x) + b * y * x**a

    values = (x, y, jnp.asarray(0.7), jnp.asarray(-1.2))
    fast = jax.jit(lambda x, y, a, b: pointwise(curve, (x, y), a, b))
    np.testing.assert_allclose(fast(*values), curve(*values), rtol=1e-12)
    check_grads(fast, values, order=2)
    batch = jax.tree.map(lambda v: jnp.stack([v, 0.5 * v]), values)
    got = jax.jit(jax.vmap(jax.grad(lambda *v: jnp.sum(fast(*v) ** 2), (0, 1, 2, 3))))(*batch)
    want = jax.jit(jax.vmap(jax.grad(lambda *v: jnp.sum(curve(*v) ** 2), (0, 1, 2, 3))))(*batch)
    for g, w in zip(got, want):
        np.testing.assert_allclose(g, w, rtol=1e-9)


def test_pointwise_keeps_the_dtype_of_the_arrays():
    x = jnp.ones((2, 3), jnp.float32)
    assert pointwise(lambda x, a: x * a, (x,), np.float64(2)).dtype == jnp.float32
    assert jax.grad(lambda a: pointwise(lambda x, a: x * a, (x,), a).sum())(2.0) == 6
