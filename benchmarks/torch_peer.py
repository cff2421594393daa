"""torch on the device that JAX computes on, so that kornia is a peer on a GPU too."""

import sys
from typing import Any

import jax
import numpy as np


def on_device(array: np.ndarray) -> Any:
    """A tensor of it there."""
    import torch

    gpu = jax.default_backend() == "gpu" and torch.cuda.is_available()
    return torch.from_numpy(np.ascontiguousarray(array)).to("cuda" if gpu else "cpu")


def left(tensor: Any) -> Any:
    """The array that a CPU's tensor is; a GPU's tensor stays where it is, as results of JAX do."""
    return tensor if tensor.is_cuda else tensor.numpy()


def fetched(result: Any) -> np.ndarray:
    """What `left` gave, as an array."""
    return result.cpu().numpy() if hasattr(result, "cpu") else np.asarray(result)


def wait() -> None:
    """Until a GPU has done all that torch asked of it."""
    if (torch := sys.modules.get("torch")) is not None and torch.cuda.is_initialized():
        torch.cuda.synchronize()
