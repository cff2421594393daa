"""Noise statistics: each answers to the noise it is named after, and not to an error of the mean at edges."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter

from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.gap.features import residual_statistics
from jaxisp.gap.features.mean import normalised_regressors, regressors, tents
from jaxisp.gap.features.noise import LEVELS
from jaxisp.gap.features.quantization import unknown_quantization
from jaxisp.gap.features.residual_statistics import (
    compile_features,
    feature_names,
    features,
    frames_of,
    noise_of,
)
from jaxisp.gap.features.tolerances import axis_of, present, tolerances, weights
from jaxisp.gap.simulator.effects import AXES
from tests.gap.scenes import scenes

SCENE = scenes(np.random.default_rng(3), 4, (112, 112))  # of the diagnoses' size: they share its programs
N, H, W = SCENE.shape[:3]
ROW, COLUMN = np.mgrid[:H, :W]
MASK = jnp.ones((N, H, W), jnp.float32)
FRAMES = frames_of(["a", "b", "c", "d"])
SEEN = unknown_quantization((H, W))


@functools.cache
def scene_maps():
    """What the statistics of SCENE are regressed on."""
    return normalised_regressors(jnp.asarray(SCENE), MASK)


def measured(residual):
    """(F,) means over the scenes, by name."""
    found = np.asarray(
        features(
            jnp.asarray(SCENE + residual, jnp.float32), jnp.asarray(SCENE), MASK, scene_maps(), FRAMES, SEEN
        )
    )
    assert np.isfinite(found).all()
    return dict(zip(feature_names(), found.mean(0)))


def white(seed=0, size=4.0):
    return size * np.random.default_rng(seed).normal(size=SCENE.shape)


def luma(a):
    return np.stack([a + np.zeros((N, H, W)), np.zeros((N, H, W)), np.zeros((N, H, W))], -1)


RNG = np.random.default_rng(7)
SPOTS = sum(np.exp(-((np.hypot(ROW - y, COLUMN - x) / 6) ** 4)) for y, x in RNG.uniform(10, 100, (8, 2)))
ALONG = np.stack([convolve(v, np.eye(3) / 3) for v in RNG.normal(size=(N, H, W))])
CASES = {
    "pattern column Y repeats": luma(1.5 * RNG.normal(size=(1, 1, W))),
    "pattern fixed_pattern Y pixel": luma(2.5 * RNG.normal(size=(1, H, W))),
    "corr lag Y(0, 1) light": luma(9 * gaussian_filter(RNG.normal(size=(N, H, W)), (0, 0, 1))),
    "logvar intensity Cb3": 4 * RNG.normal(size=SCENE.shape) * [0, 1, 0],
    "logvar cfa_phase Y00": luma(4 * RNG.normal(size=(N, H, W)) * ((ROW % 2 == 0) & (COLUMN % 2 == 0))),
    "mean cfa_phase Y checker": 0.02 * luma(SCENE[..., 0] * ((ROW + COLUMN) % 2 - 0.5)),
    "mean radius Y gain": luma(-0.2 * SCENE[..., 0] * ((ROW / H - 0.5) ** 2 + (COLUMN / W - 0.5) ** 2)),
    "coarse fixed_pattern Y": -0.1 * luma(SCENE[..., 0] * SPOTS),
    "corr orientation diagonals light": luma(9 * ALONG),
    "mean frequency Y fine": luma(0.5 * (gaussian_filter(SCENE[..., 0], (0, 0.8, 0.8)) - SCENE[..., 0])),
}


@pytest.fixture(scope="module")
def plain():
    """Two draws."""
    return measured(white(0)), measured(white(1))


@pytest.mark.parametrize("name", CASES)
def test_a_statistic_answers_to_its_noise(name, plain):
    """By more than five times the difference that another draw of plain noise makes, or is harmless."""
    unit = dict(zip(feature_names(), tolerances()))[name]
    one, again = plain
    change = abs(measured(white(0) + CASES[name])[name] - one[name])
    assert change > 5 * max(abs(again[name] - one[name]), 0.5 * unit)


@pytest.mark.parametrize("name, added", [
    ("corr row Y", np.random.default_rng(8).normal(size=(N, H, 1))),
    ("corr column Y", np.random.default_rng(9).normal(size=(N, 1, W))),
    ("tail tail high bright", np.where(np.random.default_rng(10).random((N, H, W)) < 2e-3, 60, 0)),
])  # fmt: skip
def test_lines_and_impulses_are_seen_in_a_flat_scene(name, added):
    """Rows of deviation 1 in noise of 4: the mean of half a row has 0.5, so that halves agree by 0.8."""
    ramp = jnp.asarray(np.broadcast_to(100 + 0.3 * COLUMN[..., None] * [1, 0, 0], (N, H, W, 3)), jnp.float32)
    maps = normalised_regressors(ramp, MASK)
    place = feature_names().index(name)
    plain, found = (
        np.asarray(features(ramp + jnp.asarray(r, jnp.float32), ramp, MASK, maps, FRAMES, SEEN))[
            :, place
        ].mean()
        for r in (white(0), white(0) + luma(added))
    )
    assert found - plain > 0.4
    assert name.startswith("tail") or abs(plain) < 0.4  # a Gaussian has tails too


def test_lines_do_not_answer_to_the_level_of_white_noise(plain):
    loud = measured(white(0, 8.0))
    for name in ("corr row Y", "corr column Y", "corr lag Y(0, 1) light", "logvar frequency Y0"):
        assert loud[name] == pytest.approx(plain[0][name], abs=0.03)
    assert loud["logvar intensity Y3"] == pytest.approx(plain[0]["logvar intensity Y3"] + np.log(4), abs=0.1)


def test_a_few_hot_pixels_are_a_matter_of_tails(plain):
    """They lie anywhere: where and in what grid they happen to lie is no property of the noise."""
    hot = np.zeros((N, H, W))
    hot[:, [3, 9, 101, 105], [5, 105, 9, 103]] = 80.0  # corners, odd rows, odd columns
    found = measured(white(0) + luma(hot))
    for name in ("logvar radius Y", "logvar cfa_phase Y11", "logvar intensity Y3", "logvar frequency Y0"):
        assert abs(found[name] - plain[0][name]) < 0.08, name
    assert abs(found["coarse fixed_pattern Y"] - plain[0]["coarse fixed_pattern Y"]) < 0.1
    assert found["pattern tail peaks"] - plain[0]["pattern tail peaks"] > 0.05


def test_bands_of_lines_do_not_answer_to_grain(plain):
    """Grain of 1.6 px, the widest that the effect of that name has, reaches over the border of stripes."""
    rng = np.random.default_rng(1)
    grained = [
        measured(luma(23 * gaussian_filter(rng.normal(size=(N, H, W)), (0, 1.6, 1.6))) + white(k))
        for k in range(8)
    ]
    slow = np.mean([found["corr row Y slow"] for found in grained])
    assert abs(slow) < 0.08  # 0.10 to 0.13 where stripes touch
    pulsing = 4 * np.sin(2 * np.pi * (ROW / 21.0 + rng.random((N, 1, 1))))
    banded = measured(white(0) + luma(pulsing))
    for name, follows in (("corr row Y slow", True), ("corr column Y slow", False)):
        assert (banded[name] - plain[0][name] > 0.5) == follows


def test_few_levels_leave_a_comb_at_their_number(plain):
    encoded = np.stack(ycbcr_to_rgb_planes(*np.moveaxis((SCENE + white(0)) / 255, -1, 0)), -1)
    few = np.stack(rgb_to_ycbcr_planes(*np.moveaxis(np.rint(20 * encoded) / 20, -1, 0)), -1)
    found = measured(255 * few - SCENE)
    combs = {n: found[f"levels intensity {n:02d}"] - plain[0][f"levels intensity {n:02d}"] for n in LEVELS}
    assert max(combs, key=combs.get) in (20, 80)  # all multiples of the number
    assert combs[20] > 0.5 > combs[32]


def test_an_error_of_the_mean_at_edges_is_no_noise(plain):
    """Sharpness that is off is seen by the mean, and taken out of what the noise is measured on."""
    soft = gaussian_filter(SCENE, (0, 0.8, 0.8, 0)) - SCENE
    found = measured(white(0) + 0.5 * soft)
    assert abs(found["mean frequency Y fine"] - plain[0]["mean frequency Y fine"]) > 0.3
    for name in ("corr row Y", "logvar intensity Y3", "logvar frequency Y0", "corr lag Y(0, 1) light"):
        assert abs(found[name] - plain[0][name]) < 0.1, name


def test_amplitudes_are_root_mean_squares_in_steps():
    channel = 0
    plane = regressors(SCENE[0])["neighbourhood detail"][1]
    scaled = np.zeros((N, H, W, 3))
    scaled[0, ..., channel] = np.asarray(plane)
    amplitude = np.sqrt(np.mean(np.asarray(plane) ** 2))
    found = features(
        jnp.asarray(SCENE + scaled, jnp.float32), jnp.asarray(SCENE), MASK, scene_maps(), FRAMES, SEEN
    )
    own = np.asarray(found)[0, feature_names().index("mean neighbourhood detail")]
    assert own == pytest.approx(amplitude, rel=1e-3)


def test_tents_sum_to_one():
    x = jnp.linspace(-20, 300, 41)
    np.testing.assert_allclose(sum(tents(x, (0.0, 28.0, 100.0, 255.0))), 1, atol=1e-6)


def test_names_axes_and_weights():
    names = feature_names()
    assert len(set(names)) == len(names) == len(tolerances()) == len(weights())
    assert {axis_of(n) for n in names} <= set(AXES)
    assert (tolerances() > 0).all()
    frame = np.array([axis_of(n) == "frame" for n in names])
    for repeated in (False, True):
        own = weights(repeated)
        assert own.mean() == pytest.approx(1) and (present(own) == (~frame | repeated)).all()


def test_what_changes_between_frames_is_measured_in_steps():
    """By half a step up and down, of one or two frames; a scene without a second frame shows nothing."""
    change = np.zeros_like(SCENE)
    change[:2] += np.array([0.5, -0.5])[:, None, None, None]
    frames = frames_of(["a", "a", "b", "c"])
    still = jnp.asarray(np.repeat(SCENE[:1], N, 0))
    found = np.asarray(features(still + change, still, MASK, [scene_maps()[0]] * N, frames, SEEN))
    at = [k for k, name in enumerate(feature_names()) if axis_of(name) == "frame"]
    wanted = [2**-0.5, 2**-0.5, 0, 0]  # two frames are less far from their mean than from a known one
    np.testing.assert_allclose(found[:, at], np.outer(wanted, np.ones(len(at))), atol=1e-4)


@pytest.mark.parametrize("mask", [0.0, 1.0])
def test_degenerate_pictures_are_finite(mask):
    flat = jnp.full(SCENE.shape, 90.0, jnp.float32)
    chosen = jnp.full((N, H, W), mask, jnp.float32)
    maps = normalised_regressors(flat, chosen)
    assert np.isfinite(np.asarray(features(flat, flat, chosen, maps, FRAMES, SEEN))).all()


def test_frames_of_one_scene_give_the_noise_without_what_they_share():
    """A fixed pattern is no noise then, and is looked for between scenes only."""
    twice = jnp.asarray(np.repeat(SCENE[:2], 2, 0))
    maps = normalised_regressors(twice, MASK)
    frames = frames_of(["a", "a", "b", "b"])
    shared = np.repeat(20 * RNG.normal(size=(2, H, W, 3)), 2, 0)
    rows = [
        dict(
            zip(
                feature_names(),
                np.asarray(features(twice + jnp.asarray(e), twice, MASK, maps, frames, SEEN)).mean(0),
            )
        )
        for e in (white(0), white(0) + shared)
    ]
    for name in ("logvar intensity Y3", "corr lag Y(0, 1) light", "corr row Y"):
        assert rows[1][name] == pytest.approx(rows[0][name], abs=0.02)
    assert abs(rows[1]["pattern fixed_pattern Y pixel"]) < 0.03
    assert rows[1]["change frame Y dark"] == pytest.approx(rows[0]["change frame Y dark"], abs=1e-3)
    np.testing.assert_array_equal(frames_of(["a", "b"]).average, 0)
    np.testing.assert_array_equal(frames_of(["a", "a"]).others, [[0, 1], [1, 0]])


def test_noise_is_without_what_follows_the_clean_picture():
    grains = white(5, 3.0)
    error = 0.1 * (SCENE - SCENE.mean())
    found, alone = (noise_of(SCENE + y, SCENE, MASK, scene_maps(), FRAMES) for y in (grains + error, grains))
    assert np.std(found - alone) < 0.05 * np.std(error) and np.std(error) > 3
    assert np.std(alone) == pytest.approx(3.0, rel=0.02)


def test_what_frames_of_a_scene_have_in_common_is_no_noise():
    clean = np.array(SCENE)
    clean[1] = clean[0]
    fixed = np.random.default_rng(8).normal(0, 9, clean[0].shape)
    maps = normalised_regressors(jnp.asarray(clean), MASK)
    shown = jnp.asarray(clean + fixed + white(5, 3.0))
    found = np.asarray(noise_of(shown, clean, MASK, maps, frames_of([*"aabc"])))
    assert found[:2].std() == pytest.approx(3.0, rel=0.02)  # as large as if the mean were known
    assert found[2:].std() == pytest.approx(np.hypot(9, 3), rel=0.02)


def test_what_was_compiled_before_serves_pictures_of_that_size():
    shape, programs = (52, 60), (residual_statistics._noise_part, residual_statistics._patterns)
    compile_features([2], shape)
    sizes = [program._cache_size() for program in programs]
    scene = jnp.asarray(SCENE[:2, : shape[0], : shape[1]])
    mask = jnp.ones((2, *shape), jnp.float32)
    maps = normalised_regressors(scene, mask)
    features(jnp.asarray(scene + 1), scene, mask, maps, frames_of(["a", "b"]), unknown_quantization(shape))
    assert [program._cache_size() for program in programs] == sizes
