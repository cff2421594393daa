"""Light on its way to the sensor: exposure, shading, glare and where the lens puts it.

The blurs are in `jaxisp.stages.blur`. Radii here are measured from the image centre,
((H-1)/2, (W-1)/2), and are 1 at the centres of the corner pixels.
"""

from jaxisp.stages.blur import defocus as defocus
from jaxisp.stages.blur import motion_blur as motion_blur
from jaxisp.stages.blur import optical_blur as optical_blur
from jaxisp.stages.optics.displacement import (
    GeometricDistortion,
    LateralChromaticAberration,
    geometric_distortion,
    lateral_chromatic_aberration,
)
from jaxisp.stages.optics.light import (
    AffineExposure,
    ColorShading,
    Exposure,
    VeilingGlare,
    Vignetting,
    affine_exposure,
    color_shading,
    exposure,
    veiling_glare,
    vignetting,
)
from jaxisp.stages.optics.warps import (
    ColorMagnification,
    RadialWarp,
    RectilinearWarp,
    color_magnification,
    radial_warp,
    rectilinear_warp,
)

__all__ = [
    "AffineExposure",
    "ColorMagnification",
    "ColorShading",
    "Exposure",
    "GeometricDistortion",
    "LateralChromaticAberration",
    "RadialWarp",
    "RectilinearWarp",
    "VeilingGlare",
    "Vignetting",
    "affine_exposure",
    "color_magnification",
    "color_shading",
    "exposure",
    "geometric_distortion",
    "lateral_chromatic_aberration",
    "radial_warp",
    "rectilinear_warp",
    "veiling_glare",
    "vignetting",
]
