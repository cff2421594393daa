"""Whole pictures rendered block by block, so that memory does not grow with them, and their figures."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit import model
from jaxisp.fit.align import Alignment, warp
from jaxisp.fit.program import render_block
from jaxisp.fit.tiles import HALO
from jaxisp.io import Jpeg
from jaxisp.metrics import ssim_map
from jaxisp.pipeline import Chain, Params, run

BLOCK = 256
_STRIP = 512  # rows at once of what runs on whole pictures, a multiple of 16
_STRIP_HALO = 16  # rows around, a multiple of 16 as the JPEG's largest unit


def render(
    design: model.Design,
    params: Params,
    camera_rgb: Any,
    alignment: Alignment,
    shape: tuple[int, ...],
    jpeg: Jpeg | None = None,
) -> np.ndarray:
    """(H', W', 3) encoded sRGB in [0, 1], 8 bits, laid on the camera's picture.

    Args:
        design: the discrete choices.
        params: bounded.
        camera_rgb: (H, W, 3), the whole demosaicked RAW.
        alignment: of the RAW on the picture.
        shape: of the picture.
        jpeg: whose tables the render is compressed with, where there is one.
    """
    place = Alignment(*(jnp.float32(v) for v in alignment))
    warped = np.asarray(warp(jnp.asarray(camera_rgb), place, shape))
    radius2 = _radius2(alignment, shape, camera_rgb.shape)
    out = np.empty(warped.shape, np.float32)
    h, w = shape[:2]
    block = tuple(min(BLOCK, -(-n // 32) * 32) for n in (h, w))
    pads = [(HALO, HALO + -n % b) for n, b in zip((h, w), block)]
    warped = np.pad(warped, [*pads, (0, 0)], mode="reflect")
    radius2 = np.pad(radius2, pads, mode="edge")
    median = np.int32(model.MEDIANS.index(design.median))
    for y in range(0, h, block[0]):
        for x in range(0, w, block[1]):
            rows, columns = slice(y, y + block[0] + 2 * HALO), slice(x, x + block[1] + 2 * HALO)
            done = render_block(design.place, median, params, warped[rows, columns], radius2[rows, columns])
            part = np.asarray(done)[HALO:-HALO, HALO:-HALO]
            out[y : y + block[0], x : x + block[1]] = part[: h - y, : w - x]
    return compressed(np.round(np.clip(out, 0, 1) * 255) / 255, jpeg)


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
    return in_strips(lambda part: _ssim(jnp.asarray(part)), both)


def _ssim(both: jax.Array) -> np.ndarray:
    return np.asarray(ssim_map(both[..., :3], both[..., 3:])).mean(-1)


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


def _radius2(alignment: Alignment, shape: tuple[int, ...], raw_shape: tuple[int, ...]) -> np.ndarray:
    """(H', W'): squared distance from the centre of the RAW of each pixel of the picture; its corner is 1."""
    scales, shifts = (alignment.scale_y, alignment.scale_x), (alignment.dy, alignment.dx)
    arms = [
        float(scale) * (np.arange(n) - (n - 1) / 2) + float(shift)
        for n, scale, shift in zip(shape[:2], scales, shifts)
    ]
    corner = max(sum((n - 1) ** 2 for n in raw_shape[:2]) / 4, 1)
    return ((arms[0][:, None] ** 2 + arms[1] ** 2) / corner).astype(np.float32)
