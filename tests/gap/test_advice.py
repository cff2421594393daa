"""What to measure next is said of every pair that may look alike, and of every axis."""

import pytest

from jaxisp.gap.report import advice
from jaxisp.gap.simulator.effects import EFFECTS


@pytest.mark.parametrize(
    ("effect", "other"), [(name, other) for name, e in EFFECTS.items() for other in e.alternatives]
)
def test_what_tells_any_two_lookalikes_apart_is_said_both_ways(effect, other):
    said = advice.between(effect, [other])
    assert said == advice.between(other, [effect]) and said != advice.between("vignetting", ["prnu"])


def test_of_several_each_is_told_once():
    flat, lamp = (
        advice.between("vignetting", ["color_shading"]),
        advice.between("vignetting", ["veiling_glare"]),
    )
    assert advice.between("vignetting", ["color_shading", "veiling_glare"]) == f"{flat}; {lamp}"
    assert advice.between("color_shading", ["vignetting", "white_balance"]) == flat
    assert advice.between("vignetting", []) is None


def test_every_axis_has_its_measurement():
    assert all(advice.about([axis]) for e in EFFECTS.values() for axis in e.axes)
    assert advice.about(["row", "column"]) == advice.about(["row"])
    assert advice.about([]) == advice.between("vignetting", ["prnu"])  # more pairs
