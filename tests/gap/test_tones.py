"""What a fit does to blocks counts beside its statistics."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.objective import tones
from jaxisp.gap.objective.protocol import NormalEquations


def test_blocks_are_means_of_what_counts():
    rng = np.random.default_rng(0)
    pictures = rng.normal(100, 5, (2, 20, 17, 3))  # what is beyond whole blocks is left out
    mask = np.ones((2, 20, 17), np.float32)
    mask[0, :3, :8], mask[1, :7, 8:16] = 0, 0
    found = tones.of(pictures, jnp.asarray(mask)).reshape(2, 2, 2, 3)
    np.testing.assert_allclose(found[0, 1, 1], pictures[0, 8:16, 8:16].mean((0, 1)), rtol=1e-5)
    part = pictures[0, 3:8, :8].mean((0, 1)) * np.sqrt(5 / 8)
    np.testing.assert_allclose(found[0, 0, 0], part, rtol=1e-4)
    assert (found[1, 0, 1] == 0).all()


def test_normal_equations_are_those_of_the_error_times_its_excess():
    """Against finite differences of linear residuals, statistics and blocks."""
    rng = np.random.default_rng(1)
    count, moves, statistics, blocks = 3, 4, 20, 50
    of_all = rng.normal(size=(moves, statistics))  # a half's mean: alike for its pairs
    columns = rng.normal(size=(count, moves, blocks))
    difference, off = rng.normal(size=statistics), rng.normal(size=(count, blocks))
    before = 1.3 * off

    def error(z):
        return ((difference - z @ of_all) ** 2).mean()

    def total(z):
        return error(z) * tones.excess(off - np.einsum("k,nkt->nt", z, columns), before)

    gram = np.stack(count * [of_all @ of_all.T / statistics])
    slope = np.stack(count * [of_all @ difference / statistics])
    _, found = tones.with_excess(NormalEquations(gram, slope), error(np.zeros(moves)), columns, off, before)
    steps = 1e-5 * np.eye(moves)
    want = [(total(-s) - total(s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(2 * found.mean(0), want, rtol=1e-6)


def test_what_rounding_leaves_is_no_error():
    small = np.full((1, 10), 0.01)
    assert tones.excess(2 * small, small) == pytest.approx(1, abs=2e-3)
    assert tones.excess(np.full((1, 10), 4.0), np.full((1, 10), 2.0)) == pytest.approx(16.25 / 4.25)
