"""Drawn pictures: the same for a seed, in range, and with the spectrum that pictures have."""

import numpy as np
import pytest

from jaxisp.data.procedural import KINDS, drawn, drawn_images


@pytest.mark.parametrize("kind", KINDS)
def test_a_drawn_picture_follows_from_its_seed(kind):
    one = drawn(kind, 3, 64)
    assert one.shape == (64, 64, 3) and one.dtype == np.float32
    assert one.min() >= 0 and one.max() <= 1 and one.std() > 0.005
    np.testing.assert_array_equal(drawn(kind, 3, 64), one)
    assert np.abs(drawn(kind, 4, 64) - one).max() > 0.05


def test_leaves_have_the_spectrum_of_photographs():
    """Amplitudes fall about as 1 / f (Ruderman 1997): power as f**-2, within what few pictures tell."""
    slopes = []
    for seed in range(4):
        plane = drawn("leaves", seed, 128).mean(-1)
        window = np.outer(np.hanning(128), np.hanning(128))
        power = np.abs(np.fft.fft2((plane - plane.mean()) * window)) ** 2
        f = np.hypot(*np.meshgrid(np.fft.fftfreq(128), np.fft.fftfreq(128)))
        rings = [(f > low) & (f <= 1.5 * low) for low in (0.03, 0.06, 0.12)]
        slopes.append(
            np.polyfit(np.log([f[r].mean() for r in rings]), np.log([power[r].mean() for r in rings]), 1)[0]
        )
    assert -3.2 < np.mean(slopes) < -1.2


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="kind must be one of leaves"):
        drawn("clouds", 0)


def test_a_set_of_drawn_pictures_has_all_kinds_and_is_the_same_for_the_same_seed():
    found, again, other = (drawn_images(6, seed, 32) for seed in (0, 0, 1))
    assert {name.split()[1] for name in found.names} == set(KINDS) and len(found.names) == 6
    assert all(image.shape == (32, 32, 3) and image.dtype == np.uint16 for image in found.images)
    assert all((a == b).all() for a, b in zip(found.images, again.images))
    assert not set(found.names) & set(other.names)
    both = found.joined(other)
    assert len(both.names) == len(both.images) == 12
