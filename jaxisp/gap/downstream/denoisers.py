"""Test whether the effects found improve a denoiser.

Small denoisers are trained on simulated pictures without and with the effects, and measured on the held-out
real pairs.
"""

import dataclasses
import functools
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.downstream.networks import programs
from jaxisp.gap.downstream.options import Downstream
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.crops import TILES
from jaxisp.gap.pairs.pairs import BORDER
from jaxisp.gap.pairs.scenes import scene_name
from jaxisp.io.digests import read_sealed, sealed_json
from jaxisp.io.files import check_output, parse_json, write_text
from jaxisp.metrics import match_moments, psnr, ssim
from jaxisp.models import count_parameters, make_model
from jaxisp.train.config import TrainConfig
from jaxisp.train.optimizer import make_optimizer
from jaxisp.train.step import split_model

_DRAWS = 6  # number of noise draws of each scene
_BATCH, _PATCH = 8, 48
_NETWORK = {"depth": 5, "features": 32}
_VERSION = 1  # to be raised when the meaning of kept figures changes
METRIC = (
    "PSNR [dB] and SSIM of the denoised held-out pairs in encoded sRGB, against the clean pictures in their "
    "tones, these given the mean and standard deviation of what they are compared with, per channel"
)


@dataclasses.dataclass(frozen=True)
class _Task:
    """Training and test pictures of a denoiser, encoded sRGB in [0, 1].

    Attributes:
        noisy: (K, N, H, W, 3) K noise draws of N scenes.
        clean: (N, H, W, 3) clean pictures of these scenes.
        held_noisy: (M, H, W, 3) real noisy pictures of the held-out pairs.
        held_clean: (M, H, W, 3) their clean pictures.
    """

    noisy: np.ndarray
    clean: np.ndarray
    held_noisy: np.ndarray
    held_clean: np.ndarray

    def digest(self, steps: int, seed: int) -> str:
        """Hash of everything that the figures depend on."""
        found = hashlib.sha1(repr((_VERSION, _NETWORK, _BATCH, _PATCH, steps, seed)).encode())
        for a in (self.noisy, self.clean, self.held_noisy, self.held_clean):
            found.update(np.ascontiguousarray(a, np.float32).tobytes())
        return found.hexdigest()


def measure_downstream(
    case: Case, models: Mapping[str, Point], how: Downstream, tick: Tick
) -> dict[str, Any]:
    """Train and measure denoisers: one arm for each simulator, and one for the fitted real pairs.

    All arms use the clean scenes of the fitted pairs, with the same patches in the same order. A simulator's
    scenes have several noise draws; the real arm has one. The real arm shows the value of as many real pairs.

    Args:
        case: clean+noisy pairs, with its `reference`.
        models: point of each simulator, by name of its arm.
        how: training options.
        tick: progress callback, called with (done, total, text).

    Returns:
        the report's "downstream": {"metric", "model", "parameters", "steps", "seeds", "scenes", "input",
        "arms": {ARM: {"psnr", "ssim" (one a seed), "psnr_mean", "psnr_spread", "ssim_mean", "ssim_spread"}},
        "gain": of each arm over the first, seed by seed}. A spread is a standard deviation over seeds.
    """
    if not _apart(case):
        return {"skipped": "all pairs show one scene: what is held out would be what was trained on"}
    tasks = {name: _simulated(case, found) for name, found in models.items()}
    tasks["real"] = _task(case, case.pairs.pictures[None])
    total = len(tasks) * len(how.seeds)
    arms: dict[str, Any] = {}
    kept = _kept(how.keep)
    for name, task in tasks.items():
        figures = []
        for k, seed in enumerate(how.seeds):
            tick(len(arms) * len(how.seeds) + k, total, f"denoiser {name}, seed {seed}")
            digest = task.digest(how.steps, seed)
            if digest not in kept:
                kept[digest] = _measured(task, how.steps, seed)
                _keep(how.keep, kept)
            figures.append(kept[digest])
        arms[name] = _row(figures)
    first = next(iter(arms))
    inputs = [_compared(n, c) for n, c in zip(task.held_noisy, task.held_clean)]
    return {
        "metric": METRIC,
        "model": "fast, " + ", ".join(f"{k} {v}" for k, v in _NETWORK.items()),
        "parameters": count_parameters(_network(0)),
        "steps": how.steps,
        "seeds": list(how.seeds),
        "scenes": {"trained": len(task.clean), "held_out": len(task.held_clean)},
        "input": dict(zip(("psnr", "ssim"), np.mean(inputs, 0).tolist())),
        "arms": arms,
        "gain": {name: _gain(arms[first], row) for name, row in arms.items() if name != first},
    }


def _apart(case: Case) -> bool:
    """Whether fitted and held-out pairs show different scenes."""
    scenes = [scene_name(name).split(TILES)[0] for name in case.pairs.names]
    return not {scenes[i] for i in case.split.fit} & {scenes[i] for i in case.split.held_out}


def _row(figures: Sequence[Sequence[float]]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name, values in zip(("psnr", "ssim"), np.array(figures).T):
        row[name] = values.tolist()
        row[f"{name}_mean"] = float(values.mean())
        row[f"{name}_spread"] = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return row


def _gain(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    return _row(np.stack([np.array(after[k]) - np.array(before[k]) for k in ("psnr", "ssim")], -1).tolist())


def _simulated(case: Case, point: Point) -> _Task:
    assert case.statistics is not None, "clean+noisy pairs are compared by statistics"
    measure = case.statistics.measure
    draws = [measure.rendered(point.model, point.z, 100 + k) for k in range(_DRAWS)]
    return _task(case, np.stack(draws))


def _task(case: Case, noisy: np.ndarray) -> _Task:
    fitted, held = list(case.split.fit), list(case.split.held_out)
    assert case.reference is not None, "clean+noisy pairs have one"
    clean = case.reference
    return _Task(noisy[:, fitted], clean[fitted], case.pairs.pictures[held], clean[held])


def _kept(path: Path | None) -> dict[str, list[float]]:
    """The figures of an earlier call, by digest of what they depend on.

    Raises:
        InputError: another file stands there, or a damaged one.
    """
    if path is None or not os.path.lexists(path):
        return {}
    try:
        found = parse_json(read_sealed(path), str(path)).get("figures")
    except InputError as error:
        raise InputError(f"{error}; it would be replaced: choose another folder, or remove it") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: stands there already and would be replaced; choose another folder")
    return {digest: pair for digest, pair in found.items() if _is_pair(pair)}


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(isinstance(v, float) for v in value)


def check_kept(path: Path) -> None:
    """Raise InputError where figures could not be kept there."""
    check_output(path)
    _kept(path)


def _keep(path: Path | None, figures: Mapping[str, Any]) -> None:
    if path:
        write_text(path, sealed_json(json.dumps({"figures": figures})))


def _network(seed: int) -> nnx.Module:
    return make_model("fast", seed=seed, **_NETWORK)


@functools.cache
def _program(steps: int) -> tuple[Any, Any, optax.GradientTransformation]:
    """Jitted update, jitted network, and optimizer; all arms and seeds share them."""
    config = TrainConfig(clean=(), recipe="", steps=steps, lr=2e-3, warmup=min(50, steps), clip_norm=1.0)
    optimizer = make_optimizer(config, steps)
    graph, _, _ = split_model(_network(0), train=True)
    return *programs(graph, optimizer, lambda made, clean: jnp.abs(made - clean).mean()), optimizer


def _measured(task: _Task, steps: int, seed: int) -> list[float]:
    """PSNR [dB] and SSIM on the held-out pairs of a denoiser trained with this seed."""
    update, apply, optimizer = _program(steps)
    params = jax.tree.map(jnp.copy, split_model(_network(seed), train=True)[1])
    state, rng = optimizer.init(params), np.random.default_rng(seed)
    for _ in range(steps):
        params, state = update(params, state, *_patches(task, rng))
    made = [np.clip(np.asarray(apply(params, n[None])[0]), 0, 1) for n in task.held_noisy]
    found = np.mean([_compared(m, c) for m, c in zip(made, task.held_clean)], 0)
    return [float(v) for v in found]


def _patches(task: _Task, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Noisy and clean patches, (8, 48, 48, 3) each; their positions are the same for all arms."""
    count, (h, w) = len(task.clean), task.clean.shape[1:3]
    noisy, clean = [], []
    for _ in range(_BATCH):
        i, y, x, draw = (int(rng.integers(n)) for n in (count, h - _PATCH + 1, w - _PATCH + 1, _DRAWS))
        place = (i, slice(y, y + _PATCH), slice(x, x + _PATCH))
        noisy.append(task.noisy[draw % len(task.noisy)][place])
        clean.append(task.clean[place])
    return np.stack(noisy), np.stack(clean)


def _compared(picture: np.ndarray, clean: np.ndarray) -> tuple[float, float]:
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    values = _figures(jnp.asarray(picture[inner]), jnp.asarray(clean[inner]))
    return float(values[0]), float(values[1])


@jax.jit
def _figures(picture: jax.Array, clean: jax.Array) -> tuple[jax.Array, jax.Array]:
    wanted = match_moments(clean, picture)
    return psnr(picture, wanted), ssim(picture, wanted)
