"""JPEG as the header of a file states it, where that is more than two 8-bit tables and a sampling."""

from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.dtypes import given_and_exact
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.safe_math import clip, clip_through, round_through
from jaxisp.color import apply_matrix, srgb_to_linear
from jaxisp.domains import EncodedRGB
from jaxisp.jpeg.codec import SAMPLING, Planes, compress_each, rgb_to_ycbcr, ycbcr_to_rgb
from jaxisp.jpeg.tables import quality_tables
from jaxisp.options import one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.jpeg import BLOCK, ENCODER_REACH, Sampling
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

COMPONENTS = ("YCbCr", "RGB")
Components = Annotated[str, one_of(*COMPONENTS)]


def _nested(values: Any) -> Any:
    """An array as tuples of numbers."""
    return tuple(map(_nested, values)) if np.ndim(values) else float(values)


@parameters
class JpegFile:
    """A table for each component, row = vertical frequency, and the colour space of what is coded."""

    tables: Leaf = param(
        _nested(np.stack([quality_tables(75)[i] for i in (0, 1, 1)])), (1.0, 65535.0), "1", log=True,
        doc="of each component, natural order, rounded",
    )  # fmt: skip
    curve: Leaf = param(
        _nested(srgb_to_linear(np.linspace(0, 1, 511))), (0.0, 1.0), "1",
        doc="linear light of the codes of the file's colour space and half-way between, rising",
    )  # fmt: skip
    to_file: Leaf = param(_nested(np.eye(3)), (-4.0, 4.0), "1", doc="linear sRGB to the file's linear RGB")
    from_file: Leaf = param(_nested(np.eye(3)), (-4.0, 4.0), "1", doc="the way back")


@register(reach=ENCODER_REACH, block=BLOCK)
def jpeg_file(
    params: JpegFile,
    image: EncodedRGB,
    *,
    subsampling: Sampling = "4:2:0",
    components: Components = "YCbCr",
    converts: bool = True,
    in_14_bits: bool = True,
) -> EncodedRGB:
    """JPEG with a table for each component, of Y'CbCr or of RGB, in the colour space of the file.

    The picture is converted to the file's colour space, rounded to 8 bits there, coded
    and decoded as libjpeg does it (`q * round(c / q)`, half away from zero), converted back to sRGB, cut to
    its gamut and rounded.

    Args:
        params: the (3, 8, 8) tables in natural order; the file's colour space.
        image: (H, W, 3) in [0, 1]; clipped, and rounded to 8 bits, as an encoder gets it.
        subsampling: "4:4:4", "4:2:2" or "4:2:0": of the second and the third component.
        components: "YCbCr", or "RGB" for components as they are.
        converts: whether the file has a colour space of its own; the parameters say nothing of it if not.
        in_14_bits: whether light and matrices were of 14 bits, as littleCMS has them, or exact.

    Returns:
        (H, W, 3) in [0, 1], multiples of 1/255; NaN at a pixel that holds one, which is coded as black.

    Raises:
        ValueError: an unknown subsampling or unknown components.

    Gradient: surrogate. Image: straight through the roundings and the DCT; exact in clipping, colour and
        chroma sampling. Tables: of a staircase with soft edges in place of rounding.

    Source: ITU-T T.81 (1992); libjpeg 6b and libjpeg-turbo (islow DCT, fancy upsampling); ICC.1:2022,
        annex F (matrix and curves); littleCMS 2 (8-bit matrix shaper).
    """
    if subsampling not in SAMPLING:
        raise ValueError(f"jpeg_file: subsampling must be one of {', '.join(SAMPLING)}, got {subsampling!r}")
    if components not in COMPONENTS:
        raise ValueError(f"jpeg_file: components must be one of {', '.join(COMPONENTS)}, got {components!r}")
    exact = given_and_exact(image)[1]  # float16 does not hold the sums
    given = clip(image.astype(exact), 0, 1)
    lost = jnp.isnan(given).any(-1, keepdims=True)
    given = jnp.where(lost, 0, given)
    curve = jnp.asarray(params.curve, exact)
    codes = 255 * given
    if converts:
        held = _in_14_bits if in_14_bits else lambda x: x
        light = held(apply_matrix(held(params.to_file), held(srgb_eotf(given))))
        # exact where a code gives way to the next, as half codes are nodes
        codes = jnp.interp(clip(light, 0, 1), curve, jnp.arange(511, dtype=exact)) / 2
    red, green, blue = planes(materialize(round_through(codes)))
    tables = clip_through(round_through(params.tables), 1, 65535).astype(exact)
    decoded = interleaved(_coded((red, green, blue), tables, subsampling, components))
    if converts:
        light = apply_matrix(params.from_file, _light(curve, decoded))
        decoded = round_through(255 * srgb_oetf(clip(light, 0, 1)))
    return jnp.where(lost, jnp.nan, decoded / 255).astype(image.dtype)


def _coded(rgb: Planes, tables: jax.Array, subsampling: str, components: str) -> Planes:
    if components == "RGB":
        return compress_each(rgb, tables, subsampling)
    return ycbcr_to_rgb(*materialize(compress_each(materialize(rgb_to_ycbcr(rgb)), tables, subsampling)))


def _in_14_bits(x: jax.Array) -> jax.Array:
    """As littleCMS holds light and matrices for pictures of 8 bits."""
    return round_through(2.0**14 * x) * 2.0**-14


def _light(curve: jax.Array, codes: jax.Array) -> jax.Array:
    """The curve at codes in 0..255, exact at whole ones; its slope is that of the line to the next node."""
    below = jnp.minimum(jnp.floor(2 * codes), 509).astype(jnp.int32)
    share = 2 * codes - below.astype(codes.dtype)
    return curve[below] * (1 - share) + curve[below + 1] * share
