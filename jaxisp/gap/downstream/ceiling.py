"""The lowest gap that flexible models reach, as a reference for the closure of the named effects.

The models are single effects, all effects at once, and a network that predicts the rest. For clean+noisy
pairs, a constant shift of the statistics replaces the network. None of them is a bound: a network learns only
from few pairs, and all effects together may overfit. The lowest gap of all models counts.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from scipy.ndimage import gaussian_filter

from jaxisp.gap.case import Case, Gap
from jaxisp.gap.downstream.networks import programs
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import InParts, PixelObjective, tiled
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.pairs import INNER
from jaxisp.gap.search.refit import searched
from jaxisp.models.layers import conv
from jaxisp.train.step import split_model

TOGETHER, NETWORK = "all effects at once", "a small network on what is left"
"""Names of two of the models."""
_WIDTH, _DEPTH = 24, 4
_STEPS, _BATCH, _PATCH = 300, 8, 48
_AROUND = 8.0  # px, sigma of the surroundings, for local tone mapping


def reducible(case: Case, gap: Gap, point: Point, after: float, refits: Sequence[float]) -> dict[str, Any]:
    """Measure the lowest gap that a flexible model reaches on the held-out pairs.

    Args:
        case: the diagnosed pairs and their base.
        gap: the gap before any cause.
        point: the point with the causes.
        after: the gap at that point.
        refits: gaps of all refitted effects, accepted or not.

    Returns:
        a dict with these keys:

        - `best`: the lowest gap.
        - `how`: the model that reached it.
        - `models`: the gap of each model by its name.
        - `explained`: share of `before - best` that the causes close; None if this difference is within the
          range of cameras that lack no effect.
    """
    found = {"the named effects": after}
    if refits:
        found["an effect that was refused"] = min(refits)
    if case.pixels is not None:  # on statistics of few scenes, all effects together overfit
        found[TOGETHER] = _together(case.pixels, point, case.offered)
        found[NETWORK] = _network_leaves(case.pixels, point)
    elif case.statistics is not None:
        found["what the fitted pairs still differ in, taken off"] = case.statistics.left_by_shift(point)
    how = min(found, key=lambda name: found[name])
    could = gap.before - found[how]
    beyond = could > case.criteria.null_drop * gap.unit
    return {
        "best": found[how],
        "how": how,
        "models": found,
        "explained": (gap.before - after) / could if beyond else None,
    }


def _together(pixels: PixelObjective, point: Point, names: Sequence[str]) -> float:
    """The held-out gap with all effects fitted together with the base, except those searched on a grid."""
    model, gridded = point.model, searched(point.model, names)
    which = [*model.base_indices, *(i for i in model.indices(names) if i not in gridded)]
    part, start = pixels.fitted(point)
    z = fit(InParts(part), start, which, steps=1).point.z
    held, there = pixels.held_out(point)
    return float(np.nanmean(held.units(held.at(there.model, z))))


class _Network(nnx.Module):
    """Four convolutions; the last starts at zero, so the first output is zero."""

    def __init__(self, channels: int, rngs: nnx.Rngs) -> None:
        widths = [channels, *[_WIDTH] * (_DEPTH - 1)]
        self.hidden = nnx.List([conv(a, b, rngs=rngs, dtype=None) for a, b in itertools.pairwise(widths)])
        self.last = conv(_WIDTH, 3, init=nnx.initializers.zeros_init(), rngs=rngs, dtype=None)

    def __call__(self, x: jax.Array) -> jax.Array:
        for layer in self.hidden:
            x = nnx.relu(layer(x))
        return self.last(x)


def _network_leaves(pixels: PixelObjective, point: Point) -> float:
    """The held-out gap after a network, trained on the fitted pairs, predicts the residual.

    Its inputs are the simulator's picture, the mosaic, the position in frame and CFA, and the surroundings.
    """
    seen = _seen(pixels, point)
    residual = pixels.target - point.shown[0]
    fitted, held = list(pixels.split.fit), list(pixels.split.held_out)
    scale = float(np.sqrt(np.mean(pixels.residual(point)[fitted] ** 2))) + 1e-6
    learn = seen[fitted], residual[fitted] / scale, pixels.weight[fitted] ** 2
    apply, params = _learnt(*learn)
    predicted = np.concatenate([np.asarray(apply(params, seen[[i]])) for i in held])
    left = ((residual[held] - scale * predicted) * pixels.weight[held]) ** 2
    return float(np.nanmean(tiled(left.sum(-1), pixels.counts[held])))


def _seen(pixels: PixelObjective, point: Point) -> np.ndarray:
    """Inputs (N, h, w, C) of the network, each of about unit size."""
    (current,) = point.shown
    n, h, w, _ = current.shape
    light = np.asarray(pixels.pairs.light)[INNER]
    luma = current[..., 0] / 255
    y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j]
    rows, columns = np.mgrid[:h, :w] % 2
    places = np.broadcast_to(np.stack([y, x, y**2 + x**2, rows, columns], -1), (n, h, w, 5))
    around = gaussian_filter(luma, (0, _AROUND, _AROUND))[..., None]
    own = light.reshape(n, h, w, -1)
    return np.concatenate([current / 255, own, around, places], -1).astype(np.float32)


def _learnt(seen: np.ndarray, wanted: np.ndarray, weight: np.ndarray) -> tuple[Any, Any]:
    """Train the network.

    Args:
        seen: (N, h, w, C) inputs.
        wanted: (N, h, w, 3) targets of about unit size.
        weight: (N, h, w, 1) weight of the squared error.

    Returns:
        the network as a function of (params, inputs); its trained parameters.
    """
    start, update, apply, optimizer = _program(seen.shape[-1])
    params = jax.tree.map(jnp.copy, start)
    state, rng = optimizer.init(params), np.random.default_rng(0)
    n, h, w, _ = seen.shape
    side = min(_PATCH, h, w)
    for _ in range(_STEPS):
        places = [[int(rng.integers(m)) for m in (n, h - side + 1, w - side + 1)] for _ in range(_BATCH)]
        cut = [(i, slice(y, y + side), slice(x, x + side)) for i, y, x in places]
        batch = [np.stack([a[c] for c in cut]) for a in (seen, wanted, weight)]
        params, state = update(params, state, *batch)
    return apply, params


@functools.cache
def _program(channels: int) -> tuple[Any, Any, Any, optax.GradientTransformation]:
    """Initial parameters, jitted update, jitted network, and optimizer."""
    graph, start, _ = split_model(_Network(channels, nnx.Rngs(0)), train=True)
    optimizer = optax.adam(optax.cosine_decay_schedule(3e-3, _STEPS))
    return start, *programs(graph, optimizer, _loss), optimizer


def _loss(made: jax.Array, wanted: jax.Array, weight: jax.Array) -> jax.Array:
    return (weight * (made - wanted) ** 2).mean()
