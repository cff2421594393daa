"""Conversions between colour spaces. Each `a_to_b` is the exact inverse of its `b_to_a`."""

from jaxisp.arrays.planes import interleaved, planes
from jaxisp.color import (
    SRGB_TO_XYZ,
    XYZ_TO_SRGB,
    apply_matrix,
    rgb_to_ycbcr_planes,
    ycbcr_to_rgb_planes,
)
from jaxisp.colorimetry import PROPHOTO_TO_SRGB, SRGB_TO_PROPHOTO
from jaxisp.domains import XYZ, EncodedRGB, LinearRGB, ProPhotoRGB, YCbCr
from jaxisp.pipeline import register


@register(reach=0)
def linear_srgb_to_xyz(image: LinearRGB) -> XYZ:
    """Linear sRGB to CIE 1931 XYZ under D65.

    `XYZ = M @ RGB` with the four-digit matrix of the standard; white has Y = 1.

    Args:
        image: (H, W, 3) linear sRGB, any range.

    Returns:
        (H, W, 3) XYZ, not clipped.

    Gradient: exact.

    Source: IEC 61966-2-1:1999.
    """
    return apply_matrix(SRGB_TO_XYZ, image)


@register(reach=0)
def xyz_to_linear_srgb(image: XYZ) -> LinearRGB:
    """CIE 1931 XYZ under D65 to linear sRGB.

    `RGB = inv(M) @ XYZ` with M as in `linear_srgb_to_xyz` (the standard prints four digits of it).

    Args:
        image: (H, W, 3) XYZ, Y of white at 1.

    Returns:
        (H, W, 3) linear sRGB, negative where a colour is outside its gamut.

    Gradient: exact.

    Source: IEC 61966-2-1:1999.
    """
    return apply_matrix(XYZ_TO_SRGB, image)


@register(reach=0)
def prophoto_to_linear_srgb(image: ProPhotoRGB) -> LinearRGB:
    """Linear ProPhoto (ROMM) RGB under D50 to linear sRGB under D65, Bradford-adapted.

    `RGB = inv(M_sRGB) @ Bradford(D50, D65) @ M_ROMM @ x`; white goes to white.

    Args:
        image: (H, W, 3) linear ProPhoto RGB, any range.

    Returns:
        (H, W, 3) linear sRGB, negative where a colour is outside its gamut.

    Gradient: exact.

    Source: ISO 22028-2:2013 (ROMM RGB); ICC.1:2022, annex E (Bradford); IEC 61966-2-1:1999.
    """
    return apply_matrix(PROPHOTO_TO_SRGB, image)


@register(reach=0)
def linear_srgb_to_prophoto(image: LinearRGB) -> ProPhotoRGB:
    """Linear sRGB under D65 to linear ProPhoto (ROMM) RGB under D50, Bradford-adapted.

    The inverse of the matrix of `prophoto_to_linear_srgb`; white goes to white.

    Args:
        image: (H, W, 3) linear sRGB, any range.

    Returns:
        (H, W, 3) linear ProPhoto RGB; sRGB's gamut lies inside.

    Gradient: exact.

    Source: ISO 22028-2:2013 (ROMM RGB); ICC.1:2022, annex E (Bradford); IEC 61966-2-1:1999.
    """
    return apply_matrix(SRGB_TO_PROPHOTO, image)


@register(reach=0)
def rgb_to_ycbcr(image: EncodedRGB) -> YCbCr:
    """Encoded RGB to luma and two chroma differences, real-valued.

    `Y = .299 R + .587 G + .114 B, Cb = (B - Y) / 1.772, Cr = (R - Y) / 1.402`.

    Args:
        image: (H, W, 3) encoded sRGB, any range.

    Returns:
        (H, W, 3): luma in [0, 1] and chroma in [-0.5, 0.5] for RGB in [0, 1]; not rounded.

    Gradient: exact.

    Source: ITU-T T.871 (JFIF); ITU-R BT.601.
    """
    return interleaved(rgb_to_ycbcr_planes(*planes(image)))


@register(reach=0)
def ycbcr_to_rgb(image: YCbCr) -> EncodedRGB:
    """Luma and two chroma differences to encoded RGB, real-valued.

    `R = Y + 1.402 Cr, B = Y + 1.772 Cb, G = (Y - .299 R - .114 B) / .587`.

    Args:
        image: (H, W, 3): luma in [0, 1], chroma in [-0.5, 0.5].

    Returns:
        (H, W, 3) encoded sRGB, outside [0, 1] where the triple is no colour; not clipped.

    Gradient: exact.

    Source: ITU-T T.871 (JFIF); ITU-R BT.601.
    """
    return interleaved(ycbcr_to_rgb_planes(*planes(image)))
