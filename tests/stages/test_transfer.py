"""Transfer functions against colour-science, there and back, and their slopes where it is delicate."""

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.color import linear_to_srgb, srgb_to_linear
from jaxisp.pipeline import REGISTRY, run, stage

REFERENCES = {
    "srgb_oetf": colour.models.eotf_inverse_sRGB,
    "srgb_eotf": colour.models.eotf_sRGB,
    "rec709_oetf": colour.models.oetf_BT709,
    "rec709_eotf": colour.models.oetf_inverse_BT709,
    "prophoto_oetf": colour.models.cctf_encoding_ROMMRGB,
    "prophoto_eotf": colour.models.cctf_decoding_ROMMRGB,
}
POWERS = {"gamma22_oetf": 1 / 2.2, "gamma22_eotf": 2.2}
PAIRS = [("srgb_oetf", "srgb_eotf"), ("rec709_oetf", "rec709_eotf"), ("prophoto_oetf", "prophoto_eotf")]
RAMP = np.concatenate([np.geomspace(1e-5, 1, 150), np.linspace(0, 1, 150)])


def as_image(values: np.ndarray) -> np.ndarray:
    return np.stack([np.asarray(values)] * 3, -1)[None]


def curve(name: str, values: np.ndarray, **static) -> np.ndarray:
    return np.asarray(run(stage(name, **static), {}, as_image(values)))[0, :, 0]


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_matches_colour_science(name, x64):
    np.testing.assert_allclose(curve(name, RAMP), REFERENCES[name](RAMP), atol=1e-7)


def test_the_curve_without_a_device_is_the_same():
    np.testing.assert_allclose(linear_to_srgb(RAMP), REFERENCES["srgb_oetf"](RAMP), atol=1e-7)
    np.testing.assert_allclose(srgb_to_linear(RAMP), REFERENCES["srgb_eotf"](RAMP), atol=1e-7)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_single_precision_matches_colour_science(name):
    ramp = RAMP.astype(np.float32)
    np.testing.assert_allclose(curve(name, ramp), REFERENCES[name](ramp.astype(np.float64)), atol=1e-6)


@pytest.mark.parametrize(("there", "back"), PAIRS)
def test_there_and_back(there, back, x64):
    values = np.concatenate([-RAMP, RAMP, [4.0, -3.0]])
    np.testing.assert_allclose(curve(back, curve(there, values)), values, atol=1e-12)


@pytest.mark.parametrize(("there", "back"), PAIRS)
def test_there_and_back_in_single_precision(there, back):
    values = np.concatenate([-RAMP, RAMP]).astype(np.float32)
    np.testing.assert_allclose(curve(back, curve(there, values)), values, atol=1e-6)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_is_odd_rises_and_goes_on_above_white(name, x64):
    values = np.sort(np.concatenate([RAMP, np.linspace(1, 4, 50)]))
    out = curve(name, values)
    np.testing.assert_array_equal(curve(name, -values), -out)
    rising = np.diff(out) >= 0
    if name == "rec709_eotf":  # the standard's step
        rising |= abs(values[1:] - 0.0812) < 1e-2
    assert rising.all()
    assert curve(name, np.array([0.0]))[0] == 0
    np.testing.assert_allclose(curve(name, np.array([1.0])), 1.0, atol=1e-12)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_slope_at_black_at_white_and_below(name, x64):
    slope = jax.jit(jax.vmap(jax.grad(lambda x: stage(name)({}, jnp.full((1, 1, 3), x))[0, 0, 0])))
    at = np.array([0.0, 1e-9, 1.0, -0.5, -1e-4, 2.0])
    got = slope(jnp.asarray(at))
    h = 1e-7 * np.maximum(np.abs(at), 1e-2)
    want = (curve(name, at + h) - curve(name, at - h)) / (2 * h)
    np.testing.assert_allclose(got, want, rtol=1e-5)
    linear = {"srgb": 12.92, "rec709": 4.5, "prophoto": 16.0}[name.split("_")[0]]
    assert abs(got[0] - (linear if name.endswith("oetf") else 1 / linear)) < 1e-9


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_slope_in_single_precision_is_finite_and_positive(name):
    node, at = stage(name), jnp.float32([0.0, -0.0, 1.0, -1.0, 1e-30, -1e-30, 1e-42, 4.0])
    slope = jax.jit(jax.vmap(jax.grad(lambda x: node({}, jnp.full((1, 1, 3), x))[0, 0, 0])))(at)
    assert (np.isfinite(slope) & (np.asarray(slope) > 0)).all()


def test_every_transfer_function_has_a_reference():
    names = {n for n, fn in REGISTRY.items() if fn.__module__ == "jaxisp.stages.transfer"}
    assert names == {*REFERENCES, *POWERS}


@pytest.mark.parametrize("name", sorted(POWERS))
def test_a_power_is_flat_below_its_darkest_value(name, x64):
    values = np.concatenate([-RAMP, RAMP, [4.0]])
    np.testing.assert_allclose(curve(name, values), np.maximum(values, 1e-8) ** POWERS[name], rtol=1e-9)
    node = stage(name)
    slope = jax.jit(jax.vmap(jax.grad(lambda x: node({}, jnp.full((1, 1, 3), x))[0, 0, 0])))
    at = np.array([0.01, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(slope(jnp.asarray(at)), POWERS[name] * at ** (POWERS[name] - 1), rtol=1e-6)


def test_legacy_curves_are_the_published_formulas(x64):
    out = curve("srgb_oetf", RAMP, legacy=True)
    want = np.where(RAMP <= 0.0031308, 12.92 * RAMP, 1.055 * (RAMP + 0.001) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(out, want, atol=1e-12)
    out = curve("srgb_eotf", RAMP, legacy=True)
    want = np.where(RAMP <= 0.04045, RAMP / 12.92, (RAMP + 0.055) ** 2.4 / 1.055)
    np.testing.assert_allclose(out, want, atol=1e-12)


def test_legacy_inverse_is_too_bright_and_takes_negatives():
    """Published: linear 0.5 comes back as 0.540."""
    half = curve("srgb_eotf", curve("srgb_oetf", np.float32([0.5]), legacy=True), legacy=True)
    assert abs(half[0] - 0.540) < 5e-4
    for name in ("srgb_oetf", "srgb_eotf"):
        node = stage(name, legacy=True)
        slope = jax.grad(lambda x, node=node: node({}, jnp.full((1, 1, 3), x))[0, 0, 0])
        assert np.isfinite(jax.jit(jax.vmap(slope))(jnp.float32([-1.0, -0.001, 0.0, 1.0]))).all()
