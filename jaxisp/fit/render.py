"""Whole pictures rendered in tiles, and what else runs on whole pictures in parts: memory stays small."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit import model
from jaxisp.fit.pair import Example
from jaxisp.fit.solve import Fit
from jaxisp.fit.spread import Call
from jaxisp.fit.tiles import TILE, TILES, Shot, blank, padded, with_source
from jaxisp.io import Jpeg
from jaxisp.metrics import ssim_map
from jaxisp.pipeline import Chain, run
from jaxisp.process.programs import QUICK

_STRIP = 512  # rows at once of what runs on whole pictures, a multiple of 16
_STRIP_HALO = 16  # rows around, a multiple of 16 as the JPEG's largest unit


def render(
    fit: Fit,
    vector: np.ndarray,
    pair: int,
    shot: Shot,
    example: Example,
    moved: np.ndarray | None = None,
    where: np.ndarray | None = None,
) -> np.ndarray:
    """(H', W', 3) encoded sRGB in [0, 1], 8 bits, laid on the camera's picture, encoder included.

    Tile by tile, by the program that was fitted.

    Args:
        fit: whose choices and fixed parameters there are.
        vector: of the camera, the image and its geometry.
        pair: which of the fit's it is.
        shot: where the picture lies.
        example: the picture, as the alignment turned it, and the RAW.
        moved: another shift and scale to start from than the alignment's.
        where: (H', W') the pixels that are wanted; tiles without one stay black.
    """
    own = fit.without_sampling() if shot.jpeg else fit
    given = own.given(pair, moved)._replace(moving=np.zeros_like(fit.moving))
    out = np.zeros(example.picture.shape, np.float32)
    mosaic = padded(example)
    h, w = example.picture.shape[:2]
    corners = [(y, x) for y in range(0, h, TILE) for x in range(0, w, TILE)]
    if where is not None:
        corners = [(y, x) for y, x in corners if where[y : y + TILE, x : x + TILE].any()]

    def call(some: list[tuple[int, int]]) -> Call:
        chunk = with_source(blank(example, mosaic, shot, some), shot.cfa, fit.design)
        return given, vector.astype(np.float32), chunk

    groups = [corners[first : first + TILES] for first in range(0, len(corners), TILES)]
    for some, found in zip(groups, fit.each(call, groups)[0]):
        for (y, x), tile in zip(some, np.asarray(found.render)):
            part = out[y : y + TILE, x : x + TILE]
            part[:] = tile[: part.shape[0], : part.shape[1]]
    return compressed(np.round(out * 255) / 255, shot.jpeg)


def compressed(picture: np.ndarray, jpeg: Jpeg | None) -> np.ndarray:
    """The picture after the JPEG encoder of a file, or as it is without one."""
    chain, tables = model.with_jpeg(Chain((), "encoder"), jpeg)
    if not tables:
        return picture.astype(np.float32)
    strips = in_strips(lambda part: np.asarray(run(chain, tables, jnp.asarray(part))), picture)
    return np.clip(strips, 0, 1)


def similarity(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(H, W): the SSIM of each pixel's neighbourhood, the mean of the channels."""
    both = np.concatenate([a, b], axis=-1).astype(np.float32)
    return in_strips(lambda part: np.asarray(_ssim(part)), both)


@functools.partial(jax.jit, compiler_options=QUICK)  # runs as fast as it does optimised
def _ssim(both: jax.Array) -> jax.Array:
    return ssim_map(both[..., :3], both[..., 3:]).mean(-1)


def in_strips(function: Callable[[np.ndarray], np.ndarray], image: np.ndarray) -> np.ndarray:
    """A function of a whole picture, run on strips of it with their surroundings."""
    h = image.shape[0]
    if h <= 2 * _STRIP:
        return function(image)
    parts = []
    for top in range(0, h, _STRIP):
        first, last = max(top - _STRIP_HALO, 0), min(top + _STRIP + _STRIP_HALO, h)
        done = function(image[first:last])
        parts.append(done[top - first : top - first + min(_STRIP, h - top)])
    return np.concatenate(parts)
