"""Fit of a base's noise, and of its mean along with it, to the statistics."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxisp.gap.base.plain_clean import balances, noise_freedom
from jaxisp.gap.features.tolerances import noise_only
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.gap.simulator.model import Model
from jaxisp.gap.simulator.noise import informed_by_noise, noise_indices
from jaxisp.process.memory import give_back

Rebase = Callable[[Model, np.ndarray], Model]
"""Moves the base's z into its parameters."""


def fit_noise(objective: StatisticsObjective, at: Point, rebase: Rebase) -> tuple[StatisticsObjective, Point]:
    """Fit the noise and, if they are free, the sensor's primaries; then fit all free coordinates.

    Returns:
        the objective in its final units; the fitted model at z = 0.
    """
    every, noise = np.ones_like(noise_only()), noise_indices(at.model)
    objective = objective.counting(noise_only())
    at = _settled(objective, at, noise, rebase, steps=5)
    objective = objective.counting(every)
    objective = objective.with_unit(objective.at(at.model, at.z))
    at = _settled(objective, at, informed_by_noise(at.model), rebase, steps=4)
    at = _settled(objective, at, at.model.base_indices, rebase, steps=3, keep=True)
    objective = objective.with_unit(at, emphasise=True)
    at = _settled(objective.counting(noise_only()), at, noise, rebase, steps=3)
    objective = objective.counting(every)
    return objective, objective.at(at.model, at.z)


def _settled(
    objective: StatisticsObjective,
    at: Point,
    which: list[int],
    rebase: Rebase,
    steps: int,
    keep: bool = False,
) -> Point:
    """Fit, and move the end to the model's z = 0; `keep` reuses the columns of the start."""
    if which:
        part, start = objective.fitted(objective.at(at.model, at.z))
        start = part.compute(start, which)
        z = fit(part, start, which, steps=steps, fresh=[] if keep else None).point.z
        at = objective.at(rebase(at.model, z), np.zeros(len(z)))
        give_back()
    return at


def rebased(model: Model, z: np.ndarray) -> Model:
    """Move the base's z into the parameters and shift the bounds of its noise accordingly.

    The white-balance gains before demosaicking become those fitted to the noise.
    """
    moved = model.moved(z)
    if np.allclose(moved.shared["later_balance"].gains, 1):
        noise = moved.shared["balanced_noise"]
        gains = [float(np.clip(g, 0.5, 4)) for g in (noise.red_gain, noise.blue_gain)]
        moved = dataclasses.replace(moved, shared=moved.shared | balances((gains[0], gains[1]), late=False))
    noise = noise_freedom(moved.shared)
    base = (*noise, *model.base[len(noise) :])
    return dataclasses.replace(moved, base=base)
