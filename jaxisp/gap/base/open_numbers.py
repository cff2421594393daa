"""First values of the open numbers of a given simulator."""

from collections.abc import Sequence

import numpy as np

from jaxisp.gap.base.given import Open
from jaxisp.gap.features.tolerances import noise_only
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.pipeline import signature


def fit_open(
    objective: StatisticsObjective, at: Point, opened: Sequence[Open]
) -> tuple[StatisticsObjective, Point]:
    """Search the best level of each open number, one after another; those of the noise come first, twice.

    Priors may span decades, so a linear step from the median would not be enough.

    Returns:
        the objective with units measured at the fitted noise; the point found.
    """
    random = {s.name for s in at.model.chain.stages() if signature(s.fn).stochastic}
    noise = [o for o in opened if o.node in random]
    for _ in range(2 if noise else 0):
        at = _swept(objective.counting(noise_only()), at, noise)
    objective = objective.counting(np.ones_like(noise_only()))
    objective = objective.with_unit(objective.at(at.model, at.z))
    return objective, _swept(objective, at, [o for o in opened if o.node not in random])


def _swept(objective: StatisticsObjective, at: Point, opened: Sequence[Open]) -> Point:
    """Set one number after another to its best level."""
    at = objective.at(at.model, at.z)
    part, _ = objective.fitted(at)
    model = at.model
    for number in opened:
        models = [model.with_shared(number.placed(model.shared, value)) for value in number.levels]
        errors = [part.at(m, at.z).error for m in models]
        model = models[int(np.argmin(errors))]
    return objective.at(model, at.z)
