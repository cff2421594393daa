"""What a fit minimises, against closed forms and SciPy; the columns of this problem do not change."""

import dataclasses

import numpy as np
import pytest
import scipy.optimize

from jaxisp.gap.base.priors import Prior
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.simulator.effects import Move
from jaxisp.gap.simulator.model import Coordinate
from tests.gap import toy

RNG = np.random.default_rng(2)
DESIGN, TARGET = RNG.normal(size=(40, 3)), RNG.normal(size=40)


def model(spreads=(np.inf,) * 3, usual=(0.0,) * 3):
    """Of three numbers that a base has."""
    moves = [Move("x", 0.1, -9.0, 9.0, usual=u, spread=s) for s, u in zip(spreads, usual)]
    return dataclasses.replace(
        toy.model(()), base=tuple(Coordinate(f"base{k}", m) for k, m in enumerate(moves))
    )


def line():
    return toy.Line(TARGET[None], DESIGN, np.zeros(40), Split((0,), ()), ("a",))


def fitted(objective, own, times=1, **how):
    """Where so many fits end, one from where another did: each stops where a step gains little."""
    at = objective.at(own, np.zeros(3))
    for _ in range(times):
        end = fit(objective, at, range(3), steps=20, **how)
        at = end.point.with_columns({})
    return end


def test_a_fit_with_a_prior_is_ridge_regression():
    prior = Prior(RNG.normal(size=(2, 3)), np.array([1.0, -2.0]), 0.7)
    found = fitted(line(), model(), prior=prior).point.z
    rows = np.concatenate([DESIGN / np.sqrt(40), np.sqrt(0.7) * prior.rows])
    wanted = np.concatenate([TARGET / np.sqrt(40), np.sqrt(0.7) * prior.wanted])
    np.testing.assert_allclose(found, np.linalg.lstsq(rows, wanted, rcond=None)[0], atol=2e-3)


@pytest.mark.parametrize("usual", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.05)])
@pytest.mark.parametrize("spreads", [(np.inf, 0.02, 0.05), (0.01, 0.01, 0.01), (np.inf,) * 3])
def test_moves_cost_a_hundredth_of_the_error_for_each_spread_squared(spreads, usual):
    own, objective, weights = model(spreads, usual), line(), np.array(spreads) ** -2.0
    found = fitted(objective, own, times=8).point.z
    best = scipy.optimize.minimize(
        lambda z: objective.at(own, z).error * (1 + 0.01 * weights @ (z - usual) ** 2), np.zeros(3), tol=1e-12
    )
    np.testing.assert_allclose(found, best.x, atol=1e-3 * np.abs(best.x).max())


class Bent(toy.Line):
    """Curved, with columns that are secants; `asked` counts how often they are computed."""

    def __init__(self):
        super().__init__(TARGET[None], DESIGN, np.zeros(40), Split((0,), ()), ("a",))
        self.__dict__["asked"] = []

    def at(self, model, z):
        left = self.wanted - DESIGN @ np.expm1(z)
        return Point(model, z, (left**2).mean(1), (left,))

    def compute(self, point, which, steps=None):
        if not set(which) - set(point.columns):
            return point
        self.asked.append(point.z)
        moved = [self.at(point.model, point.z + step).shown[0][0] for step in 1e-4 * np.eye(3)]
        return point.with_columns({i: (point.shown[0][0] - left) / 1e-4 for i, left in enumerate(moved)})


class Following(Bent):
    follows = True

    def follow(self, point, to):
        step, columns = to.z - point.z, point.columns
        off = point.shown[0][0] - to.shown[0][0] - sum(columns[i] * step[i] for i in columns)
        return to.with_columns({i: c + off * step[i] / (step @ step) for i, c in columns.items()})


def test_columns_taken_along_lead_to_the_same_place_and_are_asked_for_less():
    plain, following = Bent(), Following()
    ends = [fitted(objective, model(), fresh=range(3)).total for objective in (plain, following)]
    best = np.linalg.lstsq(DESIGN, TARGET, rcond=None)[0]
    assert (best > -1).all()  # the minimum is where expm1(z) is that
    assert ends == pytest.approx([((TARGET - DESIGN @ best) ** 2).mean()] * 2, rel=0.01)
    assert len(following.asked) < len(plain.asked)


def test_a_fit_leaves_the_point_where_it_was():
    objective = line()
    at = objective.at(model(), np.zeros(3))
    end = fit(objective, at, range(3), steps=20)
    assert not at.z.any() and at.columns == {} and end.point.z.any()
