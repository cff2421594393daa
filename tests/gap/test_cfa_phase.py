"""Pairs that were cut at different places of the colour filter array."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.gap.base import cfa_phase
from jaxisp.gap.base.cfa_phase import moved
from jaxisp.gap.features.residual_statistics import feature_names
from jaxisp.gap.pairs.pairs import Pairs

N = 5


@functools.cache
def places():
    """(3, 2, 2) the places of the statistics by colour and phase; naming them traces all statistics."""
    names = feature_names()
    return np.array(
        [
            [[names.index(f"logvar cfa_phase {c}{i}{j}") for j in (0, 1)] for i in (0, 1)]
            for c in ("Y", "Cb", "Cr")
        ]
    )


BY = [(0, 0), (1, 0), (0, 1), (1, 1), (0, 0)]


@pytest.fixture
def simulated(rng):
    """A sensor's: green on one diagonal, red and blue on the other."""
    found = rng.normal(size=(N, len(feature_names())))
    phases = np.array([[[0.2, -0.2], [-0.2, 0.2]], [[0.0, -0.3], [0.3, 0.0]], [[0.0, 0.4], [-0.4, 0.0]]])
    found[:, places()] = phases + 0.05 * rng.normal(size=(N, 3, 2, 2))
    return found


def cut(simulated, by, rng, noise=0.03):
    real = rng.normal(size=simulated.shape)
    for own, model, move in zip(real, simulated, by):
        own[places()] = np.roll(model[places()], move, (1, 2))
    return real + noise * rng.normal(size=real.shape)


@pytest.fixture
def moves(monkeypatch):
    """By the noise alone: edges that say nothing."""
    monkeypatch.setattr(cfa_phase, "_edges", lambda mean: np.zeros((4, N)))
    return lambda real, simulated: cfa_phase.moves(real, simulated, None)


def test_each_pair_gets_the_place_where_it_was_cut(moves, simulated, rng):
    assert moves(cut(simulated, BY, rng), simulated).tolist() == [list(move) for move in BY]


def test_one_pattern_for_all_stays_whatever_it_is(moves, simulated, rng):
    assert not moves(cut(simulated, [(0, 0)] * N, rng), simulated).any()
    assert not moves(cut(simulated, [(1, 0)] * N, rng), simulated).any()


def test_what_shows_no_pattern_stays(moves, simulated, rng):
    flat = simulated.copy()
    flat[:, places()] = 0.05 * rng.normal(size=(N, 3, 2, 2))
    assert not moves(flat, simulated).any()


def test_edges_tell_where_noise_does_not(monkeypatch, simulated):
    unlikely = np.full((4, N), 100.0)
    unlikely[0, :3] = unlikely[2, 3:] = 0
    monkeypatch.setattr(cfa_phase, "_edges", lambda mean: unlikely)
    flat = np.zeros_like(simulated)
    assert cfa_phase.moves(flat, flat, None).tolist() == 3 * [[0, 0]] + 2 * [[1, 0]]


def test_all_of_a_pair_moves_together(rng):
    light, pictures = rng.random((2, 6, 8, 3)), rng.random((2, 6, 8, 3))
    mask = rng.random((2, 6, 8)) > 0.5
    pairs = Pairs(("a", "b"), jnp.asarray(light), pictures, mask, jnp.asarray(0.5 * light))
    found = moved(pairs, np.array([(0, 0), (1, 0)]))
    np.testing.assert_array_equal(found.pictures[0], pictures[0])
    np.testing.assert_array_equal(found.pictures[1, 1:], pictures[1, :-1])
    np.testing.assert_array_equal(found.mask[1, 1:], mask[1, :-1])
    np.testing.assert_allclose(found.light[1, 1:], light[1, :-1], rtol=1e-6)
    np.testing.assert_allclose(found.again, 0.5 * found.light, rtol=1e-6)
    np.testing.assert_allclose(found.take([1]).again[0], 0.5 * found.light[1], rtol=1e-6)
