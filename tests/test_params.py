"""Parameter classes: trees, bounds, bijector, host checks."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxisp.checks import InputError, check_finite, check_params
from jaxisp.params import (
    Leaf,
    batch_axes,
    bounds_to_line,
    line_to_bounds,
    param,
    parameters,
    spec_tree,
    strong,
    to_bounded,
    to_unbounded,
)


@parameters
class Lens:
    strength: Leaf = param(0.5, (0.0, 2.0), "1", doc="share")
    sigma: Leaf = param(1.0, (0.1, 10.0), "px", log=True, doc="width")
    gains: Leaf = param((1.0, 2.0, 3.0), (0.5, 4.0), "1", doc="per channel")
    knots: Leaf = param((0.0, 0.0), (-1.0, 1.0), "1", any_length=True, doc="offsets")


def test_defaults_are_strong_float32():
    for leaf in jax.tree.leaves(Lens()):
        assert leaf.dtype == np.float32
    assert not any(jax.numpy.asarray(v).weak_type for v in jax.tree.leaves(strong(Lens(strength=1.5))))


def test_tree_keeps_field_names_and_shape():
    paths = [jax.tree_util.keystr(p) for p, _ in jax.tree_util.tree_leaves_with_path(Lens())]
    assert paths == [".strength", ".sigma", ".gains", ".knots"]
    assert spec_tree({"lens": Lens()})["lens"].sigma.unit == "px"


@given(st.floats(0.001, 1.999), st.floats(0.1002, 9.98))
def test_bijector_round_trip(strength, sigma):
    tree = {"lens": strong(Lens(strength=strength, sigma=sigma))}
    back = to_bounded(to_unbounded(tree))["lens"]
    np.testing.assert_allclose(back.strength, strength, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(back.sigma, sigma, rtol=1e-3)
    np.testing.assert_allclose(back.gains, tree["lens"].gains, rtol=1e-5)


@given(st.floats(-1e4, 1e4))
def test_bijector_stays_within_bounds(u):
    tree = jax.tree.map(lambda v: np.full(np.shape(v), u, np.float32), {"lens": Lens()})
    check_params(to_bounded(tree))


def test_bijector_is_finite_on_the_bounds():
    tree = {"lens": strong(Lens(strength=0.0, sigma=10.0))}
    assert all(np.isfinite(v).all() for v in jax.tree.leaves(to_unbounded(tree)))


def test_numbers_of_several_scales_at_once_are_those_of_each_alone():
    """Also where a number on a linear scale would be infinite on the other."""
    known = (0.0, 2.0, False), (0.1, 10.0, True), (-1e4, 1e4, False)
    low, high, log = map(np.asarray, zip(*known))
    values = np.asarray([0.3, -1.2, 2.5], np.float32)
    there = line_to_bounds(values, low, high, log)
    alone = [float(line_to_bounds(v, *own)) for v, own in zip(values, known)]
    np.testing.assert_allclose(there, alone, rtol=1e-6)
    assert float(bounds_to_line(1, *known[1])) == float(bounds_to_line(1.0, *known[1])), "a whole number"
    back = [float(bounds_to_line(v, *own)) for v, own in zip(there, known)]
    np.testing.assert_allclose(bounds_to_line(there, low, high, log), back, rtol=1e-6)
    np.testing.assert_allclose(back, values, rtol=1e-4)
    slopes = jax.jacobian(lambda v: line_to_bounds(v, low, high, log))(values)
    assert np.isfinite(slopes).all() and (np.diagonal(slopes) > 0).all()


def test_batch_axes():
    tree = {"lens": strong(Lens(strength=np.ones(5), gains=np.ones((5, 3))))}
    axes = batch_axes(tree)["lens"]
    assert (axes.strength, axes.sigma, axes.gains, axes.knots) == (0, None, 0, None)
    with pytest.raises(ValueError, match="shape"):
        batch_axes({"lens": Lens(gains=np.float32(1))})


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (Lens(strength=2.5), r"lens.strength = 2.5 is outside \[0, 2\]"),
        (Lens(sigma=float("nan")), r"lens.sigma = nan is outside \[0.1, 10\] px"),
        (Lens(gains=(1.0, 2.0)), r"lens.gains: shape \(2,\), expected \(3,\)"),
        (Lens(strength=np.ones((2, 2))), "lens.strength: shape"),
    ],
)
def test_check_params_names_what_is_wrong(bad, message):
    with pytest.raises(InputError, match=message):
        check_params({"lens": bad})


def test_check_params_accepts_bounds_batches_and_any_length():
    good = Lens(strength=2.0, sigma=0.1, gains=np.ones((7, 3)), knots=np.zeros(9))
    out = check_params({"lens": good})["lens"]
    assert all(v.dtype == np.float32 for v in jax.tree.leaves(out))


def test_check_finite():
    with pytest.raises(InputError, match=r"x.npy: holds 1 NaN"):
        check_finite("x.npy", np.array([1.0, np.nan]))


@pytest.mark.parametrize(
    "arguments",
    [(1.0, (0.0, float("inf")), "1"), (1.0, (2.0, 1.0), "1"), (3.0, (0.0, 1.0), "1")],
)
def test_param_refuses_bad_declarations(arguments):
    with pytest.raises(ValueError, match="param"):
        param(*arguments)


def test_parameters_refuses_plain_fields():
    with pytest.raises(TypeError, match="declare it with param"):

        @parameters
        class Bad:
            x: float = 1.0
