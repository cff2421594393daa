"""A share of a function: what is not run, and what its gradient is all the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays.shares import weighted
from tests.gradients import check_grads


def test_weighted_is_not_run_at_0_but_its_gradient_is_the_products():
    ran = []

    def fn(x):
        jax.debug.callback(lambda: ran.append(1))
        return x * x

    def product(share, x):
        return weighted(fn, share, x)

    for of, expected in ((product, 9), (jax.grad(product, argnums=1), 6)):  # the share is fixed in both
        for share, count in ((0.0, 0), (0.5, 1)):
            ran.clear()
            value = jax.jit(of)(share, jnp.float32(3))
            jax.effects_barrier()
            assert value == share * expected and len(ran) == count
    plain = jax.vmap(lambda share, x: weighted(lambda v: v * v, share, x))
    fixed = jnp.array([0.0, 0.5, -2.0])  # of a batch, in which only the operands move
    slopes = jax.jit(jax.grad(lambda x: plain(fixed, x).sum()))(jnp.array([3.0, 1.5, -1.0]))
    np.testing.assert_allclose(slopes, [0, 1.5, 4])
    at = jnp.array([0.0, 0.5, -2.0]), jnp.array([3.0, 1.5, -1.0])
    check_grads(plain, at, order=1, rtol=1e-2, atol=1e-2)
    assert jax.grad(lambda share: weighted(lambda v: v * v, share, jnp.float32(3)))(0.0) == 9


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_one_share_for_a_batch_of_pictures(share, rng):
    pictures = jnp.asarray(rng.random((3, 4, 5)), jnp.float32)

    def loss(share, pictures):
        batch = jax.jit(jax.vmap(lambda s, x: weighted(jnp.sin, s, x), (None, 0)))
        return jnp.sum(batch(share, pictures) ** 2 + pictures * share)

    got = jax.jit(jax.grad(loss, (0, 1)))(share, pictures)
    sine = jnp.sin(pictures)
    np.testing.assert_allclose(got[0], jnp.sum(2 * share * sine**2 + pictures), rtol=1e-5)
    np.testing.assert_allclose(got[1], 2 * share**2 * sine * jnp.cos(pictures) + share, rtol=1e-5)


def test_a_share_of_its_own_for_each_of_a_batch(rng):
    picture, shares = jnp.asarray(rng.random((4, 5)), jnp.float32), jnp.array([0.0, 0.5])

    def loss(shares, picture):
        batch = jax.jit(jax.vmap(lambda s, x: weighted(jnp.sin, s, x), (0, None)))
        return batch(shares, picture).sum()

    got = jax.jit(jax.grad(loss, (0, 1)))(shares, picture)
    np.testing.assert_allclose(got[0], np.full(2, jnp.sin(picture).sum()), rtol=1e-5)
    np.testing.assert_allclose(got[1], 0.5 * jnp.cos(picture), rtol=1e-5)
