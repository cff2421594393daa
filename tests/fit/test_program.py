"""The Jacobian whose columns share what they do not change, against whole renders."""

import dataclasses

import numpy as np
import pytest

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.fit.journal import Journal
from jaxisp.fit.program import CHROMA, COLOURS, jacobian_shape, normal_equations
from jaxisp.fit.search import Options, Search, _again
from jaxisp.fit.solve import Fit
from jaxisp.fit.tiles import prepare

pytestmark = pytest.mark.optimised

COLUMNS = (
    ("geometry", "shift_x"),
    ("lateral_chromatic_aberration", "red_scale"),
    ("vignetting", "a2"),
    ("bilateral", "luma_sigma_range"),
    ("median", "strength"),
    ("gamma_compression", "gamma"),
    ("unsharp_mask", "amount"),
    ("chroma_subsampling", "vertical"),
)


@pytest.fixture(scope="module")
def fitted(own):
    shot = prepare(own[1])
    options = Options(2, "demosaic_malvar", "none", "camera", ())
    search = Search([shot], options, Journal.open(None, ""), lambda *_: None)
    design = dataclasses.replace(options.first, lens=True, median="cross", sampling=True)
    return Fit(search.problem, search.start, search.views(design), search.origin, design), search.origin


def solved(fit, given, vector, chunk):
    return normal_equations(fit.problem, given, vector, chunk, np.zeros(jacobian_shape(fit.problem)))


@pytest.mark.parametrize("column", COLUMNS, ids=".".join)
def test_a_column_is_the_slope_of_a_whole_render(fitted, column):
    fit, origin = fitted
    (view,) = fit.views
    chunk, given = view.chunks[0], fit.given(0)
    rng = np.random.default_rng(3)
    vector = fit.vector(origin, 0)
    vector += 0.02 * rng.standard_normal(vector.shape).astype(np.float32)
    index = fit.problem.columns.index(column)
    step = fit.problem.steps[index] * np.eye(len(vector), dtype=np.float32)[index]
    still = given._replace(moving=np.zeros_like(given.moving))
    before, after = (np.asarray(solved(fit, still, v, chunk).render) for v in (vector, vector + step))
    y, cb, cr = rgb_to_ycbcr_planes(*np.moveaxis(after - before, -1, 0))
    wanted = np.stack([y, CHROMA**0.5 * cb, CHROMA**0.5 * cr]) * chunk.mask / step[index]
    found = np.asarray(solved(fit, given, vector, chunk).jacobian[index]).reshape(wanted.shape)
    assert np.abs(wanted).max() > 0.01
    # what float32 keeps of a difference over so small a step
    np.testing.assert_allclose(found, wanted, atol=1e-6 / step[index])


def test_scores_are_the_gradient_by_the_colour_of_the_picture(fitted):
    """The reference: the same chunk with all but the pixels of one cell masked."""
    fit, origin = fitted
    (view,) = fit.views
    chunk = view.chunks[0]
    part = solved(fit, fit.given(0), fit.vector(origin, 0), chunk)
    scores, vector = np.asarray(part.scores), np.asarray(part.vector)
    size = np.abs(vector).max()
    np.testing.assert_allclose(scores.sum(axis=0), vector, atol=1e-4 * size)
    cells = np.floor(np.clip(np.asarray(chunk.target), 0, 0.999) * COLOURS) @ [COLOURS**2, COLOURS, 1]
    commonest = np.bincount(cells[np.asarray(chunk.mask) > 0].astype(int)).argmax()
    alone = chunk._replace(mask=chunk.mask * (cells == commonest).astype(np.float32))
    wanted = np.asarray(solved(fit, fit.given(0), fit.vector(origin, 0), alone).vector)
    np.testing.assert_allclose(scores[commonest], wanted, atol=1e-4 * size)
    assert np.abs(wanted).max() > 1e-3 * size


def test_what_does_not_move_has_no_slope(fitted):
    fit, origin = fitted
    (view,) = fit.views
    given = fit.given(0)
    moving = np.arange(len(given.moving)) % 2 == 0
    part = solved(fit, given._replace(moving=moving), fit.vector(origin, 0), view.chunks[0])
    slopes = np.abs(np.asarray(part.jacobian)).max(axis=1)
    assert (slopes[~moving] == 0).all() and (slopes[moving] > 0).mean() > 0.8


def test_a_step_by_another_choice_s_derivatives_is_nearly_one_by_its_own(fitted):
    fit, origin = fitted
    (view,) = fit.views
    design = dataclasses.replace(fit.design, demosaic="demosaic_bilinear", median="3x3")
    shot = view._replace(chunks=tuple(c._replace(source=0.98 * c.source) for c in view.chunks))
    other = Fit(fit.problem, fit.fixed, [shot], origin, design, scale=fit.scale)
    begun, own = other.objective(origin), other.run(origin, 1).objective
    near = other.beginning(origin, fit.equations(origin)).objective
    assert own < 0.9 * begun
    assert begun - near == pytest.approx(begun - own, rel=0.1)


def test_the_loss_of_slopes_is_that_of_a_render_to_the_bit(fitted):
    fit, origin = fitted
    assert fit.mean_loss(fit.slopes(origin)) == fit.loss(origin)


def test_steps_that_ended_by_themselves_end_there_again(fitted):
    """So that the search need not take them again; elsewhere they would go on."""
    fit, origin = fitted
    at, state = fit.equations(origin), origin
    for _ in range(9):
        state = fit.beginning(_again(state), at)
        if state.idle:
            break
    assert state.idle and state.objective < at.objective
    same = fit.beginning(_again(state), at)
    assert same.objective == state.objective
    np.testing.assert_array_equal(same.camera, state.camera)
    there = fit.beginning(_again(origin), at, fit.place(origin, at))
    np.testing.assert_array_equal(there.camera, fit.beginning(_again(origin), at).camera)
