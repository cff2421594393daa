"""The domains an image can be in, as type annotations that `Chain` checks when it is built.

Annotate a stage's image argument and its return with one of these. `RGB` and `Image` accept
several domains and return what they were given.
"""

from dataclasses import dataclass
from typing import Annotated

import jax


@dataclass(frozen=True)
class Domain:
    """What the numbers of an image mean. `keeps` marks a domain that stands for whatever came in."""

    name: str
    channels: int | None  # 3: (H, W, 3); 1: (H, W); None: either
    keeps: bool = False


MOSAIC = Domain("mosaic", 1)
CAMERA = Domain("camera RGB", 3)
LINEAR = Domain("linear sRGB", 3)
ENCODED = Domain("encoded sRGB", 3)
PROPHOTO = Domain("linear ProPhoto RGB", 3)
ENCODED_PROPHOTO = Domain("encoded ProPhoto RGB", 3)
XYZ_D65 = Domain("CIE XYZ", 3)
YCC = Domain("Y'CbCr", 3)
ANY_RGB = Domain("any three channels", 3, keeps=True)
ANY = Domain("any image", None, keeps=True)

Mosaic = Annotated[jax.Array, MOSAIC]
"""(H, W) float: one colour a photosite, linear light, white at 1."""
CameraRGB = Annotated[jax.Array, CAMERA]
"""(H, W, 3) float: linear light in the sensor's own primaries."""
LinearRGB = Annotated[jax.Array, LINEAR]
"""(H, W, 3) float: linear light, sRGB primaries, white at 1."""
EncodedRGB = Annotated[jax.Array, ENCODED]
"""(H, W, 3) float: display-encoded sRGB in [0, 1]."""
ProPhotoRGB = Annotated[jax.Array, PROPHOTO]
"""(H, W, 3) float: linear light, ProPhoto (ROMM) primaries, D50 white."""
EncodedProPhotoRGB = Annotated[jax.Array, ENCODED_PROPHOTO]
"""(H, W, 3) float: ROMM-encoded ProPhoto RGB in [0, 1]."""
XYZ = Annotated[jax.Array, XYZ_D65]
"""(H, W, 3) float: CIE XYZ, Y of white at 1."""
YCbCr = Annotated[jax.Array, YCC]
"""(H, W, 3) float: luma in [0, 1], chroma in [-0.5, 0.5]."""
RGB = Annotated[jax.Array, ANY_RGB]
"""(H, W, 3) float in any three-channel domain, which the stage keeps."""
Image = Annotated[jax.Array, ANY]
"""A mosaic or a three-channel image; the stage keeps its domain."""

_LIGHT = {CAMERA, LINEAR}  # a pipeline without a colour matrix takes camera RGB for linear sRGB


def accepts(wanted: Domain, given: Domain) -> bool:
    """Whether a stage that wants `wanted` can take an image in the domain `given`."""
    if given.channels is None or wanted.channels is None:
        return True
    if wanted.channels != given.channels:
        return False
    return wanted.keeps or given.keeps or wanted == given or {wanted, given} <= _LIGHT
