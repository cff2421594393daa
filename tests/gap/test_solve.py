"""What a fit minimises, against closed forms and SciPy; the columns of this problem do not change."""

import numpy as np
import pytest
import scipy.optimize

from jaxisp.gap.base.priors import Prior
from jaxisp.gap.gauss_newton import fit

RNG = np.random.default_rng(2)
DESIGN, TARGET = RNG.normal(size=(40, 3)), RNG.normal(size=40)


class Line:
    def __init__(self, spreads, usual=(0.0, 0.0, 0.0)):
        self.z, self.columns = np.zeros(3), {}
        ranges, precisions = np.array([[-9.0] * 3, [9.0] * 3]), np.array(spreads) ** -2.0
        own = {"ranges": ranges, "precisions": precisions, "usual": np.array(usual)}
        self.model = type("M", (), own)

    def errors(self, z):
        return np.array([((TARGET - DESIGN @ z) ** 2).mean()])

    def compute(self, which):
        pass

    def normal(self, which):
        right = DESIGN.T @ (TARGET - DESIGN @ self.z)
        return (DESIGN.T @ DESIGN)[None] / 40, right[None] / 40

    def move_to(self, z):
        self.z = z


def test_a_fit_with_a_prior_is_ridge_regression():
    prior = Prior(RNG.normal(size=(2, 3)), np.array([1.0, -2.0]), 0.7)
    line = Line([np.inf] * 3)
    fit(line, range(3), [0], steps=20, prior=prior)
    rows = np.concatenate([DESIGN / np.sqrt(40), np.sqrt(0.7) * prior.rows])
    wanted = np.concatenate([TARGET / np.sqrt(40), np.sqrt(0.7) * prior.wanted])
    np.testing.assert_allclose(line.z, np.linalg.lstsq(rows, wanted, rcond=None)[0], atol=2e-3)


@pytest.mark.parametrize("usual", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.05)])
@pytest.mark.parametrize("spreads", [(np.inf, 0.02, 0.05), (0.01, 0.01, 0.01), (np.inf,) * 3])
def test_moves_cost_a_hundredth_of_the_error_for_each_spread_squared(spreads, usual):
    line, weights = Line(spreads, usual), np.array(spreads) ** -2.0
    for _ in range(8):  # each stops where a step gains little
        fit(line, range(3), [0], steps=20)
    best = scipy.optimize.minimize(
        lambda z: line.errors(z)[0] * (1 + 0.01 * weights @ (z - usual) ** 2), np.zeros(3), tol=1e-12
    )
    np.testing.assert_allclose(line.z, best.x, atol=1e-3 * np.abs(best.x).max())


class Bent(Line):
    """A curved problem whose columns are secants, and may be taken along."""

    asked = 0

    def __init__(self):
        super().__init__([np.inf] * 3)
        self.fresh_columns()

    def seen(self, z):
        return DESIGN @ np.expm1(z)

    def errors(self, z):
        return np.array([((TARGET - self.seen(z)) ** 2).mean()])

    def fresh_columns(self):
        moved = self.z + 1e-4 * np.eye(3)
        self.columns = {i: (self.seen(m) - self.seen(self.z)) / 1e-4 for i, m in enumerate(moved)}

    def compute(self, which):
        if set(which) - set(self.columns):
            self.asked += 1
            self.fresh_columns()

    def normal(self, which):
        stacked = np.stack([self.columns[i] for i in which], 1)
        right = stacked.T @ (TARGET - self.seen(self.z))
        return (stacked.T @ stacked)[None] / 40, right[None] / 40

    def move_to(self, z):
        self.z, self.columns = z, {}


class Following(Bent):
    def follow(self, z):
        step, before, columns = z - self.z, self.seen(self.z), self.columns
        self.move_to(z)
        off = self.seen(z) - before - sum(columns[i] * step[i] for i in columns)
        self.columns = {i: c + off * step[i] / (step @ step) for i, c in columns.items()}


def test_columns_taken_along_lead_to_the_same_place_and_are_asked_for_less():
    plain, following = Bent(), Following()
    ends = [fit(problem, range(3), [0], steps=20, fresh=range(3)) for problem in (plain, following)]
    best = np.linalg.lstsq(DESIGN, TARGET, rcond=None)[0]
    assert (best > -1).all()  # the minimum is where expm1(z) is that
    assert ends == pytest.approx([((TARGET - DESIGN @ best) ** 2).mean()] * 2, rel=0.01)
    assert following.asked < plain.asked
