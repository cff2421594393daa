"""torch on the device that JAX computes on, so that kornia is a peer on a GPU too."""

import sys
from typing import Any

import jax
import numpy as np


def tensor(array: np.ndarray) -> Any:
    """One of an array there."""
    import torch

    gpu = jax.default_backend() == "gpu" and torch.cuda.is_available()
    return torch.from_numpy(np.ascontiguousarray(array)).to("cuda" if gpu else "cpu")


def left(result: Any) -> Any:
    """The array that a CPU's tensor is; a GPU's tensor stays where it is, as results of JAX do."""
    return result if result.is_cuda else result.numpy()


def fetched(result: Any) -> Any:
    """A GPU's tensor as an array; any other result as it is."""
    return result.cpu().numpy() if hasattr(result, "is_cuda") else result


def wait() -> None:
    """Until a GPU has done all that torch asked of it."""
    if (torch := sys.modules.get("torch")) is not None and torch.cuda.is_initialized():
        torch.cuda.synchronize()
