"""No product in a stage is left to a device's default: a GPU's rounds float32 to 10 bits.

Every stage's own programs are looked through in tests/contract; here is what they are looked through with.
"""

import jax
import jax.numpy as jnp
import pytest
from jax import lax

from jaxisp.pipeline import stage

HIGHEST = lax.Precision.HIGHEST


def loose(program) -> list[str]:
    """The products of a jaxpr, branches and loops and all, that are less than float32 on some device."""
    found = []
    for step in program.eqns:
        if step.primitive.name in ("dot_general", "conv_general_dilated"):
            floats = all(jnp.issubdtype(v.aval.dtype, jnp.floating) for v in step.invars)
            if floats and step.params["precision"] not in (HIGHEST, (HIGHEST, HIGHEST)):
                found.append(str(step))
        for value in jax.tree.leaves(list(step.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
            inner = getattr(value, "jaxpr", value)
            found += loose(inner) if hasattr(inner, "eqns") else []
    return found


@pytest.mark.parametrize("size", [24, 1024])  # a large frame goes other ways
@pytest.mark.parametrize(
    "node", [stage("bilateral", chroma_cell=4), stage("resampling")], ids=lambda n: n.name
)
def test_products_of_other_forms_are_exact(node, size):
    def run(params, image):
        return jnp.sum(node(params, image, key=jax.random.key(0)) ** 2)

    image = jax.ShapeDtypeStruct((size, size, 3), jnp.float32)
    for program in (run, jax.grad(run, argnums=(0, 1))):
        assert not loose(jax.make_jaxpr(program)(node.init(), image))


def test_a_loose_product_is_seen():
    a = jnp.ones((3, 3))

    def looped(a):
        inner = jax.jit(lambda a: a @ a)
        return lax.cond(a[0, 0] > 0, lambda: lax.fori_loop(0, 3, lambda _, a: inner(a), a), lambda: a)

    assert len(loose(jax.make_jaxpr(looped)(a))) == 1
    assert len(loose(jax.make_jaxpr(jax.grad(lambda a: (a @ a).sum()))(a))) == 3
    assert not loose(jax.make_jaxpr(lambda a: jnp.matmul(a, a, precision=HIGHEST))(a))
    whole = jnp.ones((3, 3), jnp.int32)
    assert not loose(jax.make_jaxpr(lambda a: a @ a)(whole))
