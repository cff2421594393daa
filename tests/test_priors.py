"""Priors and draws, and pipelines through TOML."""

import tomllib

import jax
import numpy as np
import pytest
import tomli_w

from jaxisp.errors import InputError
from jaxisp.pipeline import Chain, Gate, Shuffle, Switch, stage
from jaxisp.priors import (
    Bernoulli,
    Choice,
    LogUniform,
    Normal,
    PowerUniform,
    Uniform,
    check_prior,
    draw,
)
from jaxisp.serialize import decode_node, decode_params, encode_node, encode_params
from jaxisp.stages.detail import UnsharpMask

N = 20_000


@pytest.mark.parametrize(
    ("distribution", "mean", "std"),
    [
        (Uniform(1, 3), 2, 2 / np.sqrt(12)),
        (LogUniform(0.01, 0.1), 0.09 / np.log(10), None),
        (PowerUniform(0, 0.2, 2), 0.04 / 3, None),
        (Normal(1, 0.5, -9, 9), 1, 0.5),
        (Bernoulli(0.3), 0.3, np.sqrt(0.21)),
        (Choice((4, 5, 6, 7)), 5.5, np.sqrt(1.25)),
    ],
)
def test_moments_and_support(distribution, mean, std):
    x = np.asarray(distribution.sample(jax.random.key(0), (N,)), np.float64)
    low, high = distribution.support
    assert low - 1e-6 <= x.min() and x.max() <= high + 1e-6
    assert abs(x.mean() - mean) < 4 * x.std() / np.sqrt(N)
    if std:
        assert x.std() == pytest.approx(std, rel=0.03)


LAWS = [
    Uniform(0.1, 0.3), LogUniform(0.01, 0.1), PowerUniform(0, 0.2, 2), PowerUniform(-0.5, 0.1, 3.0),
    Normal(0.1, 0.2, 0, 0.3), Bernoulli(0.3), Choice((0.1, 0.2, 0.4)),
]  # fmt: skip


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_draws_do_not_depend_on_x64(law):
    usual = np.asarray(law.sample(jax.random.key(2), (50,)))
    with jax.enable_x64(True):
        wide = np.asarray(law.sample(jax.random.key(2), (50,)))
    assert usual.dtype == wide.dtype == np.float32
    np.testing.assert_array_equal(wide, usual)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda: Uniform(0.2, 0.1), "low is above high"),
        (lambda: Uniform(float("nan"), 1), "must be finite"),
        (lambda: LogUniform(0, 1), "low must be positive"),
        (lambda: LogUniform(0.2, 0.1), "low is above high"),
        (lambda: PowerUniform(0.2, 0.1, 2), "low is above high"),
        (lambda: PowerUniform(0, 0.1, -1), "the exponent must be positive"),
        (lambda: PowerUniform(-0.5, 0.1, 0.5), "a negative low needs a whole exponent"),
        (lambda: Normal(0.1, 0, 0, 0.2), "std must be positive"),
        (lambda: Normal(0.1, 1, 0.2, 0), "low is above high"),
        (lambda: Bernoulli(1.5), "p must be from 0 to 1"),
        (lambda: Bernoulli(-0.1), "p must be from 0 to 1"),
        (lambda: Choice(()), "there must be a value"),
    ],
)
def test_what_is_no_distribution_is_refused(law, message):
    with pytest.raises(InputError, match=message):
        law()


@pytest.mark.parametrize(
    ("law", "support"),
    [
        (PowerUniform(-0.5, 0.1, 2), (0, 0.25)),
        (PowerUniform(-0.5, 0.1, 3), (-0.125, 0.001)),
        (PowerUniform(-0.5, -0.1, 2), (0.01, 0.25)),
    ],
)
def test_powers_of_negative_numbers(law, support):
    assert law.support == pytest.approx(support)
    drawn = np.asarray(law.sample(jax.random.key(0), (1000,)))
    assert support[0] - 1e-6 <= drawn.min() < drawn.max() <= support[1] + 1e-6
    check_prior({"m": UnsharpMask(amount=PowerUniform(-0.5, 0.1, 2))})  # within [0, 4]
    with pytest.raises(InputError, match=r"m.amount: \[0, inf\] is not within"):
        check_prior({"m": UnsharpMask(amount=PowerUniform(0, 1e300, 2))})


def test_draws_do_not_depend_on_what_else_is_drawn():
    few = {"a": UnsharpMask(amount=Uniform(0, 1))}
    more = {"b": UnsharpMask(sigma=LogUniform(0.5, 2)), "a": UnsharpMask(amount=Uniform(0, 1), sigma=2.0)}
    key = jax.random.key(1)
    first, second = draw(key, few), draw(key, more)
    assert first["a"].amount == second["a"].amount
    assert second["a"].sigma == 2 and second["b"].sigma != second["a"].amount


def test_draws_take_the_shape_of_the_parameter_and_are_independent():
    drawn = jax.vmap(lambda k: draw(k, {"m": UnsharpMask(amount=Uniform(0, 1), sigma=Uniform(1, 2))}))(
        jax.random.split(jax.random.key(0), 4000)
    )["m"]
    assert drawn.amount.shape == (4000,)
    assert abs(np.corrcoef(drawn.amount, drawn.sigma)[0, 1]) < 4 / np.sqrt(4000)


def test_a_prior_must_stay_within_bounds():
    with pytest.raises(InputError, match=r"m.amount: \[0, 9\] is not within \[0, 4\]"):
        check_prior({"m": UnsharpMask(amount=Uniform(0, 9))})
    with pytest.raises(InputError, match="is not within"):
        check_prior({"m": UnsharpMask(amount=5.0)})


PIPELINE = Chain(
    (
        stage("unsharp_mask", radius=6),
        Gate(stage("unsharp_mask", name="again")),
        Shuffle((stage("unsharp_mask", name="a"), stage("unsharp_mask", name="b", radius=3)), "which_first"),
    ),
    "look",
)


def test_pipeline_and_priors_go_to_toml_and_back_unchanged():
    prior = PIPELINE.init() | {
        "unsharp_mask": UnsharpMask(amount=Uniform(0, 0.25), sigma=0.1, threshold=np.float32(1 / 30)),
        "again": UnsharpMask(
            amount=Normal(1, 0.2, 0, 2), sigma=LogUniform(0.5, 2), threshold=Choice((0, 0.1))
        ),
        "use_again": Switch(on=Bernoulli(0.5)),
    }
    text = tomli_w.dumps({"pipeline": encode_node(PIPELINE), "params": encode_params(prior)})
    tables = tomllib.loads(text)
    assert decode_node(tables["pipeline"]) == PIPELINE
    back = decode_params(tables["params"], PIPELINE)
    assert encode_params(back) == tables["params"]
    assert jax.tree.structure(back) == jax.tree.structure(prior)
    for got, want in zip(jax.tree.leaves(back), jax.tree.leaves(prior)):
        assert (
            got == want if not isinstance(want, np.ndarray | float) else np.array_equal(got, np.float32(want))
        )


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"stage": "sharpen"}, "no stage named 'sharpen'"),
        ({"stage": "unsharp_mask", "options": {"radios": 1}}, "no option 'radios'"),
        ({"stage": "unsharp_mask", "gate": {}}, "must have one of"),
        ({"stage": "unsharp_mask", "colour": 1}, "must have one of"),
        ("jpeg", "must be a table"),
        ({"chain": [{"stage": "unsharp_mask"}, {"stage": "unsharp_mask"}]}, "several are named unsharp_mask"),
        ({"stage": 5}, "stage must be text, got 5"),
        ({"stage": "unsharp_mask", "name": 5}, "name must be text, got 5"),
        ({"gate": {"stage": "unsharp_mask"}, "name": 5}, "name must be text, got 5"),
        ({"stage": "unsharp_mask", "options": [1]}, r"options must be a table, got \[1\]"),
        ({"stage": "unsharp_mask", "options": {"radius": 2.5}}, "option radius must be int, got 2.5"),
        (
            {"stage": "unsharp_mask", "options": {"radius": {"a": 1}}},
            "option radius must be int, got {'a': 1}",
        ),
        (
            {"stage": "rounding", "options": {"bits": "eight"}},
            "rounding: option bits must be int, got 'eight'",
        ),
        ({"stage": "rounding", "options": {"legacy": "no"}}, "option legacy must be bool, got 'no'"),
        ({"stage": "rounding", "options": {"bits": True}}, "option bits must be int, got True"),
        ({"stage": "clip", "options": {"low": "x"}}, "option low must be float, got 'x'"),
    ],
)
def test_a_broken_pipeline_is_refused(node, message):
    with pytest.raises(InputError, match=message):
        decode_node(node)


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"blur": {}}, "params.blur: the pipeline has no stage"),
        ({"a": {"width": 1}}, r"params.a: takes \['amount'"),
        ({"a": {"amount": 9.0}}, "a.amount = 9"),
        ({"a": {"amount": float("nan")}}, "a.amount = nan"),
        ({"a": {"amount": {"uniform": [0, 9]}}}, "a.amount"),
        ({"a": {"amount": {"uniform": [0]}}}, "one of uniform"),
        (
            {"a": {"amount": {"uniform": [1, 0]}}},
            r"a.amount: Uniform\(low=1.0, high=0.0\): low is above high",
        ),
        ({"a": {"amount": {"choice": []}}}, "a.amount: .* there must be a value"),
        ({"which_first": {"priority": []}}, "which_first.priority holds no number"),
        ({"a": {"amount": {"gauss": [0, 1]}}}, "one of uniform"),
        ({"a": {"amount": "much"}}, "one of uniform"),
        ({"a": {"amount": {"uniform": [0, float("nan")]}}}, "one of uniform"),
        ({"a": {"amount": [1.0, 2.0, 3.0, 4.0]}}, "a.amount"),
    ],
)
def test_broken_parameters_are_refused(params, message):
    with pytest.raises(InputError, match=message):
        decode_params(params, PIPELINE)
