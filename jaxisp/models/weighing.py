"""A network that weighs what simple filters make of a picture, at each pixel: it has little to learn."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax import lax

from jaxisp.models.layers import conv, pad_to_multiple

CELL = 16
"""Pixels of a side of a cell of the noise map."""
BLURS = (0.6, 0.9, 1.4, 2.2, 3.5, 7.0)
"""Standard deviations of the Gaussians [px]."""
WIDTHS = (0.5, 1.0, 2.0)
"""Of the similarity of two neighbourhoods in non-local means, in standard deviations of the noise."""
SEARCH, AROUND = 5, 2
"""How far non-local means look, and how much around a pixel they compare [px]."""
FILTERS = 1 + len(BLURS) + len(WIDTHS)
_LEAST = 0.3 / 255
_SEEN = (
    2 * 3 * 4 + 1 + 3
)  # statistics of a cell: sizes, changes, least and mean of two; light; the flattest blocks'
_SHARE = 0.01  # of the error of the map in what is trained
_BLOCK, _FLATTEST = 8, 0.15
TONES, _TONE = (0.08, 0.25, 0.42, 0.6, 0.8), 0.1
"""Brightnesses that the noise is estimated at, and how far from them counts."""
_TO_OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [0.5, -1, 0.5]], np.float32)
_TO_OPPONENT /= np.linalg.norm(_TO_OPPONENT, axis=1, keepdims=True)
"""Rows: light and two differences of colours, at right angles, so that white noise stays white."""


class WeighNet(nnx.Module):
    """Weighs ten filters at each pixel, light and colours apart: the picture itself, Gaussians of six widths,
    and non-local means of three strengths; and adds a small correction.

    Two small convolutions decide, and three of cells of 16 px estimate the noise. They see how far the
    filters are from each other in units of the noise, how strong it is, how much it is alike from pixel to
    pixel, and the light. The filters have nothing to learn, so that few pictures teach it.

    Args:
        channels: of the image: 3.
        features: channels inside.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights and filters are float32.

    Source: non-local means: Buades, Coll & Morel 2005.
    """

    multiple = CELL
    cell = CELL
    tile = 512
    reach = 21 + 2  # of the widest Gaussian, and of the convolutions
    map_reach = None  # of the whole picture

    def __init__(self, channels: int = 3, *, features: int = 24, rngs: nnx.Rngs, dtype: Any = None) -> None:
        inputs = 2 * (FILTERS - 1) + 5
        self.measured = nnx.List(
            [conv(_SEEN, features, rngs=rngs, dtype=None), conv(features, features, rngs=rngs, dtype=None)]
        )
        self.corrected = conv(features, 2, rngs=rngs, dtype=None, init=nnx.initializers.normal(1e-3))
        self.first = conv(inputs, features, rngs=rngs, dtype=dtype)
        self.second = conv(features, features, rngs=rngs, dtype=dtype)
        self.last = conv(
            features, 2 * FILTERS + 3, kernel=1, rngs=rngs, init=nnx.initializers.normal(1e-2), dtype=dtype
        )

    def noise_map(self, x: jax.Array) -> jax.Array:
        """(N, ceil(H / 16), ceil(W / 16), 3): standard deviations of light and colours, and how much of the
        light's variance is between neighbours. The flattest blocks of that brightness say what it is, and
        three convolutions over cells correct it by how the picture changes from pixel to pixel there."""
        y = _opponent(pad_to_multiple(x, CELL))
        flattest = jax.vmap(_levels)(y)
        z = jnp.concatenate([_statistics(y), jnp.log2(flattest[..., :2] / _LEAST) / 4, flattest[..., 2:]], -1)
        for layer in self.measured:
            z = nnx.relu(layer(z))
        off = jnp.clip(self.corrected(z), -5, 5)
        levels = jnp.maximum(flattest[..., :2] * jnp.exp2(off), _LEAST)
        return jnp.concatenate([levels, flattest[..., 2:]], -1)

    def __call__(self, x: jax.Array, noise_map: jax.Array | None = None) -> jax.Array:
        """Denoise (N, H, W, 3); the noise map is estimated where it is None."""
        levels = self.noise_map(x) if noise_map is None else noise_map
        y = _opponent(x)
        told = jnp.repeat(jnp.repeat(levels, CELL, 1), CELL, 2)[:, : x.shape[1], : x.shape[2]]
        light, color = told[..., :1], told[..., 1:2]
        scale = jnp.concatenate([light, color, color], -1)
        made = lax.stop_gradient(jax.vmap(_filtered)(y, scale))  # (N, FILTERS, H, W, 3)
        away = (made[:, 1:] - y[:, None]) / scale[:, None]
        seen = [
            _squashed(away[..., 0]), _squashed(jnp.linalg.norm(away[..., 1:], axis=-1)),
            jnp.log2(light / _LEAST)[:, None, ..., 0] / 4, jnp.log2(color / _LEAST)[:, None, ..., 0] / 4,
            told[:, None, ..., 2], y[:, None, ..., 0] / math.sqrt(3),
            jnp.log2(color / light)[:, None, ..., 0] / 4,
        ]  # fmt: skip
        z = jnp.moveaxis(jnp.concatenate(seen, 1), 1, -1)
        z = nnx.relu(self.second(nnx.relu(self.first(z))))
        decided = self.last(z).astype(x.dtype)
        shares = jax.nn.softmax(decided[..., :-3].reshape(*z.shape[:3], 2, FILTERS), -1)
        lit = jnp.einsum("nhwk,nkhw->nhw", shares[..., 0, :], made[..., 0])
        colored = jnp.einsum("nhwk,nkhwc->nhwc", shares[..., 1, :], made[..., 1:])
        weighed = jnp.concatenate([lit[..., None], colored], -1) + scale * decided[..., -3:]
        return weighed @ jnp.asarray(_TO_OPPONENT)

    def objective(
        self, noisy: jax.Array, target: jax.Array, penalty: Callable[[jax.Array], jax.Array]
    ) -> jax.Array:
        """The loss: every other picture of a batch is given its true map, the others the estimated one, which
        is to be near the true one (in octaves)."""
        found = self.noise_map(noisy)
        noise = _opponent(pad_to_multiple(noisy - target, CELL)) ** 2
        n, h, w, _ = noise.shape
        cells = noise.reshape(n, h // CELL, CELL, w // CELL, CELL, 3).mean((2, 4))
        true = jnp.sqrt(jnp.stack([cells[..., 0], cells[..., 1:].mean(-1)], -1))
        true = jnp.concatenate([jnp.maximum(true, _LEAST), found[..., 2:]], -1)
        given = (jnp.arange(n) % 2 == 0)[:, None, None, None]
        told = jnp.where(given, true, lax.stop_gradient(found))
        wrong = jnp.abs(jnp.log2(found[..., :2] / true[..., :2])).mean()
        return penalty(self(noisy, told) - target).mean() + _SHARE * wrong


def _opponent(x: jax.Array) -> jax.Array:
    return x @ jnp.asarray(_TO_OPPONENT.T)


def _statistics(y: jax.Array) -> jax.Array:
    """(N, H / 16, W / 16, _SEEN - 3) of (N, H, W, 3) opponent colours: how much pixels differ in a cell, as
    logarithms, at full and at half size, and its brightness."""
    n, h, w, _ = y.shape
    half = y.reshape(n, h // 2, 2, w // 2, 2, 3).mean((2, 4))
    found = []
    for picture in (y, half):
        padded = jnp.pad(picture, ((0, 0), (1, 1), (1, 1), (0, 0)), mode="reflect")
        rows = padded[:, 2:] - 2 * padded[:, 1:-1] + padded[:, :-2]
        both = (rows[:, :, 2:] - 2 * rows[:, :, 1:-1] + rows[:, :, :-2]) / 6  # Immerkaer's mask: no planes
        down = (padded[:, 2:, 1:-1] - picture) / math.sqrt(2)
        right = (padded[:, 1:-1, 2:] - picture) / math.sqrt(2)
        for change in (both, down, right):
            blocks = _log_mean(change**2, CELL * picture.shape[1] // h // 2)
            cells = blocks.reshape(n, h // CELL, 2, w // CELL, 2, 2)
            found += [cells.min((2, 4)), cells.mean((2, 4))]
    bright = y[..., :1].reshape(n, h // CELL, CELL, w // CELL, CELL, 1).mean((2, 4)) / math.sqrt(3)
    return jnp.concatenate([*found, bright], -1)


def _log_mean(squares: jax.Array, side: int) -> jax.Array:
    """(N, H / side, W / side, 2): logarithms of the means of light and of colours, about 0 to 2."""
    n, h, w, _ = squares.shape
    means = squares.reshape(n, h // side, side, w // side, side, 3).mean((2, 4))
    parts = jnp.stack([means[..., 0], means[..., 1:].mean(-1)], -1)
    return jnp.log2(parts / _LEAST**2 + 0.1) / 8


def _squashed(x: jax.Array) -> jax.Array:
    return x / (1 + jnp.abs(x))


def _levels(y: jax.Array) -> jax.Array:
    """(H / 16, W / 16, 3) of (H, W, 3) opponent colours: the standard deviation of light and of colours in
    the flattest blocks of about a cell's brightness, their planes taken off, and the share of the light's
    variance by which neighbours differ."""
    h, w = (n // _BLOCK for n in y.shape[:2])
    tiles = y.reshape(h, _BLOCK, w, _BLOCK, 3).swapaxes(1, 2).reshape(h * w, _BLOCK**2, 3)
    v, u = np.mgrid[:_BLOCK, :_BLOCK].reshape(2, -1)
    planes = np.linalg.qr(np.stack([np.ones(_BLOCK**2), v, u], 1))[0].astype(np.float32)
    rest = tiles - jnp.einsum("pk,tkc->tpc", planes, jnp.einsum("pk,tpc->tkc", planes, tiles))
    variances = (rest**2).sum(1) / (_BLOCK**2 - 3)
    light, color = variances[:, 0], variances[:, 1:].mean(-1)
    blocks = rest[..., 0].reshape(-1, _BLOCK, _BLOCK)
    down, right = blocks[:, 1:] - blocks[:, :-1], blocks[..., 1:] - blocks[..., :-1]
    steps = ((down**2).mean((1, 2)) + (right**2).mean((1, 2))) / 4
    # the flattest first; of each brightness those that hold the first share of the weight
    order = jnp.argsort(light + color)
    bright = tiles[..., 0].mean(1) / math.sqrt(3)
    centres = jnp.asarray(TONES, y.dtype)
    near = jnp.exp(-0.5 * ((bright[None] - centres[:, None]) / _TONE) ** 2) + 1e-3
    sorted_near = near[:, order]
    passed = jnp.cumsum(sorted_near, 1) - sorted_near
    used = sorted_near * (passed <= _FLATTEST * sorted_near.sum(1, keepdims=True)).astype(y.dtype)

    def mean(values: jax.Array) -> jax.Array:
        return (used * values[order][None]).sum(1) / used.sum(1)

    found = jnp.stack([mean(light), mean(color), mean(steps)], -1)  # of each tone
    cells = y[..., 0].reshape(h // 2, CELL, w // 2, CELL).mean((1, 3)) / math.sqrt(3)
    shares = jnp.exp(-0.5 * ((cells[..., None] - centres[None, None]) / (_TONE / 2)) ** 2) + 1e-6
    there = shares @ found / shares.sum(-1, keepdims=True)
    levels = jnp.maximum(jnp.sqrt(there[..., :2]), _LEAST)
    return jnp.concatenate([levels, there[..., 2:] / (there[..., :1] + 1e-12)], -1)


def _filtered(y: jax.Array, scale: jax.Array) -> jax.Array:
    """(FILTERS, H, W, 3) of (H, W, 3) opponent colours, the noise of each of which has the std `scale`."""
    return jnp.stack([y, *(_blurred(y, sigma) for sigma in BLURS), *_means(y, scale)])


def _blurred(y: jax.Array, sigma: float) -> jax.Array:
    reach = int(np.ceil(3 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    taps = (taps / taps.sum()).astype(np.float32)
    for axis in (0, 1):
        padded = jnp.pad(y, [(reach, reach) if a == axis else (0, 0) for a in range(3)], mode="symmetric")
        y = sum(t * lax.slice_in_dim(padded, i, i + y.shape[axis], axis=axis) for i, t in enumerate(taps))
    return y


def _means(y: jax.Array, scale: jax.Array) -> jax.Array:
    """(len(WIDTHS), H, W, 3): non-local means. Neighbourhoods are compared in units of the noise."""
    h, w, _ = y.shape
    border = SEARCH + AROUND
    padded = jnp.pad(y, ((border, border), (border, border), (0, 0)), mode="symmetric")
    whole = (h + 2 * AROUND, w + 2 * AROUND)
    louder = jnp.pad(scale, ((AROUND, AROUND), (AROUND, AROUND), (0, 0)), mode="edge")
    centre = lax.slice(padded, (SEARCH, SEARCH, 0), (SEARCH + whole[0], SEARCH + whole[1], 3)) / louder
    offsets = np.stack(np.meshgrid(np.arange(2 * SEARCH + 1), np.arange(2 * SEARCH + 1)), -1).reshape(-1, 2)

    def add(
        total: tuple[jax.Array, jax.Array], offset: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], None]:
        part = lax.dynamic_slice(padded, (offset[0], offset[1], 0), (*whole, 3))
        apart = ((part / louder - centre) ** 2).mean(-1)
        apart = _boxed(_boxed(apart, 0), 1)
        # 2 is what noise alone makes of equal neighbourhoods
        excess = jnp.maximum(apart - 2, 0)
        weights = jnp.exp(-excess[None] / (2 * jnp.asarray(np.square(WIDTHS), y.dtype)[:, None, None]))
        values = part[AROUND : AROUND + h, AROUND : AROUND + w]
        return (total[0] + weights[..., None] * values[None], total[1] + weights), None

    zeros = jnp.zeros((len(WIDTHS), h, w), y.dtype)
    (sums, weights), _ = lax.scan(
        add, (jnp.zeros((len(WIDTHS), h, w, 3), y.dtype), zeros), jnp.asarray(offsets)
    )
    return sums / weights[..., None]


def _boxed(plane: jax.Array, axis: int) -> jax.Array:
    side = 2 * AROUND + 1
    count = plane.shape[axis] - side + 1
    shifted = [lax.slice_in_dim(plane, i, i + count, axis=axis) for i in range(side)]
    return sum(shifted, jnp.zeros_like(shifted[0])) / side
