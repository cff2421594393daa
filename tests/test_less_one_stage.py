"""A camera less one stage: what counts as named, and what is counted."""

import pytest

from experiments.less_one_stage import EFFECTS, markdown, named, raised, removable
from jaxisp.fit import model as fitted
from jaxisp.gap import EFFECTS as KNOWN
from jaxisp.recipe import Recipe


def record(before, *causes):
    return {
        "gap": {"before": before, "after": before, "floor": 4.0},
        "verdict": "effect" if causes else "unknown",
        "causes": [[name, 0.5] for name in causes],
        "ranking": ["sharpening"],
    }


def test_each_stage_of_a_fitted_camera_that_is_an_effect_can_be_taken_out():
    design = fitted.Design(lens=True, sampling=True, median="3x3", passes=1)
    chain = fitted.camera("GRBG", design)
    camera = Recipe(chain, {n: v for n, v in fitted.start().items() if n in chain.init()})
    names = removable(camera)
    assert set(names) == set(EFFECTS)
    for name in names:
        assert name not in {s.name for s in camera.without(name).chain.stages()}
        assert set(EFFECTS[name]) <= set(KNOWN)


def test_what_hardly_raises_the_gap_is_not_counted():
    found = {
        "": record(10.0),
        "unsharp_mask": record(20.0, "optical_blur", "sharpening"),
        "bilateral": record(13.0),
        "vignetting": record(10.5),
    }
    assert [raised(found, n) for n in ("unsharp_mask", "bilateral", "vignetting")] == pytest.approx(
        [2.5, 0.75, 0.125]
    )
    assert named(found["unsharp_mask"], "unsharp_mask") and not named(found["bilateral"], "bilateral")
    assert "(1/2)" in markdown(found)
