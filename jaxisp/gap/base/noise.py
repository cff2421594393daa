"""Clean+noisy pairs: the noise of the base, fitted to the statistics, and its mean beside it."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxisp.gap.base.plain_clean import balances, noise_freedom
from jaxisp.gap.features.tolerances import noise_only
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.starts import noise_indices, told_by_noise
from jaxisp.gap.simulator.model import Model

Rebase = Callable[[Model, np.ndarray], Model]
"""Puts the base's z into its parameters."""


def fit_noise(problem: Any, fit_on: Sequence[int], rebase: Rebase) -> None:
    """The noise that explains the statistics best, with it the sensor's primaries where the base has them
    free, then all that is free. Leaves the problem at z = 0 of the model found, in its final units."""
    every = np.ones_like(noise_only())

    def settle(which: list[int], steps: int, keep: bool = False) -> None:
        _settle(problem, which, fit_on, rebase, steps, keep)

    problem.count(noise_only())
    settle(noise_indices(problem.model), steps=5)
    problem.count(every)
    problem.set_unit()
    settle(told_by_noise(problem.model), steps=4)
    settle(problem.model.base_indices, steps=3, keep=True)
    problem.set_unit(emphasise=True)
    problem.count(noise_only())
    settle(noise_indices(problem.model), steps=3)
    problem.count(every)


def _settle(
    problem: Any, which: list[int], fit_on: Sequence[int], rebase: Rebase, steps: int, keep: bool
) -> None:
    """Fit, and make where that ends the model's z = 0; `keep` works with the columns of the start."""
    if not which:
        return
    part, seen = problem.take(fit_on), range(len(fit_on))
    part.columns = {}
    part.compute(which)
    fit(part, which, seen, steps=steps, fresh=[] if keep else None)
    problem.model = rebase(problem.model, part.z)
    problem.move_to(np.zeros(len(problem.z)))


def rebased(model: Model, z: np.ndarray) -> Model:
    """The model with the base's z put into its parameters, the bounds of its noise moved along; where white
    is balanced first, its gains are those that the noise shows."""
    moved = model.moved(z)
    if np.allclose(moved.shared["later_balance"].gains, 1):
        noise = moved.shared["balanced_noise"]
        gains = [float(np.clip(g, 0.5, 4)) for g in (noise.red_gain, noise.blue_gain)]
        moved = dataclasses.replace(moved, shared=moved.shared | balances((gains[0], gains[1]), late=False))
    noise = noise_freedom(moved.shared)
    base = (*noise, *model.base[len(noise) :])
    return dataclasses.replace(moved, base=base)
