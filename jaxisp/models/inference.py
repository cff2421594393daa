"""Denoise a picture of any size with bounded memory and no seams."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxisp.errors import InputError

TILE = 256
Apply = Callable[..., Any]
"""A tile, and where its top left corner lies, to what the network makes of it."""


def denoise(model: nnx.Module, image: Any, *, tile: int | None = None, strength: float = 1.0) -> np.ndarray:
    """Apply a network to one picture, in tiles where it is larger than one.

    A network that looks `reach` pixels far gets tiles that overlap by twice that, of which the parts that a
    tile's border reaches are dropped: the result is that of the whole picture at once. A network that
    is not local (N3Net compares patches, NAFNet and FFDNet average over what they are given) has
    `reach` None: its tiles overlap by a half and are blended, without seams, but the result depends
    on the tile.

    Args:
        model: maps (N, H, W, C) to the same shape, with attributes `reach` (int or None) and `multiple`
            (tiles begin at its multiples); as left by its constructor or `train()`, batch norms use
            their running averages here. One with a `noise_map` is given that of the whole picture.
        image: (H, W, C), in the encoding that the model was trained on.
        tile: side of a tile [px]; the model's `tile`, or 256, unless given.
        strength: below 1, the share of what it takes off that is taken off; above 1, how much stronger than
            estimated a network with a `noise_map` is told that the noise is, and without one the share, too.

    Returns:
        (H, W, C) float32, not clipped.

    Raises:
        ValueError: the image is not (H, W, C).
        InputError: the tile is too small for the network's reach.
    """
    image = np.asarray(image, np.float32)
    if image.ndim != 3:
        raise ValueError(f"denoise takes one image (H, W, C), got {image.shape}")
    model = nnx.clone(model)
    model.eval()
    graph, state = nnx.split(model)
    reach, multiple = getattr(model, "reach", None), getattr(model, "multiple", 1)
    own: int = getattr(model, "tile", TILE)
    tile = tile or own
    tile += -tile % multiple
    h, w = image.shape[:2]
    padded = np.pad(image, ((0, -h % multiple), (0, -w % multiple), (0, 0)), mode="edge")
    share = strength
    if hasattr(model, "noise_map"):
        told: Any = model  # its class is the user's
        found, cell = functools.partial(_noise_map, graph, state), told.cell
        levels = _mapped(found, padded, tile, told.map_reach, cell)
        levels[..., :2] *= max(strength, 1.0)  # of luma and of chroma
        share = min(strength, 1.0)

        def apply(part: np.ndarray, y: int = 0, x: int = 0) -> Any:
            rows, columns = (
                slice(start // cell, -(-(start + n) // cell)) for start, n in zip((y, x), part.shape)
            )
            return _apply_told(graph, state, part, levels[rows, columns])
    else:

        def apply(part: np.ndarray, y: int = 0, x: int = 0) -> Any:
            return _apply(graph, state, part)

    if max(padded.shape[:2]) <= tile:
        out = np.asarray(apply(padded))
    elif reach:
        out = _exact(apply, padded, tile, reach, multiple)
    else:
        out = _blended(apply, padded, tile, multiple)
    out = out[:h, :w]
    return out if share == 1 else image + np.float32(share) * (out - image)


@functools.partial(jax.jit, static_argnums=0)
def _apply(graph: Any, state: Any, image: jax.Array) -> jax.Array:
    return nnx.merge(graph, state)(image[None])[0].astype(jnp.float32)


@functools.partial(jax.jit, static_argnums=0)
def _apply_told(graph: Any, state: Any, image: jax.Array, levels: jax.Array) -> jax.Array:
    return nnx.merge(graph, state)(image[None], levels[None])[0].astype(jnp.float32)


@functools.partial(jax.jit, static_argnums=0)
def _noise_map(graph: Any, state: Any, image: jax.Array) -> jax.Array:
    return nnx.merge(graph, state).noise_map(image[None])[0].astype(jnp.float32)


def _mapped(found: Apply, image: np.ndarray, tile: int, reach: int | None, cell: int) -> np.ndarray:
    """The noise map of a whole picture, whose sizes are multiples of a cell's; in tiles where it is local."""
    if reach is None:
        return np.array(found(image))
    margin = reach + -reach % cell
    side = max(tile, 4 * margin)
    side += -side % cell
    out: np.ndarray | None = None
    rows, columns = (_starts(n, side, 2 * margin) for n in image.shape[:2])
    for y in rows:
        for x in columns:
            part = np.asarray(found(image[y : y + side, x : x + side]))
            if out is None:
                out = np.empty((image.shape[0] // cell, image.shape[1] // cell, part.shape[-1]), np.float32)
            top, left = (margin // cell if start else 0 for start in (y, x))
            first, second = y // cell, x // cell
            out[first + top : first + side // cell, second + left : second + side // cell] = part[top:, left:]
    assert out is not None
    return out


def _exact(apply: Apply, image: np.ndarray, tile: int, reach: int, multiple: int) -> np.ndarray:
    margin = reach + -reach % multiple
    if tile <= 2 * margin:
        raise InputError(
            f"a tile of {tile} px is too small for a network that looks {reach} px far: "
            f"expected more than {2 * margin}"
        )
    out = np.empty_like(image)
    rows, columns = (_starts(n, tile, 2 * margin) for n in image.shape[:2])
    for y in rows:
        for x in columns:
            part = np.asarray(apply(image[y : y + tile, x : x + tile], y, x))
            top, left = (margin if start else 0 for start in (y, x))
            out[y + top : y + tile, x + left : x + tile] = part[top:, left:]
    return out


def _blended(apply: Apply, image: np.ndarray, tile: int, multiple: int) -> np.ndarray:
    overlap = tile // 2 - tile // 2 % multiple
    total, weights = np.zeros_like(image), np.zeros((*image.shape[:2], 1), np.float32)
    rows, columns = (_starts(n, tile, overlap) for n in image.shape[:2])
    for y in rows:
        for x in columns:
            part = np.asarray(apply(image[y : y + tile, x : x + tile], y, x))
            window = (_ramp(part.shape[0])[:, None] * _ramp(part.shape[1]))[..., None]
            total[y : y + tile, x : x + tile] += window * part
            weights[y : y + tile, x : x + tile] += window
    return total / weights


def _starts(size: int, tile: int, overlap: int) -> list[int]:
    """Where tiles begin so that neighbours overlap by at least `overlap` and the last ends with the image."""
    if size <= tile:
        return [0]
    return [*range(0, size - tile, tile - overlap), size - tile]


def _ramp(size: int) -> np.ndarray:
    """Weights that fall towards both ends, nowhere 0."""
    distance = np.minimum(np.arange(size), np.arange(size)[::-1])
    return ((distance + 0.5) / size).astype(np.float32)
