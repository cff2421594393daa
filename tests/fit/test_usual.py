"""What a fit falls back on where its pairs are silent."""

import numpy as np
import pytest

from jaxisp.colorimetry import primaries_to_xyz
from jaxisp.fit import model
from jaxisp.fit.begin import _near_usual
from jaxisp.fit.journal import Journal
from jaxisp.fit.search import Options, Search
from jaxisp.fit.solve import PATCH, patch_at
from jaxisp.fit.state import Equations, Place
from jaxisp.fit.tiles import halved, prepare
from jaxisp.fit.usual import (
    CURVE_DIRECTIONS,
    CURVE_MEAN,
    CURVE_REST,
    LOOK,
    MATRIX_COVARIANCE,
    MATRIX_MEAN,
    P3_PRIMARIES,
    deviations,
    entries,
    log_slopes,
    usual_matrix,
)
from jaxisp.io.color_space import D65, SRGB_PRIMARIES
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.power import Gamma
from tests.fit.conftest import example


def test_the_usual_matrix_keeps_grey_and_deviates_from_nothing():
    start = model.start()
    matrix = usual_matrix()
    np.testing.assert_allclose(matrix.sum(axis=1), 1)
    found = deviations(start | {"color_matrix": ColorMatrix(matrix=matrix)}, start)
    for name in ("color_matrix", "cast", "brightness", "saturation", "filters", "lateral", "distortion"):
        np.testing.assert_allclose(found[name], 0, atol=1e-4, err_msg=name)


def test_a_matrix_deviates_by_its_mahalanobis_distance_whatever_its_gains():
    start, step = model.start(), np.asarray([0.1, -0.05, 0.02, 0.08, 0.0, -0.2])
    matrix = usual_matrix()
    matrix[~np.eye(3, dtype=bool)] += step
    matrix += np.diag(1 - matrix.sum(axis=1))
    scaled = ColorMatrix(matrix=matrix * [[1.5], [1.2], [0.9]])
    found = deviations(start | {"color_matrix": scaled}, start)["color_matrix"]
    covariance = MATRIX_COVARIANCE + LOOK**2 * np.eye(6)
    assert float(found @ found) == pytest.approx(step @ np.linalg.inv(covariance) @ step, rel=1e-3)


def test_where_no_file_states_the_colour_space_half_the_cameras_write_display_p3():
    """Against draws of the cameras, whose colours are taken to P3 by XYZ and back."""
    rng = np.random.default_rng(4)
    drawn = rng.multivariate_normal(MATRIX_MEAN, MATRIX_COVARIANCE, 40000)
    off = ~np.eye(3, dtype=bool)
    matrices = np.zeros((len(drawn), 3, 3))
    matrices[:, off] = drawn
    matrices += (1 - matrices.sum(axis=2))[:, :, None] * np.eye(3)
    to_xyz = [primaries_to_xyz(p, D65) for p in (SRGB_PRIMARIES, P3_PRIMARIES)]
    matrices[::2] = np.linalg.inv(to_xyz[1]) @ to_xyz[0] @ matrices[::2]
    np.testing.assert_allclose(matrices.sum(axis=2), 1, atol=1e-9)
    mean, covariance = entries(False)
    np.testing.assert_allclose(matrices[:, off].mean(axis=0), mean, atol=0.01)
    np.testing.assert_allclose(np.cov(matrices[:, off].T) + LOOK**2 * np.eye(6), covariance, atol=4e-3)


def test_the_curve_is_that_of_its_three_stages():
    gamma = model.start() | {"gamma_compression": Gamma(gamma=1.5)}
    wanted = np.log(8 * np.diff((np.arange(9) / 8) ** (1 / 1.5)))
    np.testing.assert_allclose(log_slopes(gamma), wanted, atol=2e-3)
    covariance = CURVE_DIRECTIONS.T @ CURVE_DIRECTIONS + CURVE_REST * np.eye(8)
    off = wanted - CURVE_MEAN
    found = deviations(gamma, model.start())["curve"]
    assert float(found @ found) == pytest.approx(off @ np.linalg.solve(covariance, off), rel=0.01)


def test_a_start_on_one_hue_takes_the_others_from_real_cameras():
    """Least squares alone would give any matrix that renders this hue."""
    rng = np.random.default_rng(0)
    truth = usual_matrix() + 0.05 * rng.normal(size=(3, 3))
    grey = rng.uniform(0.1, 0.9, (500, 1)) * [1.0, 0.8, 0.7] + 0.005 * rng.normal(size=(500, 3))
    noisy = grey @ truth.T + 0.02 * rng.normal(size=(500, 3))
    plain = np.linalg.lstsq(grey, noisy, rcond=None)[0].T
    errors = [np.abs(found - truth).max() for found in (_near_usual(grey, noisy), plain)]
    assert errors[0] < 0.2 < errors[1]
    every = rng.uniform(0.1, 0.9, (5000, 3))  # where all hues are there, they say
    other = np.eye(3)
    np.testing.assert_allclose(_near_usual(every, every @ other.T), other, atol=0.02)


def _equations(scores, curvature, variance):
    zero = np.zeros(0)
    # a loss of two variances a pixel
    return Equations(0, zero, zero, curvature, scores, 2 * variance * 1e6, 1e6, zero, None)


@pytest.mark.parametrize("patch", (50.0, 400.0))
def test_how_many_pixels_count_as_one_is_read_from_the_scores(patch):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * 100
    curvature, variance = root @ root.T, 1e-4
    factor = np.linalg.cholesky(curvature)
    scores = np.sqrt(patch * variance / 800) * rng.normal(size=(800, 6)) @ factor.T
    some = np.arange(1, 5)
    for own in np.arange(6), some:
        found = patch_at(_equations(scores, curvature, variance), own)
        assert found == pytest.approx(patch, rel=0.1)
    assert patch_at(_equations(scores / 1000, curvature, variance), some) == PATCH
    assert patch_at(_equations(scores[:1], curvature, variance), some) == PATCH  # one says nothing
    scores[:, 5] *= 10  # of another kind
    assert patch_at(_equations(scores, curvature, variance), some) == pytest.approx(patch, rel=0.1)


@pytest.fixture(scope="module")
def search(folder):
    options = Options(1, "demosaic_malvar", "none", "camera", ("saturation",))
    return Search([prepare(example(folder))], options, Journal.open(None, ""), lambda *_: None)


def test_the_pull_has_the_gradient_that_it_says(search):
    fit, state = search._fit(search.options.first), search.origin
    rng = np.random.default_rng(2)
    size = len(fit._hold)
    state = state.moved(0.1 * rng.normal(size=size))
    _, gradient, _ = fit._pull(state)
    step = 1e-2 * rng.normal(size=size)
    difference = fit._pull(state.moved(step))[0] - fit._pull(state.moved(-step))[0]
    assert difference == pytest.approx(4 * gradient @ step, rel=0.02)


def test_of_many_choices_those_nearest_to_the_picture_get_a_step(search, monkeypatch):
    designs = [model.Design(name) for name in model.DEMOSAICKERS]
    far = dict(zip(designs, [7, 1, 9, 3, 8, 2, 12, 11, 10, 5, 4, 6, 13]))

    class Told:
        def __init__(self, design):
            self.design = design

        def place(self, state, near):
            return Place(far[self.design], np.zeros(0), 0.0, np.zeros(0))

    monkeypatch.setattr(search, "_fit", Told)
    kept = search._nearest(designs, search.origin, lambda: None)
    assert [far[d] for d, _ in kept] == [place.objective for _, place in kept] == [1, 2, 3, 4, 5]
    assert search._nearest(designs[:5], search.origin, lambda: None) == [(d, None) for d in designs[:5]]


def test_halves_have_each_fitted_pixel_once(search):
    (shot,) = search.shots
    left, right = halved(shot)
    masks = [sum(float(c.mask.sum()) for c in s.chunks) for s in (shot, left, right)]
    assert masks[0] == masks[1] + masks[2] and min(masks) > 0
    for half, sign in (left, -1), (right, 1):
        for chunk in half.chunks:
            tile, _, column = np.nonzero(chunk.mask)
            at = chunk.place[tile, 1] + 16 + column
            assert (np.sign(at) == sign).all()
