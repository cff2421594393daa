"""JPEG as libjpeg does it, decoded: by quality, by Photoshop's level, or by the tables of a file."""

from collections.abc import Iterable
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.dtypes import given_and_exact
from jaxisp.arrays.extents import Extent
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.safe_math import clip, clip_through, round_through, straight_through
from jaxisp.domains import EncodedRGB
from jaxisp.jpeg.codec import SAMPLING, Planes, compress, compress_full_or_half
from jaxisp.jpeg.tables import ANNEX_K_CHROMA, ANNEX_K_LUMA, PHOTOSHOP_CHROMA, PHOTOSHOP_LUMA, quality_tables
from jaxisp.options import between, one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register

BLOCK = 16
"""Rows that are coded together, where chroma is halved."""
ENCODER_REACH = 2 * BLOCK - 1
"""To the far end of the next of these blocks, from which chroma is interpolated."""
FIRST_FULL_LEVEL = 7
"""The first of Photoshop's levels that keeps chroma at full resolution."""


Sampling = Annotated[str, one_of(*SAMPLING)]
SamplingOrAuto = Annotated[str, one_of("auto", *SAMPLING)]
Phase = Annotated[int, between(0, 15)]


@parameters
class Jpeg:
    """The quality setting of libjpeg."""

    quality: Leaf = param(75.0, (1.0, 100.0), "quality", doc="libjpeg's 1 to 100, rounded")


@register(reach=ENCODER_REACH, block=BLOCK)
def jpeg(
    params: Jpeg,
    image: EncodedRGB,
    *,
    extent: Extent | None = None,
    subsampling: Sampling = "4:2:0",
    row_phase: Phase = 0,
    column_phase: Phase = 0,
) -> EncodedRGB:
    """JPEG at a quality of libjpeg, bit for bit what libjpeg-turbo decodes.

    `q = clip((base * s + 50) // 100, 1, 255)`, with `s = 5000 // quality` below 50, else
    `200 - 2 quality`; DCT coefficients become `q * round(c / q)`, half away from zero.

    Args:
        params: the quality, shared by luma and chroma.
        image: (H, W, 3) in [0, 1]; clipped, and rounded to 8 bits, as an encoder gets it.
        extent: of the picture, where the image is a larger frame.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".
        row_phase: rows of a larger JPEG above this crop, modulo 16 (what they held is guessed).
        column_phase: likewise to the left.

    Returns:
        (H, W, 3) in [0, 1], multiples of 1/255; NaN at a pixel that holds one, which is coded as black.

    Raises:
        ValueError: an unknown subsampling or a phase outside 0..15.

    Gradient: surrogate. Image: straight through the roundings and the DCT; exact in clipping, chroma
        sampling and colour. Tables: of a staircase with soft edges in place of rounding. Quality:
        straight through the rounding of quality and tables.

    Source: ITU-T T.81 (1992); libjpeg 6b and libjpeg-turbo (islow DCT, fancy upsampling).
    """
    luma, chroma = (_scaled_table(base, params.quality) for base in (ANNEX_K_LUMA, ANNEX_K_CHROMA))
    return _through_jpeg(image, luma, chroma, subsampling, (row_phase, column_phase), extent)


def _scaled_table(base: np.ndarray | jax.Array, quality: jax.Array) -> jax.Array:
    base = jnp.asarray(base, jnp.result_type(quality))
    whole = jnp.clip(jnp.round(quality), 1, 100)
    below = quality < 50
    soft_scale = jnp.where(below, 5000 / jnp.maximum(quality, 1), 200 - 2 * quality)
    # 5000 / 25 must not come out as 199.99
    scale = jnp.where(whole < 50, jnp.floor(5000 / whole + 1e-3), 200 - 2 * whole)
    table = jnp.floor((base * scale + 50) / 100 + 1e-3)
    soft = clip_through(soft_scale * base / 100, 1, 255, leak=0.1)  # so that a fitter can leave 1 and 100
    return straight_through(jnp.clip(table, 1, 255), soft)


@parameters
class JpegPhotoshop:
    """The quality setting of Photoshop."""

    level: Leaf = param(8.0, (0.0, 12.0), "level", doc="Photoshop's 0 to 12, rounded")


@register(reach=ENCODER_REACH, block=BLOCK)
def jpeg_photoshop(
    params: JpegPhotoshop,
    image: EncodedRGB,
    *,
    extent: Extent | None = None,
    subsampling: SamplingOrAuto = "auto",
) -> EncodedRGB:
    """JPEG with the tables of one of Photoshop's thirteen levels, decoded as libjpeg does.

    `q = T[round(level)]`; coefficients become `q * round(c / q)`, half away from zero.

    Args:
        params: the level.
        image: (H, W, 3) in [0, 1]; clipped, and rounded to 8 bits, as an encoder gets it.
        extent: of the picture, where the image is a larger frame.
        subsampling: "auto" (4:2:0 below level 7, 4:4:4 from there up, as Photoshop; takes as long as
            4:4:4), "4:4:4", "4:2:2" or "4:2:0".

    Returns:
        (H, W, 3) in [0, 1], multiples of 1/255; NaN at a pixel that holds one, which is coded as black.

    Raises:
        ValueError: an unknown subsampling.

    Gradient: surrogate, as that of `jpeg`; to the level, by tables interpolated between levels.

    Source: tables of Photoshop CS2 as stored in its files; ITU-T T.81 (1992).
    """
    luma, chroma = (_level_table(t, params.level) for t in (PHOTOSHOP_LUMA, PHOTOSHOP_CHROMA))
    if subsampling != "auto":
        return _through_jpeg(image, luma, chroma, subsampling, (0, 0), extent)
    full = jnp.round(params.level) >= FIRST_FULL_LEVEL
    levels = _levels(image)
    exact = levels[0].dtype
    coded = compress_full_or_half(levels, luma.astype(exact), chroma.astype(exact), full, extent)
    return _stacked(coded, image.dtype)


def _level_table(tables: np.ndarray, level: jax.Array) -> jax.Array:
    known = jnp.asarray(tables, jnp.result_type(level))
    index = jnp.clip(jnp.round(level), 0, 12).astype(jnp.int32)
    hats = jnp.maximum(0, 1 - jnp.abs(level - jnp.arange(13, dtype=known.dtype)))
    return straight_through(known[index], jnp.sum(hats[:, None, None] * known, axis=0))


def _nested(table: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in table)


@parameters
class JpegTables:
    """Quantisation tables, row = vertical frequency; those of libjpeg's quality 75 unless given."""

    luma_table: Leaf = param(
        _nested(quality_tables(75)[0]), (1.0, 255.0), "1", log=True, doc="of luma, natural order, rounded"
    )
    chroma_table: Leaf = param(
        _nested(quality_tables(75)[1]), (1.0, 255.0), "1", log=True, doc="of chroma, natural order, rounded"
    )


@register(reach=ENCODER_REACH, block=BLOCK)
def jpeg_tables(
    params: JpegTables,
    image: EncodedRGB,
    *,
    extent: Extent | None = None,
    subsampling: Sampling = "4:2:0",
    row_phase: Phase = 0,
    column_phase: Phase = 0,
) -> EncodedRGB:
    """JPEG with any quantisation tables, as those read from a camera's file; decoded as libjpeg does.

    Coefficients become `q * round(c / q)`, half away from zero, with q the rounded table entry.

    Args:
        params: the (8, 8) tables in natural order.
        image: (H, W, 3) in [0, 1]; clipped, and rounded to 8 bits, as an encoder gets it.
        extent: of the picture, where the image is a larger frame.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".
        row_phase: rows of a larger JPEG above this crop, modulo 16 (what they held is guessed).
        column_phase: likewise to the left.

    Returns:
        (H, W, 3) in [0, 1], multiples of 1/255; NaN at a pixel that holds one, which is coded as black.

    Raises:
        ValueError: an unknown subsampling or a phase outside 0..15.

    Gradient: surrogate. Image: straight through the roundings and the DCT; exact in clipping, chroma
        sampling and colour. Tables: of a staircase with soft edges in place of rounding.

    Source: ITU-T T.81 (1992); libjpeg 6b and libjpeg-turbo (islow DCT, fancy upsampling).
    """
    luma, chroma = (clip_through(round_through(t), 1, 255) for t in (params.luma_table, params.chroma_table))
    return _through_jpeg(image, luma, chroma, subsampling, (row_phase, column_phase), extent)


def _through_jpeg(
    image: jax.Array,
    luma: jax.Array,
    chroma: jax.Array,
    subsampling: str,
    phases: tuple[int, int],
    extent: Extent | None,
) -> jax.Array:
    if subsampling not in SAMPLING:
        raise ValueError(f"jpeg: subsampling must be one of {', '.join(SAMPLING)}, got {subsampling!r}")
    row_phase, column_phase = phases
    if not (0 <= row_phase < 16 and 0 <= column_phase < 16):
        raise ValueError(f"jpeg: phases must be in 0..15, got {row_phase}, {column_phase}")
    levels = _levels(image)
    red, green, blue = (
        jnp.pad(p, ((row_phase, 0), (column_phase, 0)), mode="edge") if row_phase or column_phase else p
        for p in levels
    )
    exact = red.dtype
    tables = luma.astype(exact), chroma.astype(exact)
    larger = extent and Extent(extent.height + row_phase, extent.width + column_phase)
    red, green, blue = compress((red, green, blue), *tables, subsampling, larger)
    coded = (p[row_phase:, column_phase:] for p in (red, green, blue))
    return _stacked(coded, image.dtype)


def _levels(image: jax.Array) -> Planes:
    """The planes in 8 bits, in a type that holds the sums: float16 does not."""
    exact = given_and_exact(image)[1]
    red, green, blue = (round_through(255 * clip(p, 0, 1)).astype(exact) for p in planes(image))
    return red, green, blue


def _stacked(coded: Iterable[jax.Array], dtype: Any) -> jax.Array:
    return interleaved([p.astype(dtype) / 255 for p in coded])
