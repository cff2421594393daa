"""Shares of the error that a fitted plain base absorbs through the effects that are part of it."""

import dataclasses

import numpy as np

from jaxisp.gap.objective.protocol import Objective
from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Params
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.balanced_noise import BalancedNoise


def absorbed_shares(objective: Objective, fitted: Model, start: Params, which: list[int]) -> dict[str, float]:
    """Share of the error that tone curve, colour matrix, white balance and black level each absorb.

    One effect at a time is reset to its start; the others stay fitted. The share is the drop of the error
    relative to the error with this reset.

    Args:
        objective: of the pairs.
        fitted: the fitted base.
        start: parameters before the fit.
        which: indices of the pairs.

    Returns:
        the share in [0, 1] by effect.
    """
    return {
        name: _share(objective, fitted, params, which)
        for name, params in _put_back(fitted.shared, start).items()
    }


def absorbed_noise(objective: Objective, fitted: Model, start: BalancedNoise, which: list[int]) -> float:
    """Like `absorbed_shares`, for the base's noise; `start` holds `shot` and `read` before the fit."""
    noise = fitted.shared["balanced_noise"]
    before = dataclasses.replace(noise, shot=start.shot, read=start.read)
    return _share(objective, fitted, {"balanced_noise": before}, which)


def _put_back(fitted: Params, start: Params) -> dict[str, Params]:
    """Parameters with one effect reset to its start, by effect.

    White balance is the action of the matrix on grey, without the change of brightness.
    """
    now, then = (np.asarray(p["color_matrix"].matrix, float) for p in (fitted, start))
    gains = np.maximum(now.sum(1), 1e-3) / np.maximum(then.sum(1), 1e-3)
    matrices = {"color_matrix": then * gains[:, None], "white_balance": now / (gains / gains[1])[:, None]}
    found: dict[str, Params] = {
        name: {"color_matrix": ColorMatrix(matrix=np.asarray(matrix, np.float32))}
        for name, matrix in matrices.items()
    }
    return found | {name: {name: start[name]} for name in ("tone_curve", "black_level_offset")}


def _share(objective: Objective, fitted: Model, params: Params, which: list[int]) -> float:
    z = np.zeros(len(fitted.coordinates))
    models = fitted, fitted.with_shared(fitted.shared | params)
    now, without = (float(objective.at(model, z).errors[which].mean()) for model in models)
    return max(0.0, without - now) / max(without, 1e-12)
