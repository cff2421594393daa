"""The contract's checks: each fails on a stage that breaks it, and names the stage."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp import Chain
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


@documented("exact")
def doubled(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image * np.sqrt(2)  # a float64, which is stronger than a Python number


@documented("exact")
def by_rank(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image * image.mean((0, 1))


@documented("exact")
def by_dtype(params: Amount, image: LinearRGB) -> LinearRGB:
    return params.amount * image * (image > 0)


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
        (doubled, "numeric_modes", "double precision enabled: .*float64"),
        (by_rank, "numeric_modes", "without implicit promotion: .*rank_promotion"),
        (by_dtype, "numeric_modes", "without implicit promotion: .*bool"),
        (by_batch, "batch_agrees", "Not equal"),
        (by_concreteness, "plain_call_agrees", "Not equal"),
    ],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_each_check_can_fail(broken, check, why):
    with pytest.raises(AssertionError, match=why):
        check_stage(broken, only=[check])


@pytest.mark.parametrize("dtype", [jnp.bfloat16, np.float16])
def test_half_precision_is_computed_in_float32(dtype):
    """A sum of 2000 ones is 256 in bfloat16, added one by one; rounded at the end it is right."""
    image = jnp.linspace(0.1, 0.9, 21 * 34 * 3).reshape(21, 34, 3).astype(dtype)
    params = {"gray_world": stage("gray_world").init()["gray_world"]}
    out = stage("gray_world")(params, image)
    exact = stage("gray_world")(params, image.astype(np.float32))
    assert out.dtype == dtype
    np.testing.assert_array_equal(out, exact.astype(dtype))


def test_parameters_take_the_dtype_that_is_computed_in():
    image = np.full((4, 6, 3), 0.5, np.float32)
    with jax.enable_x64(True):
        assert stage(sound)({"sound": Amount(amount=np.float64(0.3))}, image).dtype == np.float32
        double = stage(sound)({"sound": Amount(amount=np.float32(0.5))}, image.astype(np.float64))
    assert double.dtype == np.float64


class Unchecked(Stage):
    """A stage that takes whatever it is given."""

    def apply(self, params, image, key):
        return image


class Widening(Stage):
    """A stage without the rule of dtypes."""

    def apply(self, params, image, key):
        return jnp.asarray(image, jnp.float32)


class Growing(Subject):
    """Parameters of another length at each draw."""

    def params(self, share=None, seed=0, dtype=np.float32):
        return {"sound": Amount(amount=np.zeros(seed + 1, dtype))}


def test_wrong_shapes_and_retraces_are_seen():
    with pytest.raises(AssertionError, match="takes float32 of shape"):
        check_stage(Unchecked(sound, "sound"), only=["wrong_shapes_are_refused"])
    with pytest.raises(AssertionError, match="traced again"):
        CHECKS["no_retrace"](Growing(Unchecked(sound, "sound")))


def test_another_dtype_than_the_image_has_is_seen():
    with pytest.raises(AssertionError, match="half precision: float32 comes of bfloat16"):
        check_stage(Widening(sound, "sound"), only=["numeric_modes"])


def test_unknown_names_are_refused():
    with pytest.raises(KeyError, match="no check named 'nonsense'"):
        check_stage(sound, only=["nonsense"])
    with pytest.raises(KeyError, match="no stage named"):
        check_stage("nonsense")


def test_what_is_no_one_stage_is_told_in_words():
    for wrong, words in (
        (Chain((stage("clip"),)), "got Chain 'chain', which is a node already"),
        (stage("clip"), "which is a node already"),
        (3, "got 3"),
    ):
        with pytest.raises(TypeError, match=f"a stage function or a registered name, {words}|{words}"):
            stage(wrong)
    with pytest.raises(TypeError, match="which is a node already"):
        check_stage(Chain((stage("clip"),)), only="declaration")
    assert check_stage("clip", only="declaration") == ["declaration"]
