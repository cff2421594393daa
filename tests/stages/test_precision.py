"""No product in a stage is left to a device's default: a GPU's rounds float32 to 10 bits."""

import re

import jax
import jax.numpy as jnp
import pytest
from jax import lax

from jaxisp.pipeline import stage
from jaxisp.stages import STAGES

ON_A_GRID = stage("bilateral", chroma_cell=4)
PRODUCT = re.compile(r".*(?:dot_general|convolution).*f32.*")


def loose(fn, *args):
    """What a function computes to less than float32 on another device than a CPU."""
    program = jax.jit(fn).trace(*args).lower(lowering_platforms=("tpu",)).as_text()
    return [line for line in PRODUCT.findall(program) if "precision = [HIGHEST, HIGHEST]" not in line]


@pytest.mark.parametrize("node", [*map(stage, sorted(STAGES)), ON_A_GRID], ids=lambda node: node.name)
def test_products_are_exact(node):
    key = jax.random.key(0)
    image = jnp.full((24, 24) if node.domain_in.channels == 1 else (24, 24, 3), 0.5)

    def run(params, image):
        return jnp.sum(node(params, image, key=key) ** 2)

    assert not loose(jax.grad(run, argnums=(0, 1)), node.init(), image)


def test_a_loose_product_is_seen():
    a = jnp.ones((3, 3))
    assert len(loose(lambda a: jax.jit(lambda a: a @ a)(a), a)) == 1
    assert not loose(lambda a: jnp.matmul(a, a, precision=lax.Precision.HIGHEST), a)
