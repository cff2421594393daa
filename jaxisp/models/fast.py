"""A small network for a CPU: a few convolutions at half the resolution."""

import itertools
from typing import Any

import jax
from flax import nnx

from jaxisp.models.layers import NEARLY_ZERO, conv, pad_to_multiple, pixel_shuffle, pixel_unshuffle


class FastNet(nnx.Module):
    """2x2 pixels become channels, convolutions with ReLU predict the noise of each.

    Args:
        channels: of the image.
        depth: layers.
        features: channels inside.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: the idea of FFDNet (Zhang, Zuo & Zhang 2018) without its noise map, with a residual.
    """

    multiple = 2

    def __init__(
        self,
        channels: int = 3,
        *,
        depth: int = 8,
        features: int = 48,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        sizes = [4 * channels] + [features] * (depth - 1)
        self.layers = nnx.List([conv(a, b, rngs=rngs, dtype=dtype) for a, b in itertools.pairwise(sizes)])
        self.last = conv(features, 4 * channels, rngs=rngs, init=NEARLY_ZERO, dtype=dtype)
        self.reach = 2 * depth + 2

    def __call__(self, x: jax.Array) -> jax.Array:
        h, w = x.shape[1:3]
        y = pixel_unshuffle(pad_to_multiple(x, 2), 2)
        for layer in self.layers:
            y = nnx.relu(layer(y))
        return x - pixel_shuffle(self.last(y).astype(x.dtype), 2)[:, :h, :w]
