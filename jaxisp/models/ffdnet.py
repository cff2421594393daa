"""FFDNet: convolutions at half the resolution, told how strong the noise is."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx

from jaxisp.models.layers import HE, conv, pad_to_multiple, pixel_shuffle, pixel_unshuffle


class FFDNet(nnx.Module):
    """FFDNet: 2x2 pixels and a map of the noise level in, the clean 2x2 pixels out.

    12 layers of 96 features for colour have 852,108 parameters, 15 of 64 for gray 485,316 (the batch
    norms of training merged into the convolutions, as published).

    Args:
        channels: of the image.
        depth: layers.
        features: channels inside.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: Zhang, Zuo & Zhang 2018.
    """

    multiple = 2

    def __init__(
        self,
        channels: int = 3,
        *,
        depth: int = 12,
        features: int = 96,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        sizes = [4 * channels + 1] + [features] * (depth - 1) + [4 * channels]
        inits = [HE] * (depth - 1) + [nnx.initializers.lecun_normal()]
        self.layers = nnx.List(
            [conv(a, b, rngs=rngs, init=init, dtype=dtype) for a, b, init in zip(sizes, sizes[1:], inits)]
        )
        # the estimate of the noise level looks at the whole image, the convolutions at this many pixels
        self.reach = None

    def __call__(self, x: jax.Array, noise_level: jax.Array | None = None) -> jax.Array:
        """Denoise (N, H, W, C); `noise_level` is a standard deviation an image or (N, H / 2, W / 2, 1),
        estimated where it is None (Immerkaer 1996)."""
        h, w = x.shape[1:3]
        if noise_level is None:
            noise_level = estimate_noise(x)
        small = pixel_unshuffle(pad_to_multiple(x, 2), 2)
        level = jnp.asarray(noise_level, x.dtype)
        level = level if level.ndim == 4 else level.reshape(-1, 1, 1, 1)
        y = jnp.concatenate([small, jnp.broadcast_to(level, (*small.shape[:3], 1))], axis=-1)
        for layer in self.layers[:-1]:
            y = nnx.relu(layer(y))
        return pixel_shuffle(self.layers[-1](y).astype(x.dtype), 2)[:, :h, :w]


def estimate_noise(x: jax.Array) -> jax.Array:
    """(N,) standard deviations of white noise in (N, H, W, C): the mean magnitude of what a mask that
    ignores planes leaves; 0 for pictures below 3 px, which have no such thing. Source: Immerkaer 1996."""
    rows = x[:, :-2] - 2 * x[:, 1:-1] + x[:, 2:]
    both = rows[:, :, :-2] - 2 * rows[:, :, 1:-1] + rows[:, :, 2:]
    if 0 in both.shape:
        return jnp.zeros(len(x), x.dtype)
    return jnp.sqrt(jnp.pi / 2) / 6 * jnp.abs(both).mean(axis=(1, 2, 3))
