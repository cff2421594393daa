"""Every effect is the identity while it is off, and does something at its probe."""

import colorsys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skimage.restoration import richardson_lucy

from jaxisp.color import linear_to_srgb, luma, srgb_to_linear
from jaxisp.errors import InputError
from jaxisp.gap import EFFECTS, Effect, Move, parallel, register_effect
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective import pixels
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.refit import refit
from jaxisp.gap.search.screening import screen
from jaxisp.gap.search.trial import Bars, Whole
from jaxisp.gap.simulator.effects import CLEAN_NOISY, RAW_JPEG, candidates, check_effect
from jaxisp.gap.simulator.model import build, plain_camera, plain_freedom
from jaxisp.pipeline import Chain, run, stage
from jaxisp.stages.balance import WhiteBalance
from jaxisp.testing import smooth_image

VOCABULARY = [
    "vignetting", "color_shading", "lateral_chromatic_aberration", "optical_blur", "motion_blur",
    "geometric_distortion", "veiling_glare", "black_level_offset", "noise_level", "row_noise",
    "column_noise", "prnu", "correlated_noise", "heavy_tailed_noise", "hot_pixels", "green_imbalance",
    "crosstalk", "adc_quantization", "highlight_clipping", "white_balance", "color_matrix", "color_lut",
    "tone_curve", "local_tone_mapping", "saturation", "luma_denoising", "chroma_denoising",
    "sharpening", "demosaicking", "resampling", "jpeg_quantization", "chroma_subsampling",
    "double_compression", "film_grain",
]  # fmt: skip


def mosaics():
    """From black to white, with detail and colour."""
    ramp = np.linspace(0, 1, 48) ** 2
    detail = np.stack([smooth_image((40, 48), seed) for seed in range(2)])
    tints = np.array([colorsys.hsv_to_rgb(i // 2 / 20, 0.6, 1) for i in range(40)])[:, None]  # row by row
    green = np.arange(40)[:, None] % 2 == np.arange(48) % 2
    red = ~green & (np.arange(40)[:, None] % 2 == 0)
    tinted = np.where(green, tints[..., 1], np.where(red, tints[..., 0], tints[..., 2]))
    return jnp.asarray(np.clip((ramp + 0.3 * (detail - 0.5) * (ramp + 0.02)) * tinted, 0, 1), jnp.float32)


def model_of(effects):
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((2, 3), 1.1, np.float32))}
    return build(chain, params, gains, plain_freedom(), effects)


@pytest.fixture(scope="module")
def model():
    return model_of(candidates(RAW_JPEG))


@pytest.fixture(scope="module")
def warping():
    return model_of([EFFECTS[name] for name in ("geometric_distortion", "lateral_chromatic_aberration")])


def test_the_vocabulary_is_complete():
    assert set(VOCABULARY) <= set(EFFECTS)
    for name in VOCABULARY:
        check_effect(EFFECTS[name])
        assert EFFECTS[name].axes
    only_noisy = {n for n in VOCABULARY if EFFECTS[n].shows_in == (CLEAN_NOISY,)}
    assert only_noisy == {
        "motion_blur", "noise_level", "row_noise", "column_noise", "prnu", "correlated_noise",
        "heavy_tailed_noise", "hot_pixels", "adc_quantization",
    }  # fmt: skip


@pytest.mark.optimised
def test_nothing_is_changed_while_all_are_off(model):
    chain, params = plain_camera("GRBG")
    own = params | {"mosaic_white_balance": WhiteBalance(gains=np.full(3, 1.1, np.float32))}
    light = mosaics()
    plain = np.stack([np.clip(run(chain, own, m), 0, 1) for m in light])
    np.testing.assert_array_equal(model.render(np.zeros(len(model.coordinates)), light), plain)


_WAYS = {
    "geometric_distortion": ("sharpness",),
    "lateral_chromatic_aberration": ("sharpness",),
    "resampling": ("shares",),
    "chroma_subsampling": ("sampled", "repeated"),
    "local_tone_mapping": ("sigma", "edges", "clip"),
    "sharpening": ("sigma", "threshold", "limit"),
}
"""Of what another move does: the first, unless it is named below."""
_DONE_BY = {
    ("local_tone_mapping", "clip"): "equalization",
    ("sharpening", "sigma"): "deconvolution",
}


def test_every_move_shows(model):
    """Of what does not show here, and of film grain, see `test_effects_in_noise`."""
    light = mosaics()
    before = model.render(np.zeros(len(model.coordinates)), light)
    for i, (coordinate, step) in enumerate(zip(model.coordinates, model.steps)):
        if coordinate.node == "demosaicking" and coordinate.move.index == (1,):
            continue  # the base's own algorithm
        z = np.zeros(len(model.coordinates))
        start = before
        if coordinate.move.field in _WAYS.get(coordinate.node, ()):
            own = model.indices([coordinate.node])
            done_by = _DONE_BY.get(
                (coordinate.node, coordinate.move.field), model.coordinates[own[0]].move.field
            )
            first = next(k for k in own if model.coordinates[k].move.field == done_by)
            z[first] = min(0.5, model.ranges[1, first])
            start = model.render(z, light)
        z[i] = step
        assert np.abs(model.render(z, light) - start).max() > 1e-4, coordinate


def test_a_name_does_not_contradict_its_parameters():
    """A negative share of a smoothing filter sharpens, a negative amount of a mask smooths."""
    for name, field in (
        ("luma_denoising", "shares"),
        ("chroma_denoising", "shares"),
        ("sharpening", "amounts"),
        ("sharpening", "deconvolution"),
    ):
        assert all(m.low >= 0 for m in EFFECTS[name].moves if m.field == field)


def test_a_user_adds_an_effect_of_their_own():
    own = Effect(
        "warm_shadows",
        stage("spline_curve", name="warm_shadows"),
        "encoded",
        (Move("offsets", 0.1, -1, 1, (0,)),),
        ("hue",),
    )
    try:
        register_effect(own)
        assert own in candidates(RAW_JPEG)
        with pytest.raises(ValueError, match="registered already"):
            register_effect(own)
    finally:
        del EFFECTS["warm_shadows"]


@pytest.mark.parametrize(
    ("mistaken", "told"),
    [
        ({"site": "nowhere"}, "unknown site 'nowhere'; there are scene, mosaic"),
        ({"axes": ("intensty",)}, "unknown axes 'intensty'; is it intensity"),
        ({"shows_in": ("raw-jpeg",)}, "unknown shows_in 'raw-jpeg'; is it raw.jpeg"),
        ({"alternatives": ("saturaton",)}, "unknown alternatives 'saturaton'; is it saturation"),
        ({"contains": ("own",)}, "unknown contains 'own'; there are vignetting"),
        ({"node": stage("clip")}, "as stage.*name='own'.*this one is 'clip'"),
        ({"node": stage("srgb_oetf", name="own")}, "a stage with parameters"),
        ({"moves": (Move("whit", 0.1, 0, 1),)}, "no parameter 'whit'; is it white"),
        ({"moves": (Move("white", 0.1, 0, 1, (0,)),)}, "white, of shape .., has no entry .0,."),
        ({"strong": ((1, 1),)}, "strong form"),
    ],
)
def test_a_mistake_in_an_effect_is_told_when_it_is_registered(mistaken, told):
    whole = {"site": "output", "axes": ("hue",), "node": stage("clip", name="own")}
    whole |= {"moves": (Move("white", 0.1, 0, 1),)}
    with pytest.raises(ValueError, match=f"^effect own: .*{told}"):
        register_effect(Effect("own", **whole | mistaken))
    assert "own" not in EFFECTS


@pytest.mark.parametrize(("off", "origin"), [({}, 0.0), ({"off": 1}, 1.0)])
def test_a_move_starts_at_off_whatever_the_default(off, origin):
    node = stage("saturation", name="vivid")
    own = Effect("vivid", node, "encoded", (Move("amount", 0.1, -1, 3, **off),), ("saturation",))
    chain, params = plain_camera("GRBG")
    model = build(chain, params, {}, [], [own])
    assert node.init()["vivid"].amount == 1 and model.shared["vivid"].amount == origin
    assert model.params(np.array([0.1]))["vivid"].amount == pytest.approx(origin + 0.1)


def test_a_mistyped_effect_is_told_with_what_may_be_meant():
    with pytest.raises(InputError, match=r"^no effect named 'prnuu'; is it prnu"):
        candidates(CLEAN_NOISY, ["vignetting", "prnuu"])


def test_noise_effects_repeat_for_a_key():
    chain = Chain((stage("column_noise", sensor=1),))
    image = jnp.full((16, 16), 0.5)
    one, two = (run(chain, chain.init(), image, jax.random.key(k)) for k in (0, 1))
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["geometric_distortion", "lateral_chromatic_aberration"])
def test_a_warp_is_found_to_either_side(warping, name, sign):
    """Interpolation smooths both ways, which a probe to one side would take for a part of the warp."""
    model = warping
    first, light = model.indices([name])[0], jnp.concatenate([mosaics()] * 2, 1)
    z = np.zeros(len(model.coordinates))
    z[first] = 0.7 * sign * model.steps[first]
    names, mask = ("a", "b"), np.ones(light.shape, bool)
    objective = PixelObjective.of(Pairs(names, light, model.render(z, light), mask))
    at = objective.compute(objective.at(model, 0 * z), [first])
    gram, slope = objective.normal(at, [first])
    assert slope.sum() / gram.sum() == pytest.approx(z[first], rel=0.3)
    assert fit(objective, at, [first], steps=4).point.z[first] == pytest.approx(z[first], rel=0.05)


@pytest.mark.parametrize("name", ["geometric_distortion", "lateral_chromatic_aberration"])
def test_a_warp_of_several_pixels_is_found(name):
    """No small probe sees it: edges have moved by more than their width."""
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((4, 3), 1.1, np.float32))}
    effects = [e for e in candidates(RAW_JPEG) if e.name in (name, "sharpening")]
    model = build(chain, params, gains, plain_freedom(), effects)
    rng = np.random.default_rng(3)
    light = jnp.asarray((rng.random((4, 96, 96)) < 0.02) * 0.8 + 0.1, jnp.float32)  # sparse points
    first, z = model.indices([name])[0], np.zeros(len(model.coordinates))
    z[first] = -0.9 * model.ranges[1, first]
    pictures = model.render(z, light)
    pairs = Pairs(("a", "b", "c", "d"), light, pictures, np.ones(light.shape, bool))
    objective = PixelObjective.of(pairs, Split((0, 2), (1, 3)))
    promised, at = screen(objective, objective.at(model, 0 * z), [name, "sharpening"])
    assert promised[name] > promised["sharpening"]
    parts = objective.units(at)[[1, 3]]
    found = refit(objective, at, name, Whole(float(parts.mean()), parts), Bars(0.0), CRITERIA[RAW_JPEG])
    assert found.z[first] == pytest.approx(z[first], rel=0.05) and found.closed > 0.9


def test_a_deconvolution_by_others_is_closed_by_its_own_form():
    """scikit-image's, of luma in linear light; masks stand in for a part of it."""
    model, light = model_of([EFFECTS["sharpening"]]), mosaics()
    z = np.zeros(len(model.coordinates))
    pictures, sigma, margin = model.render(z, light).astype(float), 0.8, 12
    taps = np.exp(-0.5 * (np.arange(-4, 5) / sigma) ** 2)
    psf = np.outer(taps, taps) / taps.sum() ** 2
    for picture in pictures:
        y = luma(*np.moveaxis(picture, -1, 0))
        wide = np.pad(srgb_to_linear(np.maximum(y, 1e-3)), margin, mode="reflect")
        sharp = richardson_lucy(wide, psf, num_iter=15, clip=False)[margin:-margin, margin:-margin]
        picture += (linear_to_srgb(sharp) - y)[..., None]
    pairs = Pairs(("a", "b"), light, np.clip(pictures, 0, 1).astype(np.float32), np.ones(light.shape, bool))
    objective = PixelObjective.of(pairs)
    at = objective.at(model, z)
    moves = {i: model.coordinates[i].move.field for i in model.indices(["sharpening"])}
    masks = [i for i, field in moves.items() if field in ("amounts", "threshold", "limit")]
    by_masks, by_all = (fit(objective, at, which, steps=6).point for which in (masks, list(moves)))
    left = {"masks": by_masks.error / at.error, "all": by_all.error / at.error}
    assert left["all"] < 0.1 and left["all"] < 0.4 * left["masks"], left
    in_light = next(
        i for i, c in enumerate(model.coordinates) if c.move.index == (1,) and c.move.field == "deconvolution"
    )
    assert by_all.z[in_light] > 0.3


def test_refits_side_by_side_are_those_of_one_after_the_other(monkeypatch):
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((4, 3), 1.1, np.float32))}
    names = ["vignetting", "sharpening", "saturation", "green_imbalance"]
    effects = [e for e in candidates(RAW_JPEG) if e.name in names]
    model = build(chain, params, gains, plain_freedom(), effects)
    light = jnp.concatenate([mosaics()] * 2)
    z = np.zeros(len(model.coordinates))
    for i in model.indices(["vignetting", "sharpening"]):
        z[i] = 2 * model.steps[i]
    mask = np.ones(light.shape, bool)
    pairs = Pairs(("a", "b", "c", "d"), light, model.render(z, light), mask)
    objective = PixelObjective.of(pairs, Split((0, 2), (1, 3)))
    _, at = screen(objective, objective.at(model, 0 * z), names)  # whose columns the fits start with
    parts = objective.units(at)[[1, 3]]
    whole, criteria = Whole(float(parts.mean()), parts), CRITERIA[RAW_JPEG]

    def one(name: str) -> np.ndarray:
        return refit(objective, at, name, whole, Bars(0.0), criteria, steps=2).z

    def found(count: int) -> list[np.ndarray]:
        monkeypatch.setattr(parallel.cores, "available", lambda: count)
        monkeypatch.setattr(parallel, "MOST", count)
        return parallel.parallel_map(one, names)

    np.testing.assert_array_equal(found(3), found(1))


def test_screening_keeps_the_products_of_all_columns_and_few_of_these(monkeypatch):
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((2, 3), 1.1, np.float32))}
    names = ["vignetting", "saturation", "green_imbalance"]
    effects = [e for e in candidates(RAW_JPEG) if e.name in names]
    model, light = build(chain, params, gains, plain_freedom(), effects), mosaics()
    z = np.zeros(len(model.coordinates))
    z[model.indices(["vignetting"])] = -0.3
    mask = np.ones(light.shape, bool)
    objective = PixelObjective.of(Pairs(("a", "b"), light, model.render(z, light), mask), Split((0,), (1,)))
    monkeypatch.setattr(pixels, "_PART", 1000)
    _, at = screen(objective, objective.at(model, 0 * z), names)
    assert sorted(at.columns) == model.base_indices
    every = objective.compute(at, range(len(z)))
    left = objective.residual(at)
    for which, normal in at.normals.items():
        columns = np.stack([every.columns[i].reshape(2, -1) for i in which], 1).astype(float)
        gram = np.einsum("nkp,nlp->nkl", columns, columns) / objective.counts[:, None, None]
        slope = np.einsum("nkp,np->nk", columns, left.reshape(2, -1)) / objective.counts[:, None]
        np.testing.assert_allclose(normal.gram, gram, rtol=1e-4, atol=1e-4 * gram.max())
        np.testing.assert_allclose(normal.slope, slope, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


def test_a_fit_in_parts_is_that_of_all_pairs_at_once(monkeypatch):
    chain, params = plain_camera("GRBG")
    gains = {"mosaic_white_balance": WhiteBalance(gains=np.full((2, 3), 1.1, np.float32))}
    effects = [e for e in candidates(RAW_JPEG) if e.name == "vignetting"]
    model, light = build(chain, params, gains, plain_freedom(), effects), mosaics()
    z = np.zeros(len(model.coordinates))
    which = model.indices(["vignetting"])
    z[which] = -0.3
    pictures = model.render(z, light)
    objective = PixelObjective.of(Pairs(("a", "b"), light, pictures, np.ones(light.shape, bool)))
    start = objective.at(model, 0 * z)
    whole = fit(objective, start, which, steps=1).point.z
    monkeypatch.setattr(pixels, "_MOST", 1)  # one pair at a time
    parts = fit(pixels.InParts(objective), start, which, steps=1).point.z
    np.testing.assert_allclose(parts, whole, rtol=1e-4)
    assert np.abs(parts[which]).min() > 0.05
