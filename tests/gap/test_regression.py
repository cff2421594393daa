"""Where a residual lies: one that lives on an axis puts that axis first, and noise puts none."""

import json

import numpy as np
import pytest
from scipy.fft import dctn, idctn
from scipy.ndimage import uniform_filter

from jaxisp.gap.axes.regression import where
from jaxisp.gap.simulator.effects import AXES
from tests.gap.scenes import scenes

PICTURE = scenes(np.random.default_rng(5), 5, (112, 128))
Y, CB, CR = np.moveaxis(PICTURE, -1, 0)
N, H, W = Y.shape
ROW, COLUMN = np.mgrid[:H, :W]
OFF_Y, OFF_X = (ROW - (H - 1) / 2) / H, (COLUMN - (W - 1) / 2) / H
ZERO = np.zeros_like(Y)


def luma(a):
    return np.stack([a + ZERO, ZERO, ZERO], -1)


def chroma(cb, cr):
    return np.stack([ZERO, cb, cr], -1)


def beside(a, dy, dx):
    return np.roll(a, (dy, dx), (1, 2))


def second(a, dy, dx):
    return beside(a, dy, dx) + beside(a, -dy, -dx) - 2 * a


def around(a, size):
    return uniform_filter(a, (0, size, size))


def without_curve(a):
    """Less the curve of luma that fits it best, which the tone curve of any fitted base has taken up."""
    return a - np.polyval(np.polyfit(Y.ravel() / 255, a.ravel(), 3), Y / 255)


def quantized(a, step=24):
    blocks = a.reshape(N, H // 8, 8, W // 8, 8)
    coefficients = np.round(dctn(blocks, axes=(2, 4), norm="ortho") / step) * step
    return idctn(coefficients, axes=(2, 4), norm="ortho").reshape(a.shape)


def residuals(rng):
    """(axis, residual) pairs, each by the axis's own definition."""
    square = (OFF_Y**2 + OFF_X**2)[None, ..., None]
    angle = np.arctan2(CR, CB)
    white = rng.normal(size=Y.shape)
    down, right = np.gradient(Y, axis=1), np.gradient(Y, axis=2)
    checker = 1 - 2 * ((ROW + COLUMN) % 2)
    return [
        ("radius", -0.3 * square * PICTURE),
        ("radius", chroma(2 * (down * OFF_Y + right * OFF_X), -2 * (down * OFF_Y + right * OFF_X))),
        ("intensity", luma(6 * np.sin(Y / 255 * 3 * np.pi))),
        ("channel", chroma(0.03 * Y, -0.02 * Y)),
        ("hue", chroma(-0.2 * CR * np.sin(2 * angle), 0.2 * CB * np.sin(2 * angle))),
        ("saturation", chroma(0.1 * CB, 0.1 * CR)),
        ("frequency", luma(0.3 * (second(Y, 0, 1) + second(Y, 1, 0)))),
        ("frequency", chroma(around(CB, 3) - CB, around(CR, 3) - CR)),
        ("edge", 0.3 * np.gradient(PICTURE, axis=2)),
        ("orientation", luma(0.3 * second(Y, 0, 1))),
        ("neighbourhood", luma(without_curve(0.1 * (around(Y, 33) - Y) * Y / 128))),
        ("cfa_phase", luma(0.03 * Y * checker)),
        ("block_phase", luma(2.0 * ((ROW % 8 == 0) | (COLUMN % 8 == 0)))),
        ("block_phase", luma(quantized(Y) - Y)),
        ("row", luma(2 * rng.normal(size=(N, H, 1)))),
        ("column", luma(2 * rng.normal(size=(1, 1, W)))),
        ("lag", luma(white + 0.5 * beside(white, 0, 1))),
        ("tail", luma(np.where(rng.random(Y.shape) < 5e-4, 60, 0))),
        ("fixed_pattern", luma(0.02 * Y * rng.normal(size=(1, H, W)))),
    ]


CASES = residuals(np.random.default_rng(0))
ONE = np.ones(Y.shape)


SEEN = [axis for axis, _ in CASES]


@pytest.mark.parametrize(
    ("axis", "residual"),
    [
        # of an axis that has two residuals the second, which is harder to see
        pytest.param(*case, id=f"{i}-{case[0]}", marks=[pytest.mark.slow] * (case[0] in SEEN[i + 1 :]))
        for i, case in enumerate(CASES)
    ],
)
def test_axis_comes_first(axis, residual):
    rng = np.random.default_rng(1)
    found = where(residual + rng.normal(size=residual.shape) * 0.3, PICTURE, ONE, rng=rng)
    assert found[0]["axis"] == axis
    assert found[0]["p_value"] <= 0.01
    assert len(found[0]["bins"]) == len(found[0]["profile"])
    json.dumps(found, allow_nan=False)
    assert {f["axis"] for f in found} <= set(AXES)
    assert [f["share"] for f in found] == sorted((f["share"] for f in found), reverse=True)


def test_profile_and_share_of_known_curve():
    """A residual of known energy in known noise: the share is their ratio, the profile the curve."""
    rng = np.random.default_rng(2)
    curve = 0.05 * (Y - 128)
    noise = 3.0
    found = where(luma(curve + noise * rng.normal(size=Y.shape)), PICTURE, ONE, rng=rng)
    first = found[0]
    expected = np.mean(curve**2) / (np.mean(curve**2) + noise**2)
    assert first["axis"] == "intensity" and first["channel"] == "Y"
    assert abs(first["share"] - expected) < 0.03
    middle = np.abs(np.asarray(first["bins"]) - 128) < 80
    np.testing.assert_allclose(
        np.asarray(first["profile"])[middle], 0.05 * (np.asarray(first["bins"])[middle] - 128), atol=0.35
    )


# a binomial at 0.05 is above this in 0.3 % of the cases, of six in 0.2 %
@pytest.mark.parametrize(("seeds", "most"), [(6, 2), pytest.param(20, 4, marks=pytest.mark.slow)])
def test_white_noise_has_no_axis(seeds, most):
    """p is corrected over the axes: at 0.05 one family in twenty has an axis below it."""
    false = 0
    for seed in range(seeds):
        rng = np.random.default_rng(100 + seed)
        picture = scenes(rng, 3 if seed % 2 else 1, (64, 72))
        found = where(2 * rng.normal(size=picture.shape), picture, np.ones(picture.shape[:3]), rng=rng)
        false += any(f["p_value"] < 0.05 for f in found)
        assert max(f["share"] for f in found) < 0.03
    assert false <= most


def test_frames_of_a_scene_are_compared_with_each_other():
    """A change of all light lies on frames, however different the scenes; what a scene has in all of its
    frames repeats there, and is neither that nor a fixed pattern."""
    order, names = [0, 0, 1, 1, 2, 2], list("aabbcc")
    pictures, rng = PICTURE[order], np.random.default_rng(3)
    noise = rng.normal(size=pictures.shape)
    scene_s = 2 * rng.normal(size=PICTURE.shape)[order]

    def found(residual, scenes=names):
        rows = where(residual, pictures, np.ones(pictures.shape[:3]), scenes=scenes, rng=rng)
        return {row["axis"]: row for row in rows}

    change = 0.5 * np.array([1, -1, -1, 1, 1, -1])[:, None, None, None] * [1, 0, 0]
    own, *_ = found(noise + change).values()
    energy = 0.25 / (0.25 + 3)  # of the change, of three channels' noise of one
    assert own["axis"] == "frame" and own["channel"] == "Y" and own["p_value"] < 0.01
    assert own["share"] == pytest.approx(energy, rel=0.1) and own["bins"][:3] == ["1.0", "1.1", "2.0"]
    np.testing.assert_allclose(own["profile"], change[:, 0, 0, 0], atol=0.05)
    json.dumps(own, allow_nan=False)
    alike = found(noise + scene_s)
    assert max(alike[axis]["share"] for axis in ("frame", "fixed_pattern")) < 0.01
    assert found(noise + scene_s, list("abcdef"))["fixed_pattern"]["share"] > 0.1, "were they six scenes"
    assert "frame" not in found(noise, None)


def test_scenes_that_are_not_scored_teach():
    """Two scenes learn little of many bins from each other; ten more say what they could not. The shares are
    of the two, and what only the others show does not count."""
    rng = np.random.default_rng(11)
    pictures = scenes(rng, 12, (64, 72))
    luma_of, down = pictures[..., 0], np.gradient(pictures, axis=1)
    steep = np.arange(64)[:, None] / 32 - 1
    moved = 0.5 * steep[..., None] * down + 2 * rng.normal(size=pictures.shape)

    def found(residual, count, **given):
        weight = np.ones((count, 64, 72))
        rows = where(residual[:count], pictures[:count], weight, rng=np.random.default_rng(0), **given)
        return {row["axis"]: row for row in rows}

    alone, taught = found(moved, 2)["radius"], found(moved, 12, scored=2)["radius"]
    expected = 1 - 4 * moved[:2].size / np.sum(moved[:2] ** 2)
    assert alone["share"] < taught["share"] < 1.1 * expected and taught["share"] > 0.4 * expected
    curve = luma_of[..., None] / 9 * [1, 0, 0]
    theirs = rng.normal(size=pictures.shape) + (np.arange(12) > 1)[:, None, None, None] * curve
    both, own = (found(theirs, 12, **given)["intensity"]["share"] for given in ({}, {"scored": 2}))
    assert both > 0.5 and own < 0.02


@pytest.mark.parametrize("place", [(6, 2), (4, 4)])
def test_blocks_of_an_earlier_compression_are_seen_where_they_began(place):
    """A quantiser of a grid elsewhere: half of that grid's energy is not locked to any other."""
    back = tuple(-p for p in place)
    lost = np.roll(quantized(np.roll(Y, back, (1, 2))), place, (1, 2)) - Y
    residual = luma(lost) + np.random.default_rng(13).normal(size=PICTURE.shape)
    shares = []
    for grid in ((0, 0), place):
        rows = where(residual, PICTURE, ONE, earlier=grid, rng=np.random.default_rng(1))
        shares.append(next(row["share"] for row in rows if row["axis"] == "block_phase"))
    assert rows[0]["axis"] == "block_phase" and shares[1] > 0.1 and shares[0] < 0.02


def test_surroundings_are_seen_beside_each_scene_s_own_curve():
    """As local tone has it: how bright a scene is all over sets the curve of all of it."""
    rng = np.random.default_rng(12)
    pictures = scenes(rng, 6, (96, 104))
    light = pictures[..., 0]
    smooth = np.stack([uniform_filter(plane, 33, mode="nearest") for plane in light])
    own = np.sin(light / 255 * np.pi * rng.uniform(0.5, 2, (6, 1, 1))) * rng.choice((-6, 6), (6, 1, 1))
    residual = (own - 0.1 * (smooth - light))[..., None] * [1, 0, 0] + 0.3 * rng.normal(size=pictures.shape)
    first, *_ = where(residual, pictures, np.ones(light.shape), rng=rng)
    assert first["axis"] == "neighbourhood" and first["share"] > 0.5


def test_what_moves_otherwise_in_each_scene_is_on_edges():
    """Rows slide one way or the other by scene: no displacement is common to all, nor to one scene."""
    rng = np.random.default_rng(14)
    pictures = scenes(rng, 4, (240, 248))
    slide = 0.4 * (np.arange(240)[:, None] / 120 - 1) * rng.choice((-1, 1), (4, 1, 1))
    moved = slide[..., None] * np.gradient(pictures, axis=2)
    first, *_ = where(moved + rng.normal(size=pictures.shape), pictures, np.ones(pictures.shape[:3]), rng=rng)
    expected = np.mean(moved**2) / (np.mean(moved**2) + 1)
    # tiles at the border have neighbours on one side alone
    assert first["axis"] == "edge" and 0.7 * expected < first["share"] < 1.05 * expected


def test_light_of_the_whole_scene_is_its_surroundings():
    """As glare has it: bright scenes are lifted, dark ones are not, whatever a pixel's own value."""
    rng = np.random.default_rng(15)
    pictures = scenes(rng, 8, (96, 104))
    light = pictures[..., 0].mean((1, 2))[:, None, None, None]
    residual = 0.2 * (light - light.mean()) * [1, 0, 0] + rng.normal(size=pictures.shape)
    first, *_ = where(residual, pictures, np.ones(pictures.shape[:3]), rng=rng)
    assert first["axis"] == "neighbourhood"


def test_masked_pixels_do_not_count():
    rng = np.random.default_rng(3)
    residual = luma(0.05 * (Y - 128)) + rng.normal(size=PICTURE.shape)
    weight = ONE.copy()
    weight[:, 20:60, 30:90] = 0
    spoiled = residual.copy()
    spoiled[:, 20:60, 30:90] = np.nan
    a, b = (where(r, PICTURE, weight, rng=np.random.default_rng(0)) for r in (residual, spoiled))
    assert a[0]["axis"] == "intensity" and all(np.isfinite(f["share"]) for f in b)
    assert a[0]["share"] == pytest.approx(b[0]["share"], abs=0.02)


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_degenerate_input_is_finite(value):
    shape = (1, 64, 71)
    for weight in (np.ones(shape), np.zeros(shape)):
        found = where(
            np.full((*shape, 3), value), np.full((*shape, 3), 90.0), weight, rng=np.random.default_rng(0)
        )
        json.dumps(found, allow_nan=False)
        assert all(0 <= f["share"] <= 1 and 0 < f["p_value"] <= 1 for f in found)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="expected"):
        where(
            np.zeros((1, 64, 64)),
            np.zeros((1, 64, 64, 3)),
            np.ones((1, 64, 64)),
            rng=np.random.default_rng(0),
        )


FOUR = scenes(np.random.default_rng(6), 4, (64, 72))
WAVE = 6 * np.sin(FOUR[..., :1] / 255 * 3 * np.pi) * [1, 0, 0]


def spread_of(axis, residual, pictures=FOUR, names=None):
    """(low, high, share) of one axis."""
    weight = np.ones(pictures.shape[:3])
    rows = where(residual, pictures, weight, scenes=names, rng=np.random.default_rng(0))
    row = next(row for row in rows if row["axis"] == axis)
    json.dumps(row["ci"], allow_nan=False)
    assert 0 <= row["ci"][0] <= row["share"] <= row["ci"][1] <= 1
    return *row["ci"], row["share"]


def test_what_all_scenes_show_alike_is_sure():
    noise = 3 * np.random.default_rng(7).normal(size=FOUR.shape)
    expected = np.mean(WAVE**2) / (np.mean(WAVE**2) + 9)
    low, high, _ = spread_of("intensity", WAVE + noise)
    assert low < expected < high and high - low < 0.2
    some = spread_of("intensity", WAVE * np.array([2, 0.5, 0.5, 0.5])[:, None, None, None] + noise)
    assert some[1] - some[0] > 5 * (high - low), "mostly one scene's"


def test_what_one_scene_of_four_shows_is_not_sure():
    rng = np.random.default_rng(8)
    noise = rng.normal(size=FOUR.shape)
    spots = np.where(rng.random(FOUR.shape[:3]) < 1e-3, 60, 0)[..., None] * [1, 0, 0]
    low, high, share = spread_of("tail", noise + spots)
    one = spread_of("tail", noise + spots * (np.arange(4) == 2)[:, None, None, None])
    assert low > 0.5 * share and high < 1.5 * share
    assert one[0] == 0 and one[1] > 2 * one[2]


def test_frames_of_a_scene_are_drawn_together():
    """Three frames of each are no more scenes than one is; as scenes of their own they would be."""
    rng, three = np.random.default_rng(9), np.repeat(np.arange(4), 3)
    pictures, noise = FOUR[three], rng.normal(size=(12, *FOUR.shape[1:]))
    lines = rng.normal(size=(12, 64, 1, 1)) * np.array([2, 1, 1, 0.5])[three][:, None, None, None] * [1, 0, 0]
    together = spread_of("row", noise + lines, pictures, list(three))
    alone = spread_of("row", noise + lines, pictures)
    assert together[1] - together[0] > 1.5 * (alone[1] - alone[0])


@pytest.mark.parametrize("names", [["a"] * 4, ["a"]])
def test_one_scene_has_no_interval(names):
    pictures = FOUR[: len(names)]
    residual = np.random.default_rng(1).normal(size=pictures.shape)
    weight = np.ones(pictures.shape[:3])
    found = where(residual, pictures, weight, scenes=names, rng=np.random.default_rng(0))
    assert all(row["ci"] is None for row in found)


def test_without_draws_shares_are_the_same():
    rng = np.random.default_rng(0)
    residual, picture = rng.normal(size=(2, 3, 96, 96, 3)).astype(np.float32) * 4
    weight = rng.uniform(size=(3, 96, 96))
    one, other = (
        where(residual, picture, weight, rng=np.random.default_rng(1), **more) for more in ({}, {"draws": 0})
    )
    assert [row | {"p_value": 1.0} for row in one] == other
