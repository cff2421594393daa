"""Colour balance: white balance by gains and by temperature, colour matrix, saturation, hue."""

import jax
import jax.numpy as jnp

from jaxisp import cfa as filters
from jaxisp.arrays.linear import scaled
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.cfa import Pattern, rows_of_cell
from jaxisp.color import apply_matrix, luma, rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.colorimetry import D65_TEMPERATURE, D65_TINT, illuminant_rgb
from jaxisp.domains import RGB, CameraRGB, LinearRGB, Mosaic
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register


@parameters
class WhiteBalance:
    """One gain a colour; green is 1 by convention."""

    gains: Leaf = param(
        (1.0, 1.0, 1.0), (0.125, 8.0), "1", log=True, doc="multipliers of red, green and blue"
    )


@register(reach=0)
def white_balance(params: WhiteBalance, image: CameraRGB) -> CameraRGB:
    """Multiply each colour by its gain.

    `y_c = gains_c * x_c`, not clipped: a gain below 1 pulls clipped highlights off white.

    Args:
        params: gains of R, G, B.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light.

    Gradient: exact.

    Source: von Kries 1902; Jaroensri et al. 2019, section 3.
    """
    return image * params.gains.astype(image.dtype)[None, None]


@register(reach=0, block=rows_of_cell)
def mosaic_white_balance(params: WhiteBalance, image: Mosaic, *, cfa: Pattern = "RGGB") -> Mosaic:
    """Multiply each photosite by the gain of its colour.

    `y = gains_c * x`, with c the colour of the photosite, not clipped.

    Args:
        params: gains of R, G, B; both greens have the same.
        image: (H, W) linear light, black level subtracted, any range.
        cfa: the Bayer or X-Trans pattern, row-major from the top-left.

    Returns:
        (H, W) linear light.

    Raises:
        ValueError: unknown pattern.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3.
    """
    r, g, b = params.gains.astype(image.dtype)
    return image * filters.select(filters.masks((image.shape[0], image.shape[1]), cfa), r, g, b)


@parameters
class WhiteBalanceTemperature:
    """Two illuminants, each by temperature and distance from the Planckian locus. Defaults: D65."""

    temperature: Leaf = param(
        D65_TEMPERATURE, (2000.0, 12000.0), "K", log=True, doc="colour temperature white shall have"
    )
    tint: Leaf = param(
        D65_TINT, (-0.03, 0.03), "Duv", doc="its distance from the locus: positive greenish, negative pinkish"
    )
    source_temperature: Leaf = param(
        D65_TEMPERATURE, (2000.0, 12000.0), "K", log=True, doc="colour temperature white has now"
    )
    source_tint: Leaf = param(D65_TINT, (-0.03, 0.03), "Duv", doc="its distance from the locus")


@register(reach=0)
def white_balance_temperature(params: WhiteBalanceTemperature, image: LinearRGB) -> LinearRGB:
    """Move the colour of white from one illuminant to another: a lower temperature is redder.

    `y_c = x_c * w_c(temperature, tint) / w_c(source_temperature, source_tint)`, where w is the
    illuminant in linear sRGB with luminance 1. The tint is Duv: the signed distance from the
    Planckian locus in CIE 1960 (u, v), at right angles to it. Below 0.01, where a very red
    illuminant leaves sRGB, a channel w of the ratio is bent to `1e-4 / (0.02 - w)`, which stays
    positive. A raw converter's temperature slider names the source.

    Args:
        params: temperatures [K] and tints [Duv]. The defaults are D65 on both sides: no change.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; CIE 15:2018 (Planckian locus); CIE 1960 UCS.
    """
    target = _bent_positive(illuminant_rgb(params.temperature, params.tint))
    source = _bent_positive(illuminant_rgb(params.source_temperature, params.source_tint))
    return image * (target / source).astype(image.dtype)[None, None]


def _bent_positive(x: jax.Array, knee: float = 0.01) -> jax.Array:
    """x above the knee; below it a hyperbola that joins with the same slope and never reaches 0."""
    below = jnp.minimum(x, knee)
    return jnp.where(x > knee, x, knee * knee / (2 * knee - below))


@parameters
class ColorMatrix:
    """A 3x3 matrix; rows that sum to 1 keep white."""

    matrix: Leaf = param(
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        (-4.0, 4.0),
        "1",
        doc="camera RGB to linear sRGB, one output a row",
    )


@register(reach=0)
def color_matrix(params: ColorMatrix, image: CameraRGB) -> LinearRGB:
    """Turn the sensor's primaries into sRGB's.

    `y = matrix @ x` at each pixel, not clipped.

    Args:
        params: the matrix; `jaxisp.io.Raw.camera_to_srgb` is what a RAW file states.
        image: (H, W, 3) white-balanced linear light, any range.

    Returns:
        (H, W, 3) linear sRGB.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; DNG Specification 1.6, chapter 6.
    """
    return apply_matrix(params.matrix, image)


@parameters
class Saturation:
    """Chroma gain."""

    amount: Leaf = param(1.0, (0.0, 4.0), "1", doc="0 is grey, 1 leaves the image as it is")


@register(reach=0)
def saturation(params: Saturation, image: RGB) -> RGB:
    """Scale the chroma; luma stays.

    `y_c = Y + amount * (x_c - Y)` with Y the Rec. 601 luma, which scales Cb and Cr by the amount.

    Args:
        params: amount.
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; ITU-R BT.601.
    """
    r, g, b = planes(image)
    y = luma(r, g, b)
    return interleaved([y + scaled(params.amount.astype(y.dtype), c - y) for c in (r, g, b)])


@parameters
class HueRotation:
    """Rotation of the chroma plane."""

    angle: Leaf = param(0.0, (-180.0, 180.0), "deg", doc="from Cb towards Cr")


@register(reach=0)
def hue_rotation(params: HueRotation, image: RGB) -> RGB:
    """Turn every hue by the same angle; luma and the length of (Cb, Cr) stay.

    `(Cb, Cr)' = rotation(angle) @ (Cb, Cr)`, in JFIF's scale.

    Args:
        params: angle [deg].
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image, not clipped.

    Gradient: exact.

    Source: ITU-T T.871 (JFIF) for the chroma plane.
    """
    y, cb, cr = rgb_to_ycbcr_planes(*planes(image))
    angle = params.angle * (jnp.pi / 180)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    turned = scaled(cos, cb) - scaled(sin, cr), scaled(sin, cb) + scaled(cos, cr)
    return interleaved(ycbcr_to_rgb_planes(y, *turned))
