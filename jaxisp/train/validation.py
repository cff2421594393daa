"""Validation on a fixed simulated set: the same crops, parameters and noise each time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.sharding import Mesh

from jaxisp.data.clean import CleanImages
from jaxisp.data.sources import CleanPatches
from jaxisp.stages.transfer import srgb_eotf
from jaxisp.train.config import TrainConfig
from jaxisp.train.devices import spread
from jaxisp.train.step import LOSSES, State, split_model, weights
from jaxisp.train.target import Pairs

Validate = Callable[[State], dict[str, float]]
_FIRST = 1 << 30
"""Index of the first sample: training does not come so far."""


def make_validation(
    model: nnx.Module, pairs: Pairs, config: TrainConfig, images: CleanImages, mesh: Mesh
) -> Validate:
    """`validate(state) -> {"loss", "psnr", "psnr_in"}`, means over `config.validation` patches (rounded
    up to whole batches) of photographs held out, with the averaged weights. They are degraded once."""
    measure = _measure(model, config)
    batches = -(-config.validation // config.batch)
    per_image = -(-batches * config.batch // len(images.images))
    source = CleanPatches(
        images, config.patch, per_image=per_image, seed=config.seed, fresh=False, augment=False
    )
    made: list[tuple[jax.Array, jax.Array]] = []

    def validate(state: State) -> dict[str, float]:
        if not made:
            starts = range(0, batches * config.batch, config.batch)
            made.extend(_made(pairs, mesh, source, range(s, s + config.batch)) for s in starts)
        totals: dict[str, float] = {}
        for noisy, target in made:
            for name, value in measure(weights(state), noisy, target).items():
                totals[name] = totals.get(name, 0.0) + float(value) / batches
        return totals

    return validate


def _made(pairs: Pairs, mesh: Mesh, source: CleanPatches, which: range) -> tuple[jax.Array, jax.Array]:
    return pairs(spread(mesh, source, which), np.arange(which.start, which.stop, dtype=np.int32) + _FIRST)


def _measure(model: nnx.Module, config: TrainConfig) -> Any:
    graph, _, _ = split_model(model, train=False)

    @jax.jit
    def measure(used: Any, noisy: jax.Array, clean: jax.Array) -> dict[str, jax.Array]:
        if config.light == "linear":
            noisy, clean = srgb_eotf(noisy), srgb_eotf(clean)
        output = nnx.merge(graph, *used)(noisy)
        loss = LOSSES[config.loss](output - clean).mean()
        return {"loss": loss, "psnr": _psnr(output, clean), "psnr_in": _psnr(noisy, clean)}

    return measure


def _psnr(images: jax.Array, clean: jax.Array) -> jax.Array:
    """The mean over (N, H, W, 3) images, cut to [0, 1] [dB]."""
    mse = ((jnp.clip(images, 0, 1) - clean) ** 2).mean(axis=(1, 2, 3))
    return -10 * jnp.log10(jnp.maximum(mse, 1e-12)).mean()
