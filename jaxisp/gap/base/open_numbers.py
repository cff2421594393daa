"""Clean+noisy pairs: a first value for each number that a given simulator leaves open."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.base.given import Open
from jaxisp.gap.features.tolerances import noise_only
from jaxisp.pipeline import signature


def fit_open(problem: Any, opened: Sequence[Open], fit_on: Sequence[int]) -> None:
    """Each number at that of its levels which the pictures are nearest to, one after another, those of the
    noise first and twice: priors reach over decades, further than a linear step would see."""
    random = {s.name for s in problem.model.chain.stages() if signature(s.fn).stochastic}
    noise = [o for o in opened if o.node in random]
    problem.count(noise_only())
    for _ in range(2 if noise else 0):
        _sweep(problem, noise, fit_on)
    problem.count(np.ones_like(noise_only()))
    problem.set_unit()
    _sweep(problem, [o for o in opened if o.node not in random], fit_on)


def _sweep(problem: Any, opened: Sequence[Open], fit_on: Sequence[int]) -> None:
    """One number after another at its best level; leaves the problem there."""
    part, model = problem.take(fit_on), problem.model
    for number in opened:
        points = [model.with_shared(number.placed(model.shared, value)) for value in number.levels]
        errors = []
        for point in points:
            part.model = point
            errors.append(part.errors(part.z).mean())
        model = points[int(np.argmin(errors))]
    problem.model = model
    problem.move_to(problem.z)
