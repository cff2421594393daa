"""What the networks share: convolutions, pixel shuffling, padding to a multiple."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx

HE = nnx.initializers.variance_scaling(2.0, "fan_in", "normal")
NEARLY_ZERO = nnx.initializers.variance_scaling(1e-2, "fan_in", "normal")


def conv(
    inputs: int,
    outputs: int,
    *,
    rngs: nnx.Rngs,
    kernel: int = 3,
    bias: bool = True,
    init: Any = HE,
    dtype: Any,
) -> nnx.Conv:
    """A convolution that keeps the size, borders filled with zeros; weights stay float32."""
    return nnx.Conv(
        inputs, outputs, (kernel, kernel), use_bias=bias, kernel_init=init, dtype=dtype, rngs=rngs
    )


class ConvNet(nnx.Module):
    """Convolution + ReLU, `depth - 2` times convolution + batch norm + ReLU, convolution: a DnCNN's body.

    A convolution before a batch norm has no bias of its own.
    """

    def __init__(
        self, inputs: int, outputs: int, *, depth: int, features: int, rngs: nnx.Rngs, dtype: Any = None
    ) -> None:
        self.first = conv(inputs, features, rngs=rngs, dtype=dtype)
        self.middle = nnx.List(
            [conv(features, features, rngs=rngs, bias=False, dtype=dtype) for _ in range(depth - 2)]
        )
        self.norms = nnx.List(
            [nnx.BatchNorm(features, momentum=0.9, dtype=dtype, rngs=rngs) for _ in range(depth - 2)]
        )
        self.last = conv(features, outputs, rngs=rngs, init=NEARLY_ZERO, dtype=dtype)

    def __call__(self, x: jax.Array) -> jax.Array:
        x = nnx.relu(self.first(x))
        for convolve, norm in zip(self.middle, self.norms):
            x = nnx.relu(norm(convolve(x)))
        return self.last(x)


def pixel_unshuffle(x: jax.Array, factor: int) -> jax.Array:
    """(N, H, W, C) to (N, H / factor, W / factor, C * factor**2): blocks of pixels become channels."""
    n, h, w, c = x.shape
    x = x.reshape(n, h // factor, factor, w // factor, factor, c)
    return x.transpose(0, 1, 3, 2, 4, 5).reshape(n, h // factor, w // factor, factor * factor * c)


def pixel_shuffle(x: jax.Array, factor: int) -> jax.Array:
    """The inverse of `pixel_unshuffle`."""
    n, h, w, c = x.shape
    x = x.reshape(n, h, w, factor, factor, c // factor**2)
    return x.transpose(0, 1, 3, 2, 4, 5).reshape(n, h * factor, w * factor, c // factor**2)


def pad_to_multiple(x: jax.Array, multiple: int) -> jax.Array:
    """Repeat the last rows and columns of (N, H, W, C) until both sizes are multiples."""
    h, w = x.shape[1:3]
    return jnp.pad(x, ((0, 0), (0, -h % multiple), (0, -w % multiple), (0, 0)), mode="edge")
