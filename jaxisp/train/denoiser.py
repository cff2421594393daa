"""A trained run as a denoiser."""

from pathlib import Path

import jax
import jax.numpy as jnp
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.models.apply import Denoiser
from jaxisp.train.checkpoints import FOLDERS, Checkpoints
from jaxisp.train.config import TrainConfig
from jaxisp.train.folder import load_settings, settings_digest
from jaxisp.train.optimizer import make_optimizer
from jaxisp.train.step import init_state, split_model, weights
from jaxisp.train.trainer import model_shapes


def load_denoiser(run: str | Path, checkpoint: str = "best") -> tuple[Denoiser, TrainConfig]:
    """The network of a run, with its averaged weights, and what the run was told.

    Args:
        run: a folder that `train` wrote.
        checkpoint: "best", by its validation, or "last".

    Raises:
        InputError: no run, or no checkpoint.
    """
    if checkpoint not in FOLDERS:
        raise InputError(f"checkpoint {checkpoint!r}: expected one of {', '.join(FOLDERS)}")
    config, recipe = load_settings(run)
    model = model_shapes(config)
    zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), nnx.state(model))
    like = init_state(nnx.merge(nnx.graphdef(model), zeros), make_optimizer(config, 1), ema=config.ema)
    checkpoints = Checkpoints(Path(run), settings_digest(config, recipe), reading=True)
    found = checkpoint if checkpoints.steps(checkpoint) else "last"  # stopped before its first validation
    state = checkpoints.restore(like, found)
    checkpoints.close()
    graph, _, _ = split_model(model, train=False)
    return Denoiser(nnx.merge(graph, *weights(state)), config.light), config
