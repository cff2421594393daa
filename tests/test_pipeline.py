"""Composition: chains, gates, shuffles, keys, batching, retracing, domains, devices."""

import itertools
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxisp.domains import RGB, EncodedRGB, LinearRGB, Mosaic
from jaxisp.errors import InputError
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import (
    REGISTRY,
    Chain,
    Gate,
    Shuffle,
    Stage,
    compiled,
    register,
    run,
    run_batch,
    sections,
    signature,
    stage,
)
from jaxisp.stages.detail import UnsharpMask, unsharp_mask
from jaxisp.testing import smooth_image


@parameters
class Gain:
    factor: Leaf = param(2.0, (0.0, 4.0), "1", doc="factor")


@parameters
class Offset:
    value: Leaf = param(0.25, (-1.0, 1.0), "level", doc="offset")


@parameters
class Grain:
    std: Leaf = param(0.1, (0.0, 1.0), "level", doc="std")


def gain(params: Gain, image: RGB) -> RGB:
    return params.factor * image


def offset(params: Offset, image: RGB) -> RGB:
    return image + params.value


def grain(params: Grain, image: RGB, *, key: jax.Array) -> RGB:
    return image + params.std * jax.random.normal(key, image.shape, image.dtype)


def square(image: RGB, *, power: int = 2) -> RGB:
    return image**power


def gray(image: LinearRGB) -> Mosaic:
    return image.mean(-1)


def encode(image: LinearRGB) -> EncodedRGB:
    return jnp.sqrt(jnp.abs(image))


CHAIN = Chain(
    (
        stage(gain),
        stage(grain, name="first"),
        Gate(stage(offset)),
        Shuffle((stage(square), stage(unsharp_mask), stage(gain, name="second_gain"))),
        stage(grain, name="second"),
    )
)
IMAGES = np.stack([smooth_image((9, 14, 3), i) for i in range(4)]).astype(np.float32)
KEY = jax.random.key(3)


def test_parameters_are_one_flat_dict_by_name():
    assert set(CHAIN.init()) == {
        "gain", "first", "use_offset", "offset", "order", "unsharp_mask", "second_gain", "second",
    }  # fmt: skip
    assert [s.name for s in CHAIN.stages()][:2] == ["gain", "first"]
    assert CHAIN.stochastic and not stage(gain).stochastic


def test_a_chain_is_its_stages_in_a_row():
    params = {"gain": Gain(), "offset": Offset()}
    out = Chain((stage(gain), stage(offset)))(params, jnp.asarray(IMAGES[0]))
    np.testing.assert_allclose(out, IMAGES[0] * 2 + 0.25, rtol=1e-6)
    nested = Chain((Chain((stage(gain),), "inner"), stage(offset)))
    np.testing.assert_array_equal(nested(params, jnp.asarray(IMAGES[0])), out)


def test_equal_pipelines_are_equal_and_share_one_compile():
    def build():
        return Chain((stage(gain), stage(unsharp_mask, radius=3)))

    assert build() == build() and hash(build()) == hash(build())
    assert stage(square, power=2) == stage(square) != stage(square, power=3)
    compiled._clear_cache()
    for _ in range(2):
        run(build(), build().init(), IMAGES[0])
    assert compiled._cache_size() == 1


def test_new_values_switches_and_orders_do_not_retrace():
    traces = []

    @jax.jit
    def counted(params, image):
        traces.append(1)
        return CHAIN(params, image, key=KEY)

    base = CHAIN.init()
    for value in (0.5, 1.5):
        counted(base | {"gain": Gain(factor=np.float32(value))}, IMAGES[0])
    for on in (0.0, 1.0):
        counted(base | {"use_offset": type(base["use_offset"])(on=np.float32(on))}, IMAGES[0])
    for order in itertools.permutations((0.0, 0.5, 1.0)):
        priority = np.asarray(order, np.float32)
        counted(base | {"order": type(base["order"])(priority=priority)}, IMAGES[0])
    assert len(traces) == 1


def test_gate_switches():
    node = Gate(stage(offset))
    for on in (0.0, 1.0):
        params = node.init() | {"use_offset": type(node.init()["use_offset"])(on=np.float32(on))}
        np.testing.assert_allclose(run(node, params, IMAGES[0]), IMAGES[0] + 0.25 * on, rtol=1e-6)
        slope = jax.grad(lambda p: run(node, p, IMAGES[0]).sum())(params)["offset"].value
        assert slope == pytest.approx(IMAGES[0].size * on)


def test_shuffle_runs_every_order():
    node = Shuffle((stage(square), stage(gain), stage(offset)))
    steps = {"square": lambda x: x**2, "gain": lambda x: 2 * x, "offset": lambda x: x + 0.25}
    for order in itertools.permutations(range(3)):
        priority = np.empty(3, np.float32)
        priority[list(order)] = [0.1, 0.5, 0.9]
        want = IMAGES[0]
        for i in order:
            want = list(steps.values())[i](want)
        params = node.init() | {"order": type(node.init()["order"])(priority=priority)}
        np.testing.assert_allclose(run(node, params, IMAGES[0]), want, rtol=1e-6)
    with pytest.raises(TypeError, match="orders 3 nodes"):
        run(
            node,
            node.init() | {"order": type(node.init()["order"])(priority=np.zeros(2, np.float32))},
            IMAGES[0],
        )


def test_dropping_a_stage_leaves_the_other_noise_bit_identical():
    chain = Chain((stage(grain, name="first"), stage(grain, name="second")))
    params = chain.init()
    zero = np.zeros((8, 9, 3), np.float32)
    both = run(chain, params | {"first": Grain(std=np.float32(0))}, zero, KEY)
    np.testing.assert_array_equal(run(chain.without("first"), params, zero, KEY), both)
    moved = Chain((Gate(stage(grain, name="second")),))
    np.testing.assert_array_equal(run(moved, params | moved.init(), zero, KEY), both)
    first = run(chain.without("second"), params, zero, KEY)
    assert not np.array_equal(first, both)


def test_batch_equals_loop_and_map():
    params = CHAIN.init() | {"gain": Gain(factor=np.linspace(1, 2, 4, dtype=np.float32))}
    batch = run_batch(CHAIN, params, IMAGES, KEY, 10)
    keys = [jax.random.fold_in(KEY, 10 + i) for i in range(4)]
    for i in range(4):
        one = params | {"gain": Gain(factor=params["gain"].factor[i])}
        np.testing.assert_allclose(run(CHAIN, one, IMAGES[i], keys[i]), batch[i], atol=1e-5)
    mapped = jax.lax.map(
        lambda a: CHAIN(params | {"gain": Gain(factor=a[0])}, a[1], key=a[2]),
        (params["gain"].factor, IMAGES, jnp.stack(keys)),
    )
    np.testing.assert_allclose(mapped, batch, atol=1e-5)


@pytest.mark.optimised
def test_a_sample_has_the_same_bits_at_any_batch_size():
    params = CHAIN.init()
    whole = np.asarray(run_batch(CHAIN, params, IMAGES, KEY, 0))
    for size in (1, 2, 3):
        parts = [run_batch(CHAIN, params, IMAGES[i : i + size], KEY, i) for i in range(0, 4, size)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_switches_and_orders_per_image():
    """Values, bits at any batch size and gradients are those of one image at a time."""
    node = Chain((Gate(stage(offset)), Shuffle((stage(square), stage(gain)))))
    base = node.init()
    per_image = {
        "use_offset": type(base["use_offset"])(on=np.float32([0, 1, 1, 0])),
        "order": type(base["order"])(priority=np.float32([[0, 1], [1, 0], [0, 1], [1, 0]])),
    }
    whole = np.asarray(run_batch(node, base | per_image, IMAGES))
    slopes = jax.grad(lambda p: jnp.sum(run_batch(node, p, IMAGES) ** 2))(base | per_image)
    each = []
    for i in range(4):
        own = base | {name: jax.tree.map(lambda v, i=i: v[i], value) for name, value in per_image.items()}
        np.testing.assert_allclose(run(node, own, IMAGES[i]), whole[i], rtol=1e-6)
        each.append(jax.grad(lambda p, i=i: jnp.sum(run(node, p, IMAGES[i]) ** 2))(own)["offset"].value)
        alone = base | {name: jax.tree.map(lambda v, i=i: v[i : i + 1], v) for name, v in per_image.items()}
        np.testing.assert_array_equal(run_batch(node, alone, IMAGES[i : i + 1])[0], whole[i])
    np.testing.assert_allclose(slopes["offset"].value, sum(each), rtol=1e-5)
    assert each[0] == 0 != each[1]


@pytest.mark.optimised
def test_a_sample_has_the_same_bits_on_eight_devices():
    assert jax.device_count() == 8
    images = np.concatenate([IMAGES, IMAGES])
    sharding = NamedSharding(Mesh(np.array(jax.devices()), ("batch",)), PartitionSpec("batch"))
    sharded = run_batch(CHAIN, CHAIN.init(), jax.device_put(images, sharding), KEY)
    assert len(sharded.sharding.device_set) == 8
    np.testing.assert_array_equal(sharded, run_batch(CHAIN, CHAIN.init(), images, KEY))


def test_noise_needs_a_key():
    with pytest.raises(TypeError, match="pass key"):
        stage(grain)(stage(grain).init(), jnp.asarray(IMAGES[0]))


def test_errors_at_build_name_the_fault():
    with pytest.raises(TypeError, match=r"unsharp_mask has no option 'radios'; is it radius\?"):
        stage(unsharp_mask, radios=3)
    with pytest.raises(KeyError, match="no stage named 'sharpen'"):
        stage("sharpen")
    with pytest.raises(ValueError, match="several are named gain"):
        Chain((stage(gain), stage(gain)))
    with pytest.raises(ValueError, match=r"'unsharp_mask' takes any three channels, but .* gives mosaic"):
        Chain((stage(gray), stage(unsharp_mask)))
    with pytest.raises(ValueError, match=r"'gray' takes linear sRGB, but .* gives encoded sRGB"):
        Chain((stage(encode), stage(square), stage(gray)))
    with pytest.raises(ValueError, match="keeps its domain: 'encode'"):
        Gate(stage(encode))
    with pytest.raises(TypeError, match="params lacks 'gain', a Gain"):
        run(stage(gain), {}, IMAGES[0])
    with pytest.raises(InputError, match="has no stage 'sharpen'"):
        CHAIN.without("sharpen")


def test_the_domains_of_a_chain():
    assert Chain((stage(gain), stage(encode))).domain_in.name == "linear sRGB"
    assert Chain((stage(gain), stage(encode), stage(square))).domain_out.name == "encoded sRGB"
    assert Chain((stage(gain),)).domain_in.channels == 3


def test_declarations_are_checked():
    def no_default(image: RGB, *, radius: int) -> RGB:
        return image

    def no_domain(image: jax.Array) -> jax.Array:
        return image

    def odd_arguments(picture: RGB) -> RGB:
        return picture

    for fn, message in (
        (no_default, "needs a default"),
        (no_domain, "domain"),
        (odd_arguments, "positional"),
    ):
        with pytest.raises(TypeError, match=message):
            signature(fn)
    with pytest.raises(ValueError, match="registered already"):
        clash = typing.cast(typing.Any, lambda image: image)
        clash.__name__ = "unsharp_mask"
        register(clash)


def test_a_cell_that_is_run_again_replaces_its_stage():
    def define(power):
        def edited(image: RGB) -> RGB:
            return image**power

        return register(edited)

    first = define(2)
    try:
        assert stage("edited").fn is first
        again = define(3)
        assert stage("edited").fn is again is not first
        again.__module__ = "elsewhere"
        with pytest.raises(ValueError, match="registered already"):
            define(4)
    finally:
        del REGISTRY["edited"]


def test_batches_without_images_and_images_without_pixels():
    node = Chain((Gate(stage(offset)),))
    switch = type(node.init()["use_offset"])(on=np.zeros(0, np.float32))
    assert run_batch(node, node.init() | {"use_offset": switch}, IMAGES[:0]).shape == (0, 9, 14, 3)
    for nothing in (IMAGES[:, :0], IMAGES[:, :, :0]):
        with pytest.raises(ValueError, match="chain: pictures without pixels, of shape"):
            run_batch(node, node.init(), nothing)


def test_sections_of_a_docstring():
    found = sections(unsharp_mask)
    assert found["Summary"].startswith("Add what a Gaussian blur")
    assert "radius:" in found["Args"] and found["Source"].endswith("2000.")


def test_static_options_are_listed_with_defaults():
    assert stage(unsharp_mask).options == {"radius": 12}
    assert Stage(unsharp_mask, "u", (("radius", 3),)).options == {"radius": 3}
    assert isinstance(stage(unsharp_mask).init()["unsharp_mask"], UnsharpMask)
    assert stage(square, power=np.int64(3)).static == (("power", 3),)

    def weighted(image: RGB, *, weights: tuple[int, ...] = (1,)) -> RGB:
        return image

    assert stage(weighted, weights=np.array([1, 2])).static == (("weights", (1, 2)),)


def test_gradient_of_a_whole_chain_matches_finite_differences(x64):
    rng = np.random.default_rng(0)
    params = jax.tree.map(lambda v: np.asarray(v, np.float64), CHAIN.init())
    image = IMAGES[0].astype(np.float64)
    weights = rng.standard_normal(image.shape)
    loss = jax.jit(lambda p: jnp.sum(CHAIN(p, image, key=KEY) * weights))
    grads = jax.grad(loss)(params)
    for name, field in (("gain", "factor"), ("offset", "value"), ("first", "std"), ("unsharp_mask", "sigma")):
        h = 1e-6
        ends = [
            float(
                loss(
                    params
                    | {
                        name: type(params[name])(
                            **(vars(params[name]) | {field: getattr(params[name], field) + d})
                        )
                    }
                )
            )
            for d in (h, -h)
        ]
        np.testing.assert_allclose(getattr(grads[name], field), (ends[0] - ends[1]) / (2 * h), rtol=1e-5)
