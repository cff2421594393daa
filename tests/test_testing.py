"""The contract's checks: each fails on a stage that breaks it, and names the stage."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.domains import LinearRGB
from jaxisp.node import Stage, stage
from jaxisp.params import Leaf, param, parameters
from jaxisp.testing import CHECKS, Subject, check_stage


@parameters
class Amount:
    """One number."""

    amount: Leaf = param(0.5, (0.0, 2.0), "1", doc="how much")


def documented(gradient: str):
    """Give a function the docstring that the contract asks for."""

    def write(fn):
        fn.__doc__ = (
            f"A sum.\n\nArgs:\n    params: amount.\n    image: (H, W, 3).\n\n"
            f"Returns:\n    (H, W, 3).\n\nGradient: {gradient}.\n\nSource: none."
        )
        return fn

    return write


@documented("exact")
def sound(params: Amount, image: LinearRGB) -> LinearRGB:
    return image * params.amount


@documented("exact")
def root(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * jnp.sqrt(image)


@documented("exact")
def steep(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * jnp.cbrt(image)


@documented("exact")
def dead(params: Amount, image: LinearRGB) -> LinearRGB:
    return image + 0 * params.amount


@documented("exact")
def stopped(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image * jax.lax.stop_gradient(params.amount)


@documented("exact")
def mixed(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image @ jnp.eye(3, dtype=image.dtype)


@documented("exact")
def other_forward(params: Amount, image: LinearRGB) -> LinearRGB:
    @jax.custom_jvp
    def half(x):
        return x / 2

    half.defjvp(lambda p, t: (p[0] / 3, t[0] / 2))
    return params.amount * half(image)


@documented("exact")
def by_batch(params: Amount, image: LinearRGB) -> LinearRGB:
    @jax.custom_batching.custom_vmap
    def double(x):
        return 2 * x

    double.def_vmap(lambda size, batched, x: (2 * x + 1, True))
    return params.amount * jax.lax.stop_gradient(double(image))


@documented("exact")
def by_concreteness(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image * (1 if isinstance(image, jax.core.Tracer) else 2)


@documented("exact")
def half_precision(params: Amount, image: LinearRGB) -> LinearRGB:
    return (params.amount * image).astype(jnp.bfloat16)


@documented("sometimes")
def vague(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image


def test_a_sound_stage_passes_everything():
    assert check_stage(sound) == list(CHECKS)
    assert check_stage(stage(sound, name="other"), only=["total"]) == ["total"]


@pytest.mark.parametrize(
    ("broken", "check", "why"),
    [
        (vague, "declaration", "Gradient must begin with"),
        (root, "total", "not finite"),
        (half_precision, "total", "bfloat16"),
        (steep, "gradient_is_finite", "gradient not finite"),
        (dead, "gradient_reaches_parameters", "amount has no gradient"),
        (stopped, "gradient_is_exact", "differs from differences"),
        (mixed, "products_are_precise", "precision=HIGHEST"),
        (other_forward, "gradient_gives_the_value", "Not equal"),
        (by_batch, "batch_agrees", "Not equal"),
        (by_concreteness, "plain_call_agrees", "Not equal"),
    ],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_each_check_can_fail(broken, check, why):
    with pytest.raises(AssertionError, match=why):
        check_stage(broken, only=[check])


class Unchecked(Stage):
    """A stage that takes whatever it is given."""

    def apply(self, params, image, key):
        return image


class Growing(Subject):
    """Parameters of another length at each draw."""

    def params(self, share=None, seed=0, dtype=np.float32):
        return {"sound": Amount(amount=np.zeros(seed + 1, dtype))}


def test_wrong_shapes_and_retraces_are_seen():
    with pytest.raises(AssertionError, match="takes float32 of shape"):
        check_stage(Unchecked(sound, "sound"), only=["wrong_shapes_are_refused"])
    with pytest.raises(AssertionError, match="traced again"):
        CHECKS["no_retrace"](Growing(Unchecked(sound, "sound")))


def test_unknown_names_are_refused():
    with pytest.raises(KeyError, match="no check named 'nonsense'"):
        check_stage(sound, only=["nonsense"])
    with pytest.raises(KeyError, match="no stage named"):
        check_stage("nonsense")
