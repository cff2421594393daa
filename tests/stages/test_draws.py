"""Standard normal numbers against JAX's."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.stages.draws import standard_normal


@pytest.mark.parametrize("shape", [(), (5,), (31, 17), (9, 14, 3)])
def test_bits_are_those_of_jax(shape):
    keys = jax.random.split(jax.random.key(7), 4)
    ours, theirs = (
        jax.jit(jax.vmap(partial(fn, shape=shape, dtype=jnp.float32)))(keys)
        for fn in (standard_normal, jax.random.normal)
    )
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("implementation, dtype", [("rbg", jnp.float32), ("threefry2x32", jnp.float16)])
def test_other_keys_and_types_are_left_to_jax(implementation, dtype):
    key = jax.random.key(3, impl=implementation)
    ours, theirs = (fn(key, (7, 4), dtype) for fn in (standard_normal, jax.random.normal))
    assert ours.dtype == dtype
    np.testing.assert_array_equal(ours, theirs)
