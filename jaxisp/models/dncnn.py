"""DnCNN: a plain stack of convolutions that predicts the noise."""

from typing import Any

import jax
from flax import nnx

from jaxisp.models.layers import ConvNet


class DnCNN(nnx.Module):
    """DnCNN-S: convolutions with batch norm predict the noise, which is taken off the input.

    `y = x - body(x)`. 17 layers of 64 features have 556,097 parameters for gray and 558,403 for colour.

    Args:
        channels: of the image.
        depth: layers; 17 in the paper, 6 as in the blocks of N3Net.
        features: channels inside.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: Zhang, Zuo, Chen, Meng & Zhang 2017.
    """

    multiple = 1

    def __init__(
        self,
        channels: int = 3,
        *,
        depth: int = 17,
        features: int = 64,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        self.body = ConvNet(channels, channels, depth=depth, features=features, rngs=rngs, dtype=dtype)
        self.reach = depth

    def __call__(self, x: jax.Array) -> jax.Array:
        return x - self.body(x).astype(x.dtype)
