"""Where the fit of a noise begins, and how what the fitted pairs show decides what counts."""

import numpy as np
import pytest

from jaxisp.gap.base.palette import TYPICAL
from jaxisp.gap.base.plain_clean import Camera, primaries
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.features.tolerances import emphasis, emphasised, group_of, weights
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.model import MIXING
from jaxisp.gap.simulator.noise import informed_by_noise, noise_indices, noisier, placed, starts

READ, SHOT = 0.004, 4e-4  # the defaults of the stage


@pytest.fixture(scope="module")
def model():
    camera = Camera(None)
    return camera.whole_model(camera.mean_model({}), candidates("clean+noisy"))


def test_what_is_added_is_taken_from_read_noise(model):
    z = np.zeros(len(model.coordinates))
    row, read = model.indices(["row_noise"])[0], noise_indices(model)[1]
    moved = placed(model, z, row, 0.002)
    assert moved[row] == 0.002 and (READ + moved[read]) ** 2 + 0.002**2 == pytest.approx(READ**2, rel=1e-4)
    back = placed(model, moved, row, 0.0)
    np.testing.assert_allclose(back, z, atol=1e-7)
    assert READ + placed(model, z, row, 0.05)[read] > 0  # never below what its range allows
    blur = model.indices(["optical_blur"])[0]
    assert np.flatnonzero(placed(model, z, blur, 0.5)).tolist() == [blur]


def flat(ladders):
    return [point for ladder in ladders for point in ladder]


def test_a_noise_starts_at_several_strengths_and_a_blur_where_it_is(model):
    z = np.zeros(len(model.coordinates))
    own = model.indices(["film_grain"])
    (ladders,) = starts(model, z, own)
    found = flat(ladders)
    strengths = {round(float(p[own[0]]), 6) for p in found}
    assert len(strengths) > 4 and min(strengths) == 0
    shot = noise_indices(model)[0]
    assert {round(float((SHOT + p[shot]) / SHOT), 2) for p in found} == {1.0, 0.75, 0.5}
    assert starts(model, z, model.indices(["optical_blur"])) == [] == starts(model, z, [])
    smoothing = model.indices(["chroma_subsampling"])
    at_rest, *strong = starts(model, z, smoothing)
    assert flat(at_rest) == [z] and len(strong) == 4
    assert all(len({tuple(p[smoothing]) for p in flat(own)}) == 1 for own in strong)
    forms = [z, *(p for own in strong for p in flat(own))]
    assert {tuple(p[smoothing]) for p in forms} >= {(0, 0, 0, 0), (1, 1, 0, 1)}
    assert max((SHOT + p[shot]) / SHOT for p in forms) > 10  # the base imitates it by less noise
    some = [p for own in starts(model, z, smoothing[1:]) for p in flat(own)]  # the first is left open
    assert {tuple(p[smoothing]) for p in some} >= {(0, 0, 0, 0), (0, 1, 0, 1)}
    moved = [*own, *noise_indices(model)]
    for p in found:
        assert (p[moved] >= model.ranges[0, moved] - 1e-9).all()
        assert (p[moved] <= model.ranges[1, moved] + 1e-9).all()


def test_what_smooths_starts_from_usual_colours_too():
    camera = Camera(None, share=0.1)
    mean = camera.mean_model({})
    model = camera.whole_model(mean, candidates("clean+noisy"))
    z = np.zeros(len(model.coordinates))
    quality, row = (model.indices([name])[0] for name in ("double_compression", "row_noise"))
    found = [model.params(p)[MIXING].matrix for p in flat(noisier(model, z, quality))]
    usual = primaries(np.eye(3) + Camera.share * TYPICAL)[MIXING].matrix
    assert sum(np.allclose(m, usual, atol=1e-6) for m in found) == len(found) // 2
    assert (
        sum(np.allclose(m, mean.shared[MIXING].matrix, atol=1e-6) for m in found)
        == len(found) - len(found) // 2
    )
    assert flat(noisier(model, z, row)) == [z]
    assert [model.base[i].node for i in informed_by_noise(model)] == 4 * ["balanced_noise"] + 6 * [MIXING]


def test_what_has_more_of_the_gap_counts_more():
    names = feature_names()
    squares = np.full(len(names), 0.5)
    np.testing.assert_allclose(emphasised(weights(), emphasis(squares)), weights())
    k = names.index("corr row Y")
    squares[k] = 20
    found = emphasised(weights(), emphasis(squares))
    assert found.mean() == pytest.approx(1) and found[k] / weights()[k] > 15 * (found[0] / weights()[0])


def test_groups_are_axes_and_kinds():
    assert group_of("mean radius Y gain") != group_of("logvar radius Y")
    assert group_of("logvar intensity Y0") != group_of("code intensity dark00") == "code intensity"
