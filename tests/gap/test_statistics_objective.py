"""How far simulated pictures are from real ones on average, whatever noise either has."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap import parallel
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.features.quantization import unknown_quantization
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.features.tolerances import noise_only, tolerances, units
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.gap.pairs.pairs import BORDER, Pairs, to_steps
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.search.refit import _climbed, nearest_form, refit
from jaxisp.gap.search.trial import Bars, Whole
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.noise import noise_indices, noisier
from jaxisp.testing import smooth_image

CLEAN = CRITERIA["clean+noisy"]

SIDE, COUNT, SHIFT = 80, 2, 0.03


@pytest.fixture(scope="module")
def begun():
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
    split, seen = Split((0,), (1,)), unknown_quantization((inner, inner))
    objective = StatisticsObjective.of(model, pairs, lambda light: to_steps(still), split, seen)
    return objective, objective.at(model, z)


def distorted(model, z, shift=SHIFT):
    moved = z.copy()
    moved[model.indices(["geometric_distortion"])[0]] = shift
    return moved


def quiet(model, z):
    moved = z.copy()
    for i in noise_indices(model):
        moved[i] = min(model.ranges[0, i], 0.0) if model.base[i].move.field in ("shot", "read") else 0.0
    return moved


def test_the_floor_is_the_chance_of_two_draws(begun):
    """Each half has one pair here, so that the mean square of a difference is twice the variance."""
    objective, at = begun
    found = objective.chance(at, draws=6)
    assert found.shape == (15, COUNT) and (found > 0).all()
    drawn = np.stack(
        [objective.measure.simulated(at.model, at.z, k) for k in range(20, 44)]
    )  # few statistics make most of it
    expected = (2 * objective.scale**2 * drawn.var(0, ddof=1)).mean(1)
    np.testing.assert_allclose(found.mean(0), expected, rtol=0.5)


def test_at_the_truth_only_the_noise_of_the_pictures_is_left(begun):
    objective, at = begun
    model, z = at.model, distorted(at.model, at.z)
    draws = np.stack([objective.measure.picture(model, z, k) for k in range(2, 8)])
    noise = draws.var(0, ddof=1).mean((1, 2, 3))
    np.testing.assert_allclose(objective.distances(model, z), noise, rtol=0.06)
    np.testing.assert_allclose(objective.scatter(model, z), noise, rtol=0.06)
    # of edges that are elsewhere
    at_rest = objective.distances(model, at.z) - objective.scatter(model, at.z)
    assert (at_rest > 0.3 * noise).all()


def test_a_warp_the_wrong_way_is_farther_than_none(begun):
    objective, at = begun
    right, none, wrong = (
        objective.distances(at.model, distorted(at.model, at.z, v)).mean() for v in (SHIFT, 0, -SHIFT)
    )
    assert right < 0.7 * none and wrong > none


def test_pixels_show_a_warp_by_what_of_their_distance_goes_beyond_the_noise(begun):
    """Begun at the truth and not moved: what goes is the distance of edges that were elsewhere."""
    objective, at = begun
    z, parts = distorted(at.model, at.z), objective.units(at)[[1]]
    whole, bars = Whole(float(parts.mean()), parts), Bars(0.99, plainly=-9.0)
    found = refit(objective, at, "geometric_distortion", whole, bars, CLEAN, steps=0, begin=z)
    far, near = (objective.distances(at.model, one)[1] for one in (at.z, z))
    noise = objective.scatter(at.model, z)[1]
    assert found.cleared > 0.8 and found.cleared == pytest.approx((far - near) / (far - noise), rel=0.1)
    part, _ = objective.fitted(at)
    assert found.shown(CLEAN) and found.accepted(CLEAN)
    assert found.error == pytest.approx(part.at(at.model, z).error)
    assert not dataclasses.replace(found, bars=Bars(0.99)).accepted(CLEAN)


def test_threads_find_the_same_columns(begun, monkeypatch):
    objective, at = begun
    found = []
    for most in (1, 4):
        monkeypatch.setattr(parallel, "MOST", most)
        found.append(objective.compute(at, at.model.base_indices[:6]).columns)
    assert found[0].keys() == found[1].keys() and at.columns == {}
    for i, column in found[0].items():
        np.testing.assert_array_equal(found[1][i], column)


def test_what_may_smooth_noise_is_tried_with_more_of_it(begun):
    z, model = begun[1].z, begun[1].model
    shot = noise_indices(model)[0]
    own, other = noisier(model, z, model.indices(["double_compression"])[0])
    known, usual = model.precisions > 0, other[0]
    assert known.any() and (usual[known] == model.usual[known]).all() and (own[0] == z).all()
    for ladder in (own, other):
        assert np.all(np.diff([p[shot] for p in ladder]) > 0)


def test_columns_that_follow_say_what_the_way_did(begun):
    """Broyden's condition: along the way they tell the change exactly; across it nothing has changed."""
    objective, at = begun
    which, sizes = at.model.base_indices[:4], at.model.steps
    at = objective.compute(at, which)
    step = np.array([2.0, -1.0, 0.5, 0.0]) * sizes[which]
    z = at.z.copy()
    z[which] += step
    there = objective.at(at.model, z)
    turned = objective.follow(at, there).columns
    told = sum(turned[i] * d for i, d in zip(which, step))
    change = objective._state(there) - objective._state(at)
    np.testing.assert_allclose(told, change, rtol=1e-6, atol=1e-8)
    across = {which[0]: 1.0, which[1]: 2.0}  # in units of their probes
    was, now = (sum(c[i] * d * sizes[i] for i, d in across.items()) for c in (at.columns, turned))
    np.testing.assert_allclose(now, was, rtol=1e-6, atol=1e-8)
    assert there.columns == {}


def test_where_it_has_looked_it_does_not_look_again(begun):
    """It knows a model and a place by their values, whatever objects they are."""
    objective, at = begun
    z, model = distorted(at.model, at.z, 0.01), at.model
    seen = objective.at(model, z).shown
    again = objective.at(model.with_shared(dict(model.shared)), z.copy()).shown
    assert all(one is other for one, other in zip(again, seen))
    noise = model.shared["balanced_noise"]
    more = {"balanced_noise": dataclasses.replace(noise, shot=2 * noise.shot)}
    louder = model.with_shared(model.shared | more)
    assert louder.key != model.key and objective.at(louder, z).shown[0] is not seen[0]


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

    def of(pairs):
        """The objective in its units, and z = 0 with the columns of the base."""
        seen = unknown_quantization((inner, inner))
        objective = StatisticsObjective.of(model, pairs, lambda light: still, split, seen)
        objective = objective.with_unit(objective.at(model, z))
        return objective, objective.compute(objective.at(model, z), model.base_indices)

    objective, at = of(pairs)
    assert nearest_form(objective, at, "chroma_subsampling", CLEAN)[own].tolist() == [1, 1, 0, 1]
    assert nearest_form(objective, at, "prnu", CLEAN) is None
    plain = model.render(z, light, objective.measure.keys(1))
    objective, at = of(dataclasses.replace(pairs, pictures=plain))
    assert nearest_form(objective, at, "chroma_subsampling", CLEAN) is None


def test_a_ladder_is_climbed_as_long_as_the_error_falls():
    asked = []

    class Vee:
        def at(self, model, z):
            asked.append(float(z[0]))
            return Point(model, z, np.array([abs(z[0] - 2.0) + z[1]]))

    ladders = [[np.array([k, base]) for k in range(9)] for base in (0.5, 0.0)]
    assert _climbed(ladders, Vee(), None).z.tolist() == [2.0, 0.0]
    assert sorted(asked[:-1]) == [0, 0, 1, 1, 2, 2, 3, 3]


def test_a_fit_minds_what_it_spoils(begun):
    """What was right at the base counts as much, once it is wrong, as what was wrong there."""
    objective, at = begun
    objective = objective.with_unit(at)
    objective = objective.with_unit(at, emphasise=True)
    part, _ = objective.fitted(at)
    wrong = part.emphasis > 20
    assert wrong.any() and (part.emphasis == 1).any()
    unit = np.sqrt(part.weights)[None]
    np.testing.assert_array_equal(part.spoiled(np.where(wrong, 4.0, 0.9) * unit), 1)
    spoilt = part.spoiled(np.full_like(unit, 5.0) * unit)[0]
    np.testing.assert_allclose(spoilt, np.sqrt(np.maximum(25 / part.emphasis, 1)))
    assert (objective.spoiled(np.full_like(unit, 5.0) * unit) == 1).all()  # the gap is measured as it was


def test_a_fit_takes_the_error_of_pixels_along(begun):
    """Where the lens is, the blocks are right; of a pattern's place they say nothing."""
    objective, at = begun
    part, here = objective.with_unit(at, emphasise=True).fitted(at)
    (stats, blocks), model, z = here.shown, here.model, distorted(here.model, here.z)
    there = part.at(model, z)
    off = [((part.measure.tones - b) ** 2).mean() for b in (blocks, there.shown[1])]
    assert off[1] < 0.6 * off[0]
    noisy = here.z.copy()
    noisy[model.indices(["prnu"])] = 0.05
    patterned = part.at(model, noisy).shown
    np.testing.assert_array_equal(patterned[1], blocks)
    means = noise_only() == 0
    np.testing.assert_allclose(patterned[0][:, means], stats[:, means], rtol=1e-6)
    assert (patterned[0][:, ~means] != stats[:, ~means]).any()
    np.testing.assert_array_equal(model.still(noisy + z), z)
    own = part.scale * (part.measure.real - there.shown[0])
    statistical = ((own * part.spoiled(own)) ** 2).mean()
    assert there.error == pytest.approx(statistical * (off[1] + 0.25) / (off[0] + 0.25))
    assert here.error > there.error


def test_the_normal_equations_of_a_fit_follow_its_error(begun):
    objective, at = begun
    part, here = objective.with_unit(at, emphasise=True).fitted(at)
    i = here.model.base_indices[-3]  # of the tone curve
    gram, slope = (a.mean() for a in part.normal(part.compute(here, [i]), [i]))
    step = here.model.steps[i]
    moved = here.z.copy()
    moved[i] += step
    predicted = here.error - 2 * step * slope + step**2 * gram
    assert part.at(here.model, moved).error == pytest.approx(predicted, rel=0.1)


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


def test_a_stamp_is_a_matter_of_place_not_of_tails(begun):
    objective, at = begun
    objective = objective.with_unit(at)
    measure, place = objective.measure, np.zeros(objective.measure.target.shape[1:3], bool)
    place[40:43, 20:50] = True
    target = measure.target + 60 * place[..., None] * np.float32([1, -1, 1])
    real = measure.measured(target, measure.reference)
    stamped = dataclasses.replace(objective, measure=dataclasses.replace(measure, target=target, real=real))
    rows, found = stamped.located_with(at, place)
    share, found = ({row["axis"]: row["share"] for row in own} for own in (rows, found))
    assert found["fixed_pattern"] > share["fixed_pattern"] + 0.1 and found["tail"] < 0.5 * share["tail"]
    assert sum(found.values()) == pytest.approx(sum(share.values()))
    rows, found = stamped.located_with(at, ~place & place)
    assert found is rows


def test_what_a_reference_is_off_by_is_taken_off(begun):
    """Beside itself as the reference a set has no gap; what only several pairs show is left in one alone."""
    objective, at = begun
    off = objective.measure.real - objective.measure.simulated(at.model, at.z)
    less = dataclasses.replace(objective, measure=objective.measure.less(off))
    assert np.abs(less.difference(less.at(at.model, at.z))).max() < 1e-4
    part, there = less.fitted(less.at(at.model, at.z))
    assert there.error == pytest.approx(0, abs=1e-3)
    again = less.measure.measured_real(less.measure.target)
    np.testing.assert_allclose(again, less.measure.real, atol=1e-6)
    np.testing.assert_array_equal(part.measure.offset, off[:1])
