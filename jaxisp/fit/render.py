"""Whole pictures rendered in tiles, and compared in strips: memory stays small."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit import model
from jaxisp.fit.pair import Example
from jaxisp.fit.solve import Fit
from jaxisp.fit.spread import Call
from jaxisp.fit.strips import in_strips
from jaxisp.fit.tiles import TILE, TILES, Shot, blank, padded, with_source
from jaxisp.io import Jpeg
from jaxisp.metrics import ssim_map
from jaxisp.pipeline import Chain, run
from jaxisp.process.programs import QUICK


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
    out *= 255  # in place: large
    np.round(out, out=out)
    out /= 255
    return compressed(out, shot.jpeg)


def compressed(picture: np.ndarray, jpeg: Jpeg | None) -> np.ndarray:
    """The picture after the JPEG encoder of a file, or as it is without one."""
    chain, tables = model.with_jpeg(Chain((), "encoder"), jpeg)
    if not tables:
        return picture.astype(np.float32)
    out = in_strips(lambda part: np.asarray(run(chain, tables, jnp.asarray(part))), picture)
    return np.clip(out, 0, 1, out=out)


def similarity(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(H, W): the SSIM of each pixel's neighbourhood, the mean of the channels."""
    return in_strips(lambda *parts: np.asarray(_ssim(*(p.astype(np.float32) for p in parts))), a, b)


@functools.partial(jax.jit, compiler_options=QUICK)  # runs as fast as it does optimised
def _ssim(a: jax.Array, b: jax.Array) -> jax.Array:
    return ssim_map(a, b).mean(-1)
