"""No product in a stage is left to a device's default: a GPU's rounds float32 to 10 bits.

tests/contract examines every stage's own programs; this tests the examination, and larger frames.
"""

import jax
import jax.numpy as jnp
import pytest
from jax import lax

from jaxisp.pipeline import stage
from jaxisp.testing import imprecise_products

HIGHEST = lax.Precision.HIGHEST


@pytest.mark.parametrize("size", [24, 1024])  # a large frame goes other ways
@pytest.mark.parametrize(
    "node", [stage("bilateral", chroma_cell=4), stage("resampling")], ids=lambda n: n.name
)
def test_products_of_other_forms_are_exact(node, size):
    def run(params, image):
        return jnp.sum(node(params, image, key=jax.random.key(0)) ** 2)

    image = jax.ShapeDtypeStruct((size, size, 3), jnp.float32)
    for program in (run, jax.grad(run, argnums=(0, 1))):
        assert not imprecise_products(jax.make_jaxpr(program)(node.init(), image))


def test_an_imprecise_product_is_seen():
    a = jnp.ones((3, 3))

    def looped(a):
        inner = jax.jit(lambda a: a @ a)
        return lax.cond(a[0, 0] > 0, lambda: lax.fori_loop(0, 3, lambda _, a: inner(a), a), lambda: a)

    assert len(imprecise_products(jax.make_jaxpr(looped)(a))) == 1
    assert len(imprecise_products(jax.make_jaxpr(jax.grad(lambda a: (a @ a).sum()))(a))) == 3
    assert not imprecise_products(jax.make_jaxpr(lambda a: jnp.matmul(a, a, precision=HIGHEST))(a))
    whole = jnp.ones((3, 3), jnp.int32)
    assert not imprecise_products(jax.make_jaxpr(lambda a: a @ a)(whole))
