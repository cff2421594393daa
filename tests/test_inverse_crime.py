"""The package on both sides: how strong an effect is made, and what the page counts."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import inverse_crime
from experiments.inverse_crime import ARMS, page, strong


class Linear:
    """Pictures that are as many 8-bit steps brighter as the effect's one number has hundredths."""

    def __init__(self, high: float) -> None:
        ranges = np.array([[-1.0, -0.1], [1.0, high]])
        self.model = SimpleNamespace(
            indices=lambda names: [1], ranges=ranges, steps=np.full(2, 0.01), coordinates=[0, 1]
        )
        self.z = np.zeros(2)

    def rendered(self, z: np.ndarray) -> np.ndarray:
        return np.full((2, 4, 4, 3), 100 * z[1] / 255)

    def errors(self, z: np.ndarray) -> np.ndarray:
        return np.full(2, 1000 * z[1])


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_an_effect_is_as_strong_as_wanted_or_as_its_range_allows(arm: inverse_crime.Arm) -> None:
    wide, narrow = Linear(1.0), Linear(0.005)
    z = strong(arm, wide, "sharpening")
    assert z[0] == 0 and z[1] > 0, "nothing else moves, and an amount goes up"
    assert arm.size(wide, z) == pytest.approx(arm.wanted, rel=0.02)
    assert strong(arm, narrow, "sharpening").tolist() == [0, 0.005]


def test_the_page_counts_what_no_base_takes_up() -> None:
    found = {}
    for effect, causes, before in (
        ("sharpening", ["sharpening"], 9.0), ("optical_blur", ["resampling"], 9.0), ("vignetting", [], 1.0),
        ("white_balance", [], 1.0),
    ):  # fmt: skip
        found[effect] = {
            "effect": effect, "size": 3.0, "causes": causes, "closed": dict.fromkeys(causes, 0.9),
            "alternatives": {c: ["optical_blur"] for c in causes}, "gap": {"before": before, "floor": 1.0},
            "verdict": "effect" if causes else "none",
        }  # fmt: skip
    text = page("raw+jpeg", found, Path("some.json"))
    assert "- right effect first: 1 of 3 [6%, 79%]; 1 of the 2 whose gap" in text
    assert "- it or one that it cannot be told from: 2 of 3 [21%, 94%]; 2 of the 2 whose gap" in text
    assert "| white_balance (the base takes it up) | 3 | 1, 1 | none |" in text
    assert "--kind raw+jpeg --out some.json" in text
