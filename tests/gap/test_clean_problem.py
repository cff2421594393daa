"""How far simulated pictures are from real ones on average, whatever noise either has."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap import parallel
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.base.raw_jpeg import candidates
from jaxisp.gap.case import Split
from jaxisp.gap.features.quantization import unknown_codes
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.objective import statistics
from jaxisp.gap.objective.pixels import BORDER, Pairs, to_steps
from jaxisp.gap.objective.starts import noise_indices
from jaxisp.gap.objective.statistics import StatisticsProblem
from jaxisp.gap.objective.tolerances import noise_only, tolerances, units
from jaxisp.gap.search.refit import Whole, _climbed, nearest_form, refit
from jaxisp.testing import smooth_image

pytestmark = pytest.mark.optimised

SIDE, COUNT, SHIFT = 80, 2, 0.03


@pytest.fixture(scope="module")
def problem():
    """Two pictures of a camera whose lens distorts, before the camera without."""
    camera = Camera(None)
    effects = [
        e
        for e in candidates("clean+noisy")
        if e.name in ("geometric_distortion", "double_compression", "prnu")
    ]
    model = camera.whole_model(camera.mean_model({}), effects)
    rng = np.random.default_rng(4)
    tiles = 0.3 * (rng.random((COUNT, SIDE // 8, SIDE // 8)) > 0.5).repeat(8, 1).repeat(8, 2)
    grey = [smooth_image((SIDE, SIDE), k) + own for k, own in enumerate(tiles)]
    light = jnp.asarray(np.stack([g[..., None] * [0.5, 0.45, 0.4] for g in grey]), jnp.float32)
    z = np.zeros(len(model.coordinates))
    pictures = model.render(distorted(model, z), light, jax.random.split(jax.random.key(7), COUNT))
    still = model.render(quiet(model, z), light, jax.random.split(jax.random.key(0), COUNT))
    pairs = Pairs(("a", "b"), light, pictures, np.ones((COUNT, SIDE, SIDE), bool))
    inner = SIDE - 2 * BORDER
    split, seen = Split((0,), (1,)), unknown_codes((inner, inner))
    return StatisticsProblem(model, pairs, lambda light: to_steps(still), split, seen)


def distorted(model, z, shift=SHIFT):
    moved = z.copy()
    moved[model.indices(["geometric_distortion"])] = shift
    return moved


def quiet(model, z):
    moved = z.copy()
    for i in noise_indices(model):
        moved[i] = min(model.ranges[0, i], 0.0) if model.base[i].move.field in ("shot", "read") else 0.0
    return moved


def test_at_the_truth_only_the_noise_of_the_pictures_is_left(problem):
    z = distorted(problem.model, problem.z)
    draws = np.stack([problem.picture(z, k) for k in range(2, 8)])
    noise = draws.var(0, ddof=1).mean((1, 2, 3))
    np.testing.assert_allclose(problem.distances(z), noise, rtol=0.06)
    np.testing.assert_allclose(problem.scatter(z), noise, rtol=0.06)
    at_rest = problem.distances(problem.z) - problem.scatter(problem.z)  # of edges that are elsewhere
    assert (at_rest > 0.3 * noise).all()


def test_a_warp_the_wrong_way_is_farther_than_none(problem):
    right, none, wrong = (
        problem.distances(distorted(problem.model, problem.z, v)).mean() for v in (SHIFT, 0, -SHIFT)
    )
    assert right < 0.7 * none and wrong > none


def test_pixels_show_a_warp_by_what_of_their_distance_goes_beyond_the_noise(problem):
    """Begun at the truth and not moved: what goes is the distance of edges that were elsewhere."""
    z = distorted(problem.model, problem.z)
    parts = problem.units(problem.z)[[1]]
    found = refit(
        problem, "geometric_distortion", problem.split, Whole(float(parts.mean()), parts), 0.99,
        steps=0, begin=z, plainly=-9.0,
    )  # fmt: skip
    far, near, noise = problem.distances(problem.z)[1], problem.distances(z)[1], problem.scatter(z)[1]
    assert found.cleared > 0.8 and found.cleared == pytest.approx((far - near) / (far - noise), rel=0.1)
    assert found.shown and found.accepted and found.error == pytest.approx(problem.take((0,)).errors(z)[0])
    assert not dataclasses.replace(found, plainly=np.inf).accepted


def test_threads_find_the_same_columns(problem, monkeypatch):
    found = []
    for most in (1, 4):
        monkeypatch.setattr(parallel, "MOST", most)
        problem.move_to(problem.z)
        problem.compute(problem.model.base_indices[:6])
        found.append(problem.columns)
    assert found[0].keys() == found[1].keys()
    for i, column in found[0].items():
        np.testing.assert_array_equal(found[1][i], column)


def test_what_may_smooth_noise_is_tried_with_more_of_it(problem):
    z, model = problem.z, problem.model
    shot = noise_indices(model)[0]
    own, other = problem.noisier(z, model.indices(["double_compression"])[0])
    known, usual = model.precisions > 0, other[0]
    assert known.any() and (usual[known] == model.usual[known]).all() and (own[0] == z).all()
    for ladder in (own, other):
        assert np.all(np.diff([p[shot] for p in ladder]) > 0)


def test_columns_that_follow_say_what_the_way_did(problem):
    """Broyden's condition: along the way they tell the change exactly; across it nothing has changed."""
    problem.move_to(problem.z)
    z, which = problem.z.copy(), problem.model.base_indices[:4]
    problem.compute(which)
    columns, before = problem.columns, problem._state()
    step = np.array([2.0, -1.0, 0.5, 0.0]) * problem.model.steps[which]
    there = z.copy()
    there[which] += step
    problem.follow(there)
    turned = problem.columns
    told = sum(turned[i] * d for i, d in zip(which, step))
    np.testing.assert_allclose(told, problem._state() - before, rtol=1e-6, atol=1e-8)
    across = {which[0]: 1.0, which[1]: 2.0}  # in units of their probes
    sizes = problem.model.steps
    was, now = (sum(c[i] * d * sizes[i] for i, d in across.items()) for c in (columns, turned))
    np.testing.assert_allclose(now, was, rtol=1e-6, atol=1e-8)
    problem.move_to(z)


def test_where_it_has_looked_it_does_not_look_again(problem, monkeypatch):
    z = distorted(problem.model, problem.z, 0.01)
    seen = problem.errors(z)
    monkeypatch.setattr(problem, "picture", None)
    np.testing.assert_array_equal(problem.errors(z.copy()), seen)
    with pytest.raises(TypeError):  # another model's point is another
        monkeypatch.setattr(problem, "model", problem.model.with_shared(problem.model.shared))
        problem.errors(z)


def test_a_form_that_is_exact_is_found_as_it_is():
    """Repeated averages of two by two, which numbers that move freely from nothing end beside."""
    camera = Camera(None)
    effects = [e for e in candidates("clean+noisy") if e.name in ("chroma_subsampling", "prnu")]
    model = camera.whole_model(camera.mean_model({}), effects)
    rng = np.random.default_rng(5)
    light = np.stack([[smooth_image((SIDE, SIDE), 3 * k + c) for c in range(3)] for k in range(COUNT)])
    light += 0.2 * (rng.random((COUNT, 3, SIDE // 8, SIDE // 8)) > 0.5).repeat(8, 2).repeat(8, 3)
    light = jnp.asarray(0.6 * np.moveaxis(light, 1, -1), jnp.float32)
    z, own = np.zeros(len(model.coordinates)), model.indices(["chroma_subsampling"])
    halved = z.copy()
    halved[own] = 1, 1, 0, 1
    pictures = model.render(halved, light, jax.random.split(jax.random.key(7), COUNT))
    still = to_steps(model.render(quiet(model, z), light, jax.random.split(jax.random.key(0), COUNT)))
    pairs = Pairs(("a", "b"), light, pictures, np.ones((COUNT, SIDE, SIDE), bool))
    inner, split = SIDE - 2 * BORDER, Split((0,), (1,))
    problem = StatisticsProblem(model, pairs, lambda light: still, split, unknown_codes((inner, inner)))
    problem.set_unit()
    problem.compute(model.base_indices)
    assert nearest_form(problem, "chroma_subsampling", split)[own].tolist() == [1, 1, 0, 1]
    assert nearest_form(problem, "prnu", split) is None
    problem.pairs = dataclasses.replace(pairs, pictures=model.render(z, light, problem.keys(1)))
    problem.target = to_steps(problem.pairs.pictures[problem.inner])
    problem.real = problem.measured(problem.target, problem.reference)
    del problem._fitted
    problem.move_to(z)
    problem.compute(model.base_indices)
    assert nearest_form(problem, "chroma_subsampling", split) is None


def test_a_ladder_is_climbed_as_long_as_the_error_falls(problem, monkeypatch):
    asked = []

    def errors(z):
        asked.append(float(z[0]))
        return np.array([abs(z[0] - 2.0) + z[1]])

    monkeypatch.setattr(problem, "errors", errors)
    ladders = [[np.array([k, base]) for k in range(9)] for base in (0.5, 0.0)]
    assert _climbed(ladders, problem, [0]).tolist() == [2.0, 0.0]
    assert sorted(asked) == [0, 0, 1, 1, 2, 2, 3, 3]


def test_a_fit_minds_what_it_spoils(problem):
    """What was right at the base counts as much, once it is wrong, as what was wrong there."""
    problem.set_unit()
    problem.set_unit(emphasise=True)
    part = problem.take([0])
    wrong = part._emphasis > 20
    assert wrong.any() and (part._emphasis == 1).any()
    unit = np.sqrt(part._weights)[None]
    np.testing.assert_array_equal(part._spoiled(np.where(wrong, 4.0, 0.9) * unit), 1)
    spoilt = part._spoiled(np.full_like(unit, 5.0) * unit)[0]
    np.testing.assert_allclose(spoilt, np.sqrt(np.maximum(25 / part._emphasis, 1)))
    assert (problem._spoiled(np.full_like(unit, 5.0) * unit) == 1).all()  # the gap is measured as it was


def test_a_fit_takes_the_error_of_pixels_along(problem):
    """Where the lens is, the blocks are right; of a pattern's place they say nothing."""
    part = problem.take([0])
    here, (stats, blocks) = part.errors(part.z), part._seen(part.z)
    z = distorted(part.model, part.z)
    there = part._seen(z)
    off = [((part._tones - b) ** 2).mean() for b in (blocks, there[1])]
    assert off[1] < 0.6 * off[0]
    noisy = part.z.copy()
    noisy[part.model.indices(["prnu"])] = 0.05
    patterned = part._seen(noisy)
    np.testing.assert_array_equal(patterned[1], blocks)
    means = noise_only() == 0
    np.testing.assert_allclose(patterned[0][:, means], stats[:, means], rtol=1e-6)
    assert (patterned[0][:, ~means] != stats[:, ~means]).any()
    np.testing.assert_array_equal(part.model.still(noisy + z), z)
    own = part._scale * (part.real - there[0])
    statistical = ((own * part._spoiled(own)) ** 2).mean()
    assert part.errors(z).mean() == pytest.approx(statistical * (off[1] + 0.25) / (off[0] + 0.25))
    assert here.mean() > part.errors(z).mean()


def test_the_normal_equations_of_a_fit_follow_its_error(problem):
    part = problem.take([0])
    i = part.model.base_indices[-3]  # of the tone curve
    part.compute([i])
    gram, slope = (a.mean() for a in part.normal([i]))
    step = part.model.steps[i]
    moved = part.z.copy()
    moved[i] += step
    predicted = part.errors(part.z).mean() - 2 * step * slope + step**2 * gram
    assert part.errors(moved).mean() == pytest.approx(predicted, rel=0.1)


def test_units_grow_where_quarters_of_the_frame_differ():
    names = np.array(feature_names())
    chance, even = np.full((1, len(names)), 1e-4), np.zeros((1, len(names)))
    at_rest = units(chance, even)
    np.testing.assert_allclose(at_rest[0], tolerances() ** 2 + 1e-4)
    peak, edge = names == "pattern tail peaks", names == "logvar edge Y"
    few = units(chance, even + 4.0 * peak)
    assert few[0, peak] >= 4.0  # alone, and a little for all of its group
    others = units(chance, even + 4.0 * edge)
    grown = np.array(["edge" in n and not n.startswith("mean") for n in names])
    assert (others[0, grown] > 2 * at_rest[0, grown]).all() and (others[0, edge] < 4.0).all()
    np.testing.assert_array_equal(others[0, ~grown], at_rest[0, ~grown])


def test_a_stamp_is_a_matter_of_place_not_of_tails(problem, monkeypatch):
    place = np.zeros(problem.target.shape[1:3], bool)
    place[40:43, 20:50] = True
    stamped = copy.copy(problem)
    stamped.set_unit()
    stamped.target = problem.target + 60 * place[..., None] * np.float32([1, -1, 1])
    stamped.real = stamped.measured(stamped.target, stamped.reference)
    stamped.move_to(stamped.z)
    monkeypatch.setattr(statistics, "in_one_place", lambda residual, scenes: place)
    rows = stamped.located([1])
    share = {row["axis"]: row["share"] for row in rows}
    found = {row["axis"]: row["share"] for row in stamped.credited(rows, [1])}
    assert found["fixed_pattern"] > share["fixed_pattern"] + 0.1 and found["tail"] < 0.5 * share["tail"]
    assert sum(found.values()) == pytest.approx(sum(share.values()))
    monkeypatch.setattr(statistics, "in_one_place", lambda residual, scenes: ~place & place)
    assert stamped.credited(rows, [1]) is rows
