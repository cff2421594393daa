"""A U-shaped network that is told how strong the noise is at each place, or finds it out."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx

from jaxisp.arrays.promotion import a_librarys
from jaxisp.color import LUMA_601
from jaxisp.models.cells import CELL, LEAST, REACH, STATISTICS, cell_statistics, told_levels
from jaxisp.models.layers import NEARLY_ZERO, conv, pad_to_multiple, pixel_shuffle, pixel_unshuffle

_MOST = 2.25  # of levels as they are told: a standard deviation of 1
_SHARE = 0.1  # of the error of the map in what is trained
_BEND = 8.0  # detail in units of the noise beyond which it is compressed
_WINDOW = 7  # of the means that detail is told from, at half the resolution


class LevelNet(nnx.Module):
    """Residual blocks at 1/2, 1/4, ... of the resolution and back, which are given a map of the noise.

    The map has the standard deviation of the noise of luma and of chroma in each cell of 16x16 px. A small
    network of its own estimates it from the picture; whoever multiplies it makes the other smooth more.
    What is taken off is in units of the map: a picture that is nearly clean stays as it is. Detail is given
    in these units too, beside the picture: else the network has to learn to divide by the map, and leaves
    half of a weak noise where it is.

    Args:
        channels: of the image: 3.
        features: channels at each resolution, from 1/2 down.
        depth: convolutions of the residual block at each resolution, on the way down and again on the way up;
            ReLU between them. Without the sums of the blocks the network dies within 500 steps.
        estimator: channels of the network that estimates the map: two residual blocks of cells, which are
            given statistics of the cosine transforms in and about each cell.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights are float32.

    Source: a map as input is FFDNet's (Zhang, Zuo & Zhang 2018), a network that estimates it CBDNet's (Guo
        et al. 2019), the shape that of Ronneberger, Fischer & Brox 2015.
    """

    cell = CELL
    tile = 768

    def __init__(
        self,
        channels: int = 3,
        *,
        features: tuple[int, ...] = (32, 64, 96),
        depth: int = 2,
        estimator: int = 48,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        def make(inputs: int, outputs: int, **options: Any) -> nnx.Conv:
            return conv(inputs, outputs, rngs=rngs, dtype=dtype, **options)

        def block(width: int) -> nnx.List[nnx.Conv]:
            last = make(width, width, init=NEARLY_ZERO)
            return nnx.List([*(make(width, width) for _ in range(depth - 1)), last])

        steps = list(itertools.pairwise(features))
        self.sense = make(STATISTICS, estimator, kernel=1)
        self.cells = nnx.List([block(estimator) for _ in range(2)])
        self.levels = make(estimator, 2, kernel=1)
        self.first = make(2 * 4 * channels + 2, features[0])
        self.last = make(features[0], 4 * channels, init=NEARLY_ZERO)
        self.down = nnx.List([block(width) for width in features])
        self.shrink = nnx.List([make(4 * a, b, kernel=1) for a, b in steps])
        self.grow = nnx.List([make(b, 4 * a, kernel=1) for a, b in steps])
        self.up = nnx.List([block(a) for a, _ in steps])
        self.multiple = max(CELL, 2 ** len(features))
        strides = [2**i for i in range(1, len(features) + 1)]
        passes = [2 * depth] * len(steps) + [depth]
        half = 2 + _WINDOW // 2  # of the first and last convolutions, and of local means
        # once it has its map, between the cells of which is interpolated
        self.reach = 2 * half + sum(s * n for s, n in zip(strides, passes)) + 2 ** len(features) + CELL // 2
        self.map_reach = REACH + 2 * depth * CELL

    def noise_map(self, x: jax.Array) -> jax.Array:
        """The (N, ceil(H / 16), ceil(W / 16), 2) standard deviations that are estimated for (N, H, W, 3)."""
        return _levels(self._told_map(x))

    def _told_map(self, x: jax.Array) -> jax.Array:
        """The map as the network is told it, but not clipped: no noise is a value that can be met, so that
        learning to give it comes to an end. Clipped with a gradient beyond it grew without end."""
        y = self.sense(cell_statistics(pad_to_multiple(x, CELL)))
        for block in self.cells:
            y = y + _branch(block, _normed(y))
        return self.levels(y).astype(x.dtype)

    def __call__(self, x: jax.Array, noise_map: jax.Array | None = None) -> jax.Array:
        """Denoise (N, H, W, 3); the noise map is estimated where it is None."""
        h, w = x.shape[1:3]
        levels = self.noise_map(x) if noise_map is None else noise_map
        padded = pad_to_multiple(x, self.multiple)
        shape = (len(x), padded.shape[1] // 2, padded.shape[2] // 2, 2)
        told = _spread(told_levels(levels), shape).astype(x.dtype)
        unit = jnp.linalg.norm(_spread(levels, shape), axis=-1, keepdims=True).astype(x.dtype)
        quarters = pixel_unshuffle(padded, 2)
        y = self.first(jnp.concatenate([quarters, told, _in_units(quarters, unit)], -1))
        skips = []
        for block, shrink in zip(self.down, self.shrink):
            y = _through(block, y)
            skips.append(y)
            y = shrink(pixel_unshuffle(y, 2))
        y = _through(self.down[-1], y)
        for block, grow, skip in reversed(list(zip(self.up, self.grow, skips))):
            y = _through(block, pixel_shuffle(grow(y), 2) + skip)
        return x - pixel_shuffle(unit * self.last(y).astype(x.dtype), 2)[:, :h, :w]

    def objective(
        self, noisy: jax.Array, target: jax.Array, penalty: Callable[[jax.Array], jax.Array]
    ) -> jax.Array:
        """The loss: one in four pictures of a batch is denoised with its true map, the others by estimate.

        The estimate is to be near the true map (in ratios) and nothing else: made to denoise well, it becomes
        too small, and the network blind to it.
        """
        true = measured_map(noisy, target)
        found = self._told_map(noisy)
        given = (jnp.arange(len(noisy)) % 4 == 0)[:, None, None, None]
        told = jnp.where(given, true, jax.lax.stop_gradient(_levels(found)))
        wrong = jnp.abs(found - told_levels(true)).mean()
        return penalty(self(noisy, told) - target).mean() + _SHARE * wrong


def measured_map(noisy: jax.Array, target: jax.Array) -> jax.Array:
    """The noise map of (N, H, W, 3) pictures whose noise is known: root mean squares of luma and of what of
    the colours is not luma."""
    noise = pad_to_multiple(noisy - target, CELL)
    luma = jnp.tensordot(noise, jnp.asarray(LUMA_601, noise.dtype), 1)
    chroma = (noise - luma[..., None]) ** 2
    return jnp.sqrt(_cells(jnp.stack([luma**2, chroma.mean(-1)], -1), CELL) + 1e-12)


def _levels(told: jax.Array) -> jax.Array:
    """The inverse of `told_levels`."""
    return LEAST * (jnp.exp2(4 * jnp.clip(told, 0, _MOST)) - 1)


def _cells(x: jax.Array, side: int) -> jax.Array:
    n, h, w, c = x.shape
    return x.reshape(n, h // side, side, w // side, side, c).mean((2, 4))


def _spread(levels: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Cells interpolated to half the picture's resolution, those beyond the border as the last ones."""
    side = CELL // 2
    rows, columns = (-(-n // side) - m for n, m in zip(shape[1:3], levels.shape[1:3]))
    levels = jnp.pad(levels, ((0, 0), (0, rows), (0, columns), (0, 0)), mode="edge")
    n, h, w, c = levels.shape
    return jax.image.resize(levels, (n, h * side, w * side, c), "linear")[:, : shape[1], : shape[2]]


def _in_units(x: jax.Array, unit: jax.Array) -> jax.Array:
    """What differs from the local mean, over the noise; compressed where it is far above it."""
    edge = _WINDOW // 2
    padded = jnp.pad(x, ((0, 0), (edge, edge), (edge, edge), (0, 0)), mode="edge")
    with a_librarys():
        mean = nnx.avg_pool(padded, (_WINDOW, _WINDOW))
    y = (x - mean) / (unit + LEAST)
    return y * jax.lax.rsqrt(1 + (y / _BEND) ** 2)


def _through(block: nnx.List[nnx.Conv], x: jax.Array) -> jax.Array:
    return x + _branch(block, x)


def _branch(block: nnx.List[nnx.Conv], x: jax.Array) -> jax.Array:
    y = block[0](x)
    for convolve in block[1:]:
        y = convolve(nnx.relu(y))
    return y


def _normed(x: jax.Array) -> jax.Array:
    """With mean 0 and variance 1 over the channels of each place, as Ba, Kiros & Hinton 2016."""
    return (x - x.mean(-1, keepdims=True)) * jax.lax.rsqrt(x.var(-1, keepdims=True) + 1e-3)
