"""A small U-shaped network of simple gates."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx

from jaxisp.models.layers import conv, pad_to_multiple, pixel_shuffle, pixel_unshuffle


class Depthwise(nnx.Module):
    """A 3x3 convolution of each channel by itself, written as shifted sums (grouped convolutions are
    slow on a CPU), borders filled with zeros."""

    def __init__(self, features: int, *, rngs: nnx.Rngs, dtype: Any = None) -> None:
        init = nnx.initializers.normal(1 / 3)
        self.kernel = nnx.Param(init(rngs.params(), (3, 3, features), jnp.float32))
        self.bias = nnx.Param(jnp.zeros(features, jnp.float32))
        self.dtype = dtype

    def __call__(self, x: jax.Array) -> jax.Array:
        h, w = x.shape[1:3]
        kernel = self.kernel[...].astype(x.dtype)[:, :, None, None, None]
        padded = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
        out = self.bias[...].astype(x.dtype)[None, None, None]
        for dy in range(3):
            for dx in range(3):
                out = out + kernel[dy, dx] * padded[:, dy : dy + h, dx : dx + w]
        return out


class Block(nnx.Module):
    """Depthwise convolution, gate and channel attention; then a gated pointwise layer; both residual."""

    def __init__(self, features: int, *, rngs: nnx.Rngs, dtype: Any = None) -> None:
        def point(a: int, b: int) -> nnx.Conv:
            return conv(a, b, kernel=1, rngs=rngs, init=nnx.initializers.lecun_normal(), dtype=dtype)

        self.norms = nnx.List([nnx.LayerNorm(features, dtype=dtype, rngs=rngs) for _ in range(2)])
        self.spread, self.depthwise = (
            point(features, 2 * features),
            Depthwise(2 * features, rngs=rngs, dtype=dtype),
        )
        self.attention, self.project = point(features, features), point(features, features)
        self.widen, self.narrow = point(features, 2 * features), point(features, features)
        self.scales = nnx.Param(jnp.zeros((2, features), jnp.float32))

    def __call__(self, x: jax.Array) -> jax.Array:
        y = _gate(self.depthwise(self.spread(self.norms[0](x))))
        y = self.project(y * self.attention(y.mean(axis=(1, 2), keepdims=True)))
        scales = self.scales[...].astype(y.dtype)[:, None, None, None]
        x = x + scales[0] * y
        return x + scales[1] * self.narrow(_gate(self.widen(self.norms[1](x))))


class NAFNet(nnx.Module):
    """A small NAFNet: gated blocks at falling, then rising resolution, with skips; the output is a residual.

    Args:
        channels: of the image.
        features: channels at full resolution; they double at each lower one.
        encoder: blocks at each resolution on the way down; the way up has one at each.
        middle: blocks at the lowest resolution.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: Chen, Chu, Zhang & Sun 2022.
    """

    reach = None  # its channel attention averages over the whole image

    def __init__(
        self,
        channels: int = 3,
        *,
        features: int = 16,
        encoder: tuple[int, ...] = (1, 1, 2),
        middle: int = 2,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        widths = [features * 2**i for i in range(len(encoder) + 1)]

        def blocks(width: int, count: int) -> nnx.List[Any]:
            return nnx.List([Block(width, rngs=rngs, dtype=dtype) for _ in range(count)])

        def change(inputs: int, outputs: int, kernel: int = 1, **options: Any) -> nnx.Conv:
            return conv(inputs, outputs, kernel=kernel, rngs=rngs, dtype=dtype, **options)

        lecun = nnx.initializers.lecun_normal()
        self.intro = change(channels, features, 3, init=lecun)
        self.ending = change(features, channels, 3, init=nnx.initializers.zeros)
        self.down = nnx.List([blocks(w, n) for w, n in zip(widths, encoder)])
        self.shrink = nnx.List([change(4 * w, 2 * w, init=lecun) for w in widths[:-1]])
        self.middle = blocks(widths[-1], middle)
        self.grow = nnx.List([change(2 * w, 4 * w, bias=False, init=lecun) for w in widths[:-1]])
        self.up = nnx.List([blocks(w, 1) for w in widths[:-1]])
        self.multiple = 2 ** len(encoder)

    def __call__(self, x: jax.Array) -> jax.Array:
        h, w = x.shape[1:3]
        y = self.intro(pad_to_multiple(x, self.multiple))
        skips = []
        for blocks, shrink in zip(self.down, self.shrink):
            y = _through(blocks, y)
            skips.append(y)
            y = shrink(pixel_unshuffle(y, 2))
        y = _through(self.middle, y)
        for blocks, grow, skip in reversed(list(zip(self.up, self.grow, skips))):
            y = _through(blocks, pixel_shuffle(grow(y), 2) + skip)
        return x + self.ending(y).astype(x.dtype)[:, :h, :w]


def _through(blocks: nnx.List[Any], x: jax.Array) -> jax.Array:
    for block in blocks:
        x = block(x)
    return x


def _gate(x: jax.Array) -> jax.Array:
    a, b = jnp.split(x, 2, axis=-1)
    return a * b
