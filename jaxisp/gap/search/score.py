"""The probability that an effect is there: logistic regressions of its signs, kept as data.

`score.json` holds, for each question, an intercept and for each sign its mean, its standard deviation and a
weight. All kinds of pairs share them. `experiments.score` fits them to cameras whose effects are known.
"""

import functools
import json
from collections.abc import Mapping
from importlib.resources import files
from math import exp
from typing import Any

EFFECT, GRAIN, OTHER, NONE = "effect", "film_grain", "other", "none"
"""Questions: is this effect there, is film grain there, does something else remain, is nothing missing?"""


def probability(question: str, signs: Mapping[str, float]) -> float:
    """The answer to a question, in (0, 1).

    Args:
        question: one of the questions above.
        signs: values by name, at least those that the score weighs.
    """
    return logistic(table()[question], signs)


def logistic(row: Mapping[str, Any], signs: Mapping[str, float]) -> float:
    """A logistic regression on standardised signs."""
    z = row["intercept"]
    for name, (mean, deviation, weight) in row["signs"].items():
        z += weight * (signs[name] - mean) / deviation
    return 1 / (1 + exp(-min(max(z, -30.0), 30.0)))


@functools.cache
def table() -> dict[str, Any]:
    """The score by question."""
    found: dict[str, Any] = json.loads(files("jaxisp.gap.search").joinpath("score.json").read_text())
    return found
