"""What a plain base that was fitted absorbs of the effects that are part of it."""

import dataclasses

import numpy as np

from jaxisp.gap.objective.protocol import Objective
from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Params
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.balanced_noise import BalancedNoise


def absorbed_shares(objective: Objective, fitted: Model, start: Params, which: list[int]) -> dict[str, float]:
    """By effect, the share of the error of these pairs that would be there with it as at the start, all else
    as fitted, and is not: of tone curve, colour matrix, white balance and black level."""
    return {
        name: _share(objective, fitted, params, which)
        for name, params in _put_back(fitted.shared, start).items()
    }


def absorbed_noise(objective: Objective, fitted: Model, start: BalancedNoise, which: list[int]) -> float:
    """Likewise of the base's noise; `start` has the `shot` and `read` of before."""
    noise = fitted.shared["balanced_noise"]
    before = dataclasses.replace(noise, shot=start.shot, read=start.read)
    return _share(objective, fitted, {"balanced_noise": before}, which)


def _put_back(fitted: Params, start: Params) -> dict[str, Params]:
    """The parameters of before, effect by effect. White balance is what the matrix does to grey, but for how
    bright it makes it."""
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
