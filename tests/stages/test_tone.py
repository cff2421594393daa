"""Tone curves: closed forms, inverses, monotone, finite slopes, luma with the chroma kept."""

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxisp.params import specs
from jaxisp.pipeline import Chain, run, signature, stage
from jaxisp.stages import STAGES
from jaxisp.stages.power import Gamma
from jaxisp.stages.tone import (
    Gray18Gamma,
    HighlightRolloff,
    SCurve,
    ToneCurve,
    ZoneCurve,
)
from jaxisp.testing import smooth_image

RAMP = np.linspace(0, 1, 301)
WIDE = np.sort(np.concatenate([np.linspace(-1, 3, 301), [0.0, 1e-4, 1e-3, 1.0]]))
ON_LUMA = ("s_curve", "inverse_s_curve", "tone_curve", "zone_curve", "gray18_gamma", "highlight_rolloff")
CURVES = ("gamma_compression", "gamma_expansion", *ON_LUMA)


def as_image(values) -> np.ndarray:
    return np.stack([np.asarray(values)] * 3, -1)[None]


def curve(name: str, values: np.ndarray, params) -> np.ndarray:
    """The stage's curve, on channels: grey images make luma and channels the same."""
    return np.asarray(run(stage(name), {name: params}, as_image(values)))[0, :, 0]


def slopes(name: str, at, params) -> np.ndarray:
    """The derivative of the stage's curve at each of these levels of grey."""

    @jax.jit
    def slope(x, p):
        return jax.jvp(lambda v: stage(name)({name: p}, v), (x,), (jnp.ones_like(x),))[1]

    return np.asarray(slope(jnp.asarray(as_image(at)), params))[0, :, 0]


def at_share(name: str, share: float):
    """Parameters of a curve at a share of their bounds, double precision."""
    cls = signature(STAGES[name]).params
    values = {}
    for field, spec in specs(cls).items():
        low, high = spec.bounds
        values[field] = np.full(spec.shape, low + share * (high - low))
    return cls(**values)


@pytest.mark.parametrize("gamma", [0.6, 1.0, 1.8, 2.2, 4.0])
def test_gamma_is_the_power_above_the_toe(gamma, x64):
    values = np.concatenate([np.geomspace(1e-3, 1, 50), [2.0]])
    params = Gamma(gamma=np.float64(gamma))
    np.testing.assert_allclose(curve("gamma_compression", values, params), values ** (1 / gamma), rtol=1e-12)
    encoded = values ** (1 / gamma)
    np.testing.assert_allclose(curve("gamma_expansion", encoded, params), values, rtol=1e-11)
    toe = curve("gamma_compression", np.array([0.0, 5e-4]), params)
    assert toe[0] == 0 and 0 < toe[1] < 1e-3 ** (1 / gamma)


@pytest.mark.parametrize("gamma", [0.6, 1.0, 2.2, 4.0])
def test_gamma_there_and_back(gamma, x64):
    params = Gamma(gamma=np.float64(gamma))
    values = np.concatenate([WIDE, np.linspace(-2e-3, 2e-3, 41)])
    out = curve("gamma_expansion", curve("gamma_compression", values, params), params)
    np.testing.assert_allclose(out, values, atol=1e-12)


def test_gamma_there_and_back_in_single_precision():
    values = np.concatenate([RAMP, np.linspace(-2e-3, 2e-3, 41)]).astype(np.float32)
    for gamma in (0.6, 2.2, 4.0):
        params = Gamma(gamma=np.float32(gamma))
        out = curve("gamma_expansion", curve("gamma_compression", values, params), params)
        np.testing.assert_allclose(out, values, atol=3e-6)


def test_gamma_slope_at_black_is_bounded_and_continuous(x64):
    params = Gamma(gamma=np.float64(2.2))
    below, at, above = slopes("gamma_compression", [1e-3 - 1e-9, 0.0, 1e-3 + 1e-9], params)
    np.testing.assert_allclose(below, above, rtol=1e-5)
    p = 1 / 2.2
    np.testing.assert_allclose(at, (2 - p) * 1e-3 ** (p - 1), rtol=1e-9)


def test_s_curve_is_the_rational_one_and_passes_its_points(x64):
    params = SCurve(strength=np.log(2.0), midpoint=np.float64(0.4))
    out = curve("s_curve", np.array([0.0, 0.1, 0.2, 0.4, 0.7, 1.0]), params)
    # t = 1/4, 1/2 below; t = 1/2 above; h = t / (t + 2 (1 - t))
    np.testing.assert_allclose(out, [0, 0.4 / 7, 0.4 / 3, 0.4, 1 - 0.6 / 3, 1], atol=1e-12)
    np.testing.assert_allclose(slopes("s_curve", [0.4 - 1e-9, 0.4 + 1e-9], params), 2.0, rtol=1e-6)
    np.testing.assert_allclose(slopes("s_curve", [0.0, 1.0, -1.0, 2.0], params), 0.5, rtol=1e-9)


@pytest.mark.parametrize("on", ["channels", "luma"])
@pytest.mark.parametrize("strength", [-2.0, 0.7, 2.0])
def test_s_curve_there_and_back(on, strength, x64):
    image = 3 * smooth_image((9, 13, 3)) - 1
    params = SCurve(strength=np.float64(strength), midpoint=np.float64(0.3))
    chain = Chain((stage("s_curve", on=on), stage("inverse_s_curve", on=on)))
    out = run(chain, {"s_curve": params, "inverse_s_curve": params}, image)
    np.testing.assert_allclose(out, image, atol=1e-12)


def test_tone_curve_is_the_cubic_through_five_points(x64):
    for amount in (-0.9, 0.2, 0.45):
        a = 0.2 * amount
        out = curve("tone_curve", np.array([0, 0.25, 0.5, 0.75, 1]), ToneCurve(amount=np.float64(amount)))
        np.testing.assert_allclose(out, [0, 0.25 - a, 0.5, 0.75 + a, 1], atol=1e-12)
        cubic = np.polyval([-64 * a / 3, 32 * a, 1 - 32 * a / 3, 0], RAMP)
        got = curve("tone_curve", RAMP, ToneCurve(amount=np.float64(amount)))
        np.testing.assert_allclose(got, cubic, atol=1e-12)


@pytest.mark.parametrize("zones", [1, 3, 7])
def test_zone_curve_is_piecewise_linear(zones, x64):
    offsets = np.random.default_rng(zones).uniform(-0.5, 0.5, zones)
    x = np.arange(zones + 2) / (zones + 1)
    y = x + np.concatenate([[0], offsets, [0]]) / (zones + 1)
    got = curve("zone_curve", WIDE, ZoneCurve(offsets=offsets))
    want = np.where((WIDE < 0) | (WIDE > 1), WIDE, np.interp(WIDE, x, y))
    np.testing.assert_allclose(got, want, atol=1e-12)


def test_zone_curve_works_and_each_knot_has_a_gradient():
    """The published one had no effect at all."""
    image = smooth_image((9, 13, 3)).astype(np.float32)
    params = ZoneCurve(offsets=np.float32([-0.4, -0.4, 0.0]))
    assert np.abs(run(stage("zone_curve"), {"zone_curve": params}, image) - image).max() > 0.09
    ramp = jnp.asarray(np.stack([RAMP.astype(np.float32)] * 3, -1)[None])
    grad = jax.grad(lambda p: stage("zone_curve")({"zone_curve": p}, ramp).mean())(params)
    np.testing.assert_allclose(grad.offsets, 1 / 16, rtol=2e-2)  # a tent of height and half-width 1/4


@pytest.mark.parametrize("gamma", [0.4, 1.0, 1.6])
def test_gray18_gamma_turns_about_middle_grey(gamma, x64):
    values = np.array([2e-4, 0.01, 0.18, 1.0, 3.0])
    got = curve("gray18_gamma", values, Gray18Gamma(gamma=np.float64(gamma)))
    np.testing.assert_allclose(got, 0.18 ** (1 - gamma) * values**gamma, rtol=1e-12)
    np.testing.assert_allclose(got[2], 0.18, rtol=1e-12)


def test_highlight_rolloff_is_reinhards_above_start(x64):
    params = HighlightRolloff(start=np.float64(0.5), white=np.float64(2.0))
    values = np.array([-0.5, 0.0, 0.3, 0.5, 1.0, 2.0])
    # t = 1 at x = 1 and w = 3: 0.5 + 0.5 * (1 + 1/9) / 2
    want = [-0.5, 0.0, 0.3, 0.5, 0.5 + 0.5 * (10 / 9) / 2, 1.0]
    np.testing.assert_allclose(curve("highlight_rolloff", values, params), want, atol=1e-12)
    np.testing.assert_allclose(slopes("highlight_rolloff", [0.5 + 1e-9], params), 1.0, atol=1e-6)
    off = HighlightRolloff(start=np.float64(0.5), white=np.float64(1.0))
    np.testing.assert_allclose(curve("highlight_rolloff", WIDE, off), WIDE, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("s_curve", SCurve(strength=np.float32(0))),
        ("tone_curve", ToneCurve(amount=np.float32(0))),
        ("zone_curve", ZoneCurve(offsets=np.zeros(5, np.float32))),
        ("gray18_gamma", Gray18Gamma()),
        ("gamma_compression", Gamma(gamma=np.float32(1))),
        ("highlight_rolloff", HighlightRolloff(white=np.float32(1))),
    ],
)
def test_neutral_parameters_change_nothing(name, params):
    values = WIDE.astype(np.float32)
    np.testing.assert_allclose(curve(name, values, params), values, atol=1e-6)


@pytest.mark.parametrize("name", CURVES)
@given(share=st.floats(0, 1))
def test_curves_never_fall(name, share):
    with jax.enable_x64(True):
        out = curve(name, WIDE, at_share(name, share))
    assert (np.diff(out) >= -1e-12).all()


@given(offsets=st.lists(st.floats(-0.5, 0.5), min_size=4, max_size=4))
def test_zone_curve_never_falls(offsets):
    with jax.enable_x64(True):
        out = curve("zone_curve", WIDE, ZoneCurve(offsets=np.array(offsets)))
    assert (np.diff(out) >= -1e-12).all()


@pytest.mark.parametrize("name", CURVES)
def test_slopes_are_finite_where_it_is_delicate(name):
    at = np.float32([-1.0, -1e-3, -1e-30, 0.0, 1e-30, 1e-3, 1.0, 4.0])
    for share in (0.0, 0.4, 1.0):
        params = jax.tree.map(np.float32, at_share(name, share))
        got = slopes(name, at, params)
        assert np.isfinite(got).all() and (got >= 0).all()


@pytest.mark.parametrize("name", ON_LUMA)
def test_on_luma_keeps_the_chroma(name, x64):
    image = smooth_image((9, 13, 3))
    out = np.asarray(run(stage(name, on="luma"), {name: at_share(name, 0.7)}, image))
    before, after = (
        colour.RGB_to_YCbCr(x, K=colour.WEIGHTS_YCBCR["ITU-R BT.601"], out_legal=False) for x in (image, out)
    )
    np.testing.assert_allclose(after[..., 1:], before[..., 1:], atol=1e-12)
    want = curve(name, before[..., 0].ravel(), at_share(name, 0.7))
    np.testing.assert_allclose(after[..., 0].ravel(), want, atol=1e-12)


def test_unknown_target_is_refused():
    with pytest.raises(ValueError, match="hue"):
        stage("s_curve", on="hue")(stage("s_curve").init(), jnp.zeros((2, 3, 3)))
