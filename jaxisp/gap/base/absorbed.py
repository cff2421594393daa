"""What a plain base that was fitted takes up of the effects that are part of it."""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.simulator.model import Model
from jaxisp.pipeline import Params
from jaxisp.stages.balance import ColorMatrix


def taken_up(problem: Any, which: Sequence[int], fitted: Model, start: Params) -> dict[str, float]:
    """The shares of the error of these pairs that would be there were one of them as at the start, all else
    as it was fitted, and is not: of tone curve, colour matrix, white balance and black level."""
    return {
        name: _share(problem, which, fitted, params)
        for name, params in _put_back(fitted.shared, start).items()
    }


def noise_taken_up(problem: Any, which: Sequence[int], start: Any) -> float:
    """Likewise of the base's noise, where the problem stands; `start` has the `shot` and `read` of before."""
    noise = problem.model.shared["balanced_noise"]
    before = dataclasses.replace(noise, shot=start.shot, read=start.read)
    return _share(problem, which, problem.model, {"balanced_noise": before})


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


def _share(problem: Any, which: Sequence[int], fitted: Model, params: Params) -> float:
    at = np.zeros(len(fitted.coordinates))
    errors = []
    for model in (fitted, fitted.with_shared(fitted.shared | params)):
        other = copy.copy(problem)
        other.model = model
        errors.append(float(other.errors(at)[list(which)].mean()))
    now, without = errors
    return max(0.0, without - now) / max(without, 1e-12)
