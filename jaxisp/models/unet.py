"""A small U-shaped network of plain convolutions: far sight at little cost."""

import itertools
from typing import Any

import jax
from flax import nnx

from jaxisp.models.layers import NEARLY_ZERO, conv, pad_to_multiple, pixel_shuffle, pixel_unshuffle


class UNet(nnx.Module):
    """Convolutions with ReLU at 1/2, 1/4, ... of the resolution and back, skips added; predicts the noise.

    A phone's chroma denoising leaves blotches some 30 px wide: a network has to see further than they
    reach, which it does cheaply where the resolution is low.

    Args:
        channels: of the image.
        features: channels at each resolution, from 1/2 down.
        depth: convolutions at each resolution, on the way down and again on the way up.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: the shape is that of Ronneberger, Fischer & Brox 2015, the first step FFDNet's (Zhang, Zuo &
        Zhang 2018).
    """

    def __init__(
        self,
        channels: int = 3,
        *,
        features: tuple[int, ...] = (32, 64, 96),
        depth: int = 2,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        def convs(width: int) -> nnx.List[nnx.Conv]:
            return nnx.List([conv(width, width, rngs=rngs, dtype=dtype) for _ in range(depth)])

        steps = list(itertools.pairwise(features))
        self.first = conv(4 * channels, features[0], rngs=rngs, dtype=dtype)
        self.last = conv(features[0], 4 * channels, rngs=rngs, init=NEARLY_ZERO, dtype=dtype)
        self.down = nnx.List([convs(width) for width in features])
        self.shrink = nnx.List([conv(4 * a, b, kernel=1, rngs=rngs, dtype=dtype) for a, b in steps])
        self.grow = nnx.List([conv(b, 4 * a, kernel=1, rngs=rngs, dtype=dtype) for a, b in steps])
        self.up = nnx.List([convs(a) for a, _ in steps])
        self.multiple = 2 ** len(features)
        strides = [2**i for i in range(1, len(features) + 1)]
        passes = [2 * depth] * len(steps) + [depth]
        self.reach = 2 * 2 + sum(s * n for s, n in zip(strides, passes)) + self.multiple

    def __call__(self, x: jax.Array) -> jax.Array:
        h, w = x.shape[1:3]
        y = nnx.relu(self.first(pixel_unshuffle(pad_to_multiple(x, self.multiple), 2)))
        skips = []
        for convs, shrink in zip(self.down, self.shrink):
            y = _through(convs, y)
            skips.append(y)
            y = nnx.relu(shrink(pixel_unshuffle(y, 2)))
        y = _through(self.down[-1], y)
        for convs, grow, skip in reversed(list(zip(self.up, self.grow, skips))):
            y = _through(convs, pixel_shuffle(grow(y), 2) + skip)
        return x - pixel_shuffle(self.last(y).astype(x.dtype), 2)[:, :h, :w]


def _through(convs: nnx.List[nnx.Conv], x: jax.Array) -> jax.Array:
    for convolve in convs:
        x = nnx.relu(convolve(x))
    return x
