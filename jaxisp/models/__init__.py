"""Denoising networks in flax.nnx: (N, H, W, C) noisy in, the same shape clean out."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.models.dncnn import DnCNN
from jaxisp.models.fast import FastNet
from jaxisp.models.ffdnet import FFDNet
from jaxisp.models.files import fill, read_arrays, save_network
from jaxisp.models.inference import denoise
from jaxisp.models.levels import LevelNet
from jaxisp.models.n3net import N3Net
from jaxisp.models.nafnet import NAFNet
from jaxisp.models.unet import UNet
from jaxisp.models.weighing import WeighNet

MODELS: dict[str, Callable[..., nnx.Module]] = {
    "fast": FastNet,
    "unet": UNet,
    "levelnet": LevelNet,
    "weighnet": WeighNet,
    "dncnn6": functools.partial(DnCNN, depth=6),
    "dncnn17": DnCNN,
    "ffdnet": FFDNet,
    "nafnet": NAFNet,
    "n3net": N3Net,
    "n3net-stripped": functools.partial(N3Net, embedding=None),
}
"""Constructors by the name that the command line takes. Each takes `rngs` and the options of its class."""


def make_model(name: str, *, seed: int = 0, **options: Any) -> nnx.Module:
    """A network with fresh weights.

    Args:
        name: one of `MODELS`.
        seed: of the weights.
        **options: of the constructor, as depth or features; lists, as files hold them, are tuples.

    Raises:
        InputError: no such network or option.

    Example:
        >>> import numpy as np
        >>> make_model("fast")(np.zeros((1, 16, 16, 3), np.float32)).shape
        (1, 16, 16, 3)
    """
    if name not in MODELS:
        raise InputError(f"no model named {name!r}; there are {', '.join(MODELS)}")
    options = {k: tuple(v) if isinstance(v, list) else v for k, v in options.items()}
    try:
        return MODELS[name](rngs=nnx.Rngs(seed), **options)
    except TypeError as error:
        raise InputError(f"model {name!r}: {error}") from None


def read_network(path: str | Path) -> tuple[nnx.Module, dict[str, Any]]:
    """The network of a file that `save_network` wrote, and what is kept with it: "model", "options" and more.

    Raises:
        InputError: it cannot be read, or holds no network.
    """
    arrays, about = read_arrays(path)
    if not isinstance(about.get("model"), str) or not isinstance(about.get("options"), dict):
        raise InputError(f"{path}: does not say which network it holds")
    # shapes alone: drawing weights that are replaced would take seconds
    model = nnx.eval_shape(lambda: make_model(about["model"], **about["options"]))
    fill(model, arrays, path)
    return model, about


def load_weights(model: nnx.Module, path: str | Path) -> None:
    """Give a network the weights in a file of its kind. Raises InputError where they do not fit."""
    fill(model, read_arrays(path)[0], path)


def count_parameters(model: nnx.Module) -> int:
    """Learned numbers: batch norms' running averages do not count."""
    return sum(int(np.prod(p.shape)) for p in jax.tree.leaves(nnx.state(model, nnx.Param)))


__all__ = [
    "MODELS",
    "DnCNN",
    "FFDNet",
    "FastNet",
    "LevelNet",
    "N3Net",
    "NAFNet",
    "UNet",
    "WeighNet",
    "count_parameters",
    "denoise",
    "load_weights",
    "make_model",
    "read_network",
    "save_network",
]
__dir__ = __all__.copy  # what an editor completes
