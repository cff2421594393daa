"""What each score says a picture adds: all together they add what the score says of all."""

import numpy as np
import pytest

from jaxisp.gap.axes.pixel_features import Scene
from jaxisp.gap.axes.regression import _Evidence
from jaxisp.gap.axes.scores import Regression, Repeated, cut
from tests.gap.scenes import scenes

SHOWN_IN = np.array([0, 0, 1, 2, 3, 3])  # frames of the first and the last


@pytest.fixture(scope="module")
def explained():
    """By axis, of a residual that has something on each."""
    rng = np.random.default_rng(0)
    pictures = scenes(rng, 4, (64, 72))[SHOWN_IN]
    n, h, w = pictures.shape[:3]
    residual = 0.05 * (pictures - 100) + rng.normal(size=pictures.shape) + rng.normal(size=(h, 1, 1))
    residual += 0.5 * rng.normal(size=(n, 1, 1, 3)) + rng.normal(size=(h, w, 3))
    residual[rng.random((n, h, w)) < 1e-3] += 60
    tiles = cut((n, h, w), rng, SHOWN_IN, n)
    evidence = _Evidence(tiles, 2, SHOWN_IN, n, (0, 0), rng)
    for picture, own, counted in zip(pictures, residual, rng.uniform(0.5, 1, (n, h, w))):
        evidence.add(Scene(picture.astype(np.float32)), own.astype(np.float32), counted.astype(np.float32))
    signs = rng.choice((-1.0, 1.0), (5, tiles.count))
    signs[0] = 1
    return {axis: find(signs, tiles) for axis, find in evidence.axes().items()}


def test_pictures_add_up_to_all(explained):
    assert {"frame", "fixed_pattern", "tail", "row", "block_phase", "lag", "hue"} <= set(explained)
    for axis, found in explained.items():
        assert found.own_by.shape == (len(SHOWN_IN), 3)
        np.testing.assert_allclose(found.own_by.sum(0), found.own[0], rtol=1e-5, atol=1e-3, err_msg=axis)
        known = np.broadcast_to(found.known, found.own.shape)[0]
        known_by = np.broadcast_to(found.known_by, found.own_by.shape)
        np.testing.assert_allclose(known_by.sum(0), known, rtol=1e-5, atol=1e-3, err_msg=axis)
        assert np.ptp(found.own_by, 0).any(), axis


def test_a_picture_that_does_not_show_it_counts_against():
    """What is learnt on others; lines and tails are each picture's own, and add nothing there."""
    rng, shown_in = np.random.default_rng(1), np.arange(4)
    pictures = scenes(rng, 4, (64, 72))
    residual = 6 * np.sin(pictures / 255 * 3 * np.pi) * (shown_in != 2)[:, None, None, None]
    tiles = cut(pictures.shape, rng, shown_in, 4)
    evidence = _Evidence(tiles, 2, shown_in, 4, (0, 0), rng)
    for picture, own in zip(pictures, residual):
        evidence.add(Scene(picture.astype(np.float32)), own.astype(np.float32), np.ones((64, 72), np.float32))
    signs = np.ones((1, tiles.count))
    found = {axis: find(signs, tiles) for axis, find in evidence.axes().items()}
    added = found["intensity"].own_by[:, 0]
    assert added[2] < 0 and (added[[0, 1, 3]] > 0).all()
    assert not found["tail"].own_by[2].any() and not found["row"].own_by[2].any()


def test_a_scene_is_in_its_products_twice():
    """Of a pattern that scenes have by different amounts: what one adds is the change of the mean product
    with how often it is drawn, as a pattern known from elsewhere and scored on it would have it."""
    amounts, rng = np.array([1.0, 2.0, 0.5, 1.5]), np.random.default_rng(2)
    repeated = Repeated(np.arange(4))
    pattern = rng.normal(size=(64, 72, 3))
    for amount in amounts:
        repeated.add(amount * pattern)
    tiles = cut((4, 64, 72), rng, np.arange(4), 4)
    found = repeated.explained(np.ones((1, tiles.count)), tiles)
    others = (amounts.sum() - amounts) / 3
    expected = 2 * amounts * others - (amounts * others).mean()
    np.testing.assert_allclose(found.own_by, expected[:, None] * (pattern**2).sum((0, 1)), rtol=1e-6)


def test_sums_of_tiles_are_those_of_their_pixels():
    rng = np.random.default_rng(0)
    tiles = cut((2, 70, 83), rng, np.arange(2), 2)
    features = [rng.normal(size=(70, 83)) * (rng.uniform(size=(70, 83)) < 0.5) for _ in range(5)]
    target, weight = rng.normal(size=(70, 83, 3)), rng.uniform(size=(70, 83))
    regression = Regression()
    regression.add(features, target, weight, tiles)
    assert len(regression._gram) == len(tiles.slices) > 1
    for k, part in enumerate(tiles.slices):
        f, t = np.stack([p[part].ravel() for p in features]), target[part].reshape(-1, 3)
        own = f * weight[part].ravel()
        np.testing.assert_allclose(regression._gram[k], own @ f.T, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(regression._slope[k], own @ t, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(regression._support[k], (f != 0) @ weight[part].ravel(), rtol=1e-5)
