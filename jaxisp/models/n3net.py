"""N3Net: DnCNN blocks with relaxed nearest neighbours between them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxisp.models.layers import ConvNet

_MASKED = -1e9  # a logit that is never chosen
_LEAST = 1e-6  # of what a neighbour leaves to the next one


class N3Block(nnx.Module):
    """Each patch is given the differences to its k relaxed nearest neighbours, as channels.

    `w_1 = softmax(-distance / temperature)`, `logit_(j+1) = logit_j + log(1 - w_j)`: the weights of the
    j-th neighbour go to one-hot as the temperature goes to 0. Output: `[x, z_1 - x, ..., z_k - x]`.

    Args:
        features: channels in.
        embedding: channels in which patches are compared, by a network of three convolutions; the
            temperature of each patch comes from another. None: the features themselves, and one learned
            temperature for all.
        neighbors: k.
        patch, stride: size and distance of patches [px].
        window: candidates are the window x window patches around (moved inside at the border), but
            not the patch itself.

    Source: Ploetz & Roth 2018.
    """

    def __init__(
        self,
        features: int = 8,
        *,
        embedding: int | None = 8,
        neighbors: int = 7,
        patch: int = 10,
        stride: int = 5,
        window: int = 15,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        self.neighbors, self.patch, self.stride, self.window = neighbors, patch, stride, window
        self.outputs = features * (neighbors + 1)
        self.embedded = embedding is not None
        if embedding is None:
            self.log_temperature = nnx.Param(jnp.zeros((), jnp.float32))
        else:
            options: dict[str, Any] = {"depth": 3, "features": 64, "rngs": rngs, "dtype": dtype}
            self.embed = ConvNet(features, embedding, **options)
            self.temperature = ConvNet(features, 1, **options)
            self.distance_norm = nnx.BatchNorm(1, momentum=0.9, rngs=rngs)

    def __call__(self, x: jax.Array) -> jax.Array:
        h, w, c = x.shape[1:]
        x32 = _pad(x.astype(jnp.float32), self.patch, self.stride)
        grid = tuple((n - self.patch) // self.stride + 1 for n in x32.shape[1:3])
        logits = self._logits(x, x32, grid)
        values = self._patches(x32)
        averaged = [self._fold(weights @ values, grid, c) for weights in self._weights(logits)]
        out = jnp.concatenate([x32] + [z - x32 for z in averaged], axis=-1)
        return out[:, :h, :w].astype(x.dtype)

    def _logits(self, x: jax.Array, x32: jax.Array, grid: tuple[int, ...]) -> jax.Array:
        """(N, P, P): minus the distance over the temperature; masked where it is no candidate."""
        allowed = jnp.asarray(_candidates(grid, self.window))
        if not self.embedded:
            distances = _distances(self._patches(x32))
            scaled = distances * jnp.exp(-self.log_temperature[...])
        else:
            padded = _pad(self.embed(x).astype(jnp.float32), self.patch, self.stride)
            distances = _distances(self._patches(padded))
            mask = jnp.broadcast_to(allowed[None, :, :, None], (*distances.shape, 1))
            normed = self.distance_norm(distances[..., None], mask=mask)[..., 0]
            log_temperature = _pad(self.temperature(x).astype(jnp.float32), self.patch, self.stride)
            mean = self._patches(log_temperature).mean(axis=-1)
            scaled = normed * jnp.exp(-jnp.clip(mean, -8, 8))[:, :, None]
        return jnp.where(allowed[None], -scaled, _MASKED)

    def _weights(self, logits: jax.Array) -> list[jax.Array]:
        found = []
        for _ in range(self.neighbors):
            weights = jax.nn.softmax(logits, axis=-1)
            found.append(weights)
            logits = logits + jnp.log(jnp.maximum(1 - weights, _LEAST))
        return found

    def _patches(self, x: jax.Array) -> jax.Array:
        """(N, P, patch * patch * C)."""
        n, h, w, c = x.shape
        rows, columns = (self._starts(size) for size in (h, w))
        x = x[:, rows][:, :, :, columns]  # (N, rows, patch, columns, patch, C)
        x = x.transpose(0, 1, 3, 2, 4, 5)
        return x.reshape(n, x.shape[1] * x.shape[2], self.patch * self.patch * c)

    def _starts(self, size: int) -> np.ndarray:
        starts = np.arange(0, size - self.patch + 1, self.stride)
        return starts[:, None] + np.arange(self.patch)

    def _fold(self, patches: jax.Array, grid: tuple[int, ...], channels: int) -> jax.Array:
        """Patches put back where they came from, averaged where they overlap."""
        p, s = self.patch, self.stride
        h, w = ((g - 1) * s + p for g in grid)
        n = patches.shape[0]
        x = patches.reshape(n, *grid, p, p, channels).transpose(0, 1, 3, 2, 4, 5)
        rows, columns = self._starts(h), self._starts(w)
        total = jnp.zeros((n, h, grid[1], p, channels), x.dtype).at[:, rows].add(x)
        total = jnp.zeros((n, h, w, channels), x.dtype).at[:, :, columns].add(total)
        counts = np.zeros((h, w, 1), np.float32)
        for r in rows:
            for q in columns:
                counts[r[0] : r[0] + p, q[0] : q[0] + p] += 1
        return total / counts[None]


class N3Net(nnx.Module):
    """Three DnCNNs of 6 layers with an N3 block between each two.

    As published (gray) 705,255 parameters are used. `embedding=None` is the use that Jaroensri et al.
    2019 made of it: features compared as they are and one temperature a block, 530,517 for colour.

    Args:
        channels: of the image.
        blocks: DnCNNs.
        between: channels between them.
        depth, features: of each DnCNN.
        residual: each DnCNN adds its first channels to its input's; True in both publications.
        neighbors, patch, stride, window, embedding: see `N3Block`.
        rngs: for the initial weights.
        dtype: of the computation, bfloat16 or None (float32); weights and distances are float32.

    Source: Ploetz & Roth 2018.
    """

    reach = None  # patches are compared over a window of 15 x 15: not local
    multiple = 5
    tile = 80  # it is trained on patches of this size, all of whose patches are candidates

    def __init__(
        self,
        channels: int = 3,
        *,
        blocks: int = 3,
        between: int = 8,
        depth: int = 6,
        features: int = 64,
        embedding: int | None = 8,
        neighbors: int = 7,
        patch: int = 10,
        stride: int = 5,
        window: int = 15,
        rngs: nnx.Rngs,
        dtype: Any = None,
    ) -> None:
        options: dict[str, Any] = {
            "embedding": embedding, "neighbors": neighbors,
            "patch": patch, "stride": stride, "window": window,
        }  # fmt: skip
        self.matchers = nnx.List(
            [N3Block(between, **options, rngs=rngs, dtype=dtype) for _ in range(blocks - 1)]
        )
        sizes = [channels] + [m.outputs for m in self.matchers]
        outputs = [between] * (blocks - 1) + [channels]
        self.nets = nnx.List(
            [
                ConvNet(a, b, depth=depth, features=features, rngs=rngs, dtype=dtype)
                for a, b in zip(sizes, outputs)
            ]
        )

    def __call__(self, x: jax.Array) -> jax.Array:
        y = _residual(self.nets[0], x)
        for matcher, net in zip(self.matchers, self.nets[1:]):
            y = _residual(net, matcher(y))
        return y.astype(x.dtype)


def _residual(net: ConvNet, x: jax.Array) -> jax.Array:
    y = net(x)
    shared = min(x.shape[-1], y.shape[-1])
    return y.at[..., :shared].add(x[..., :shared].astype(y.dtype))


def _pad(x: jax.Array, patch: int, stride: int) -> jax.Array:
    """Repeat the last row and column until whole patches cover the image."""
    missing = [max(patch - n, 0) or -(n - patch) % stride for n in x.shape[1:3]]
    return jnp.pad(x, ((0, 0), (0, missing[0]), (0, missing[1]), (0, 0)), mode="edge")


def _distances(patches: jax.Array) -> jax.Array:
    """(N, P, P) squared distances of (N, P, D); of centred patches, which cancels less."""
    centred = patches - patches.mean(axis=1, keepdims=True)
    squares = (centred**2).sum(axis=-1)
    products = jnp.einsum("npd,nqd->npq", centred, centred)
    return jnp.maximum(squares[:, :, None] + squares[:, None] - 2 * products, 0)


def _candidates(grid: tuple[int, ...], window: int) -> np.ndarray:
    """(P, P) boolean: whether patch q is among the window around patch p, and is not p."""
    near = []
    for size in grid:
        index, half = np.arange(size), window // 2
        center = np.clip(index, half, max(size - 1 - half, half))
        near.append(np.abs(index[None] - center[:, None]) <= half)
    both = near[0][:, None, :, None] & near[1][None, :, None, :]
    count = grid[0] * grid[1]
    return both.reshape(count, count) & ~np.eye(count, dtype=bool)
