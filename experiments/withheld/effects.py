"""All effects by name, and which of them may be developed on.

The rule of the split, fixed before any was run: the names in alphabetical order, the first, third, ... are
for development, the second, fourth, ... are sealed. The pairs hold
both kinds, so they too are run once, at the end.
"""

from .camera import DISTRIBUTIONS, KINDS, PAIRED, Effect
from .harmless import HARMLESS
from .optics import OPTICS
from .outside import OUTSIDE as OUTSIDE_EFFECTS
from .rendering import RENDERING
from .sensor import SENSOR

VOCABULARY: dict[str, Effect] = {effect.name: effect for effect in (*OPTICS, *SENSOR, *RENDERING)}
OUTSIDE: dict[str, Effect] = {effect.name: effect for effect in OUTSIDE_EFFECTS}
NULLS: dict[str, Effect] = {effect.name: effect for effect in HARMLESS}
EVERYTHING: dict[str, Effect] = VOCABULARY | OUTSIDE | NULLS
LEVELS = (1, 2, 3, 4, 5)

DEVELOP = tuple(sorted(VOCABULARY)[0::2])
SEALED = tuple(sorted(VOCABULARY)[1::2])

# What a fitted baseline takes up itself, so that "absorbed" or "none" is right as well as the name.
ABSORBABLE = ("color_matrix", "noise_level", "saturation", "tone_curve", "white_balance")

# What leaves nearly the same traces: where the true effect is not tried, another of its group may stand in.
GROUPS = (
    {"chroma_denoising", "chroma_subsampling", "jpeg_quantization"},
    {"luma_denoising", "motion_blur", "optical_blur", "resampling", "sharpening"},
    {"black_level_offset", "tone_curve", "veiling_glare"},
    {"color_shading", "vignetting"},
    {"color_lut", "color_matrix", "saturation", "white_balance"},
    {"heavy_tailed_noise", "hot_pixels"},
    {"local_tone_mapping", "sharpening"},
)

PAIRS = (
    ("chroma_denoising", "vignetting"),
    ("color_lut", "sharpening"),
    ("crosstalk", "highlight_clipping"),
    ("demosaicking", "local_tone_mapping"),
    ("double_compression", "optical_blur"),
    ("film_grain", "green_imbalance"),
    ("geometric_distortion", "luma_denoising"),
    ("lateral_chromatic_aberration", "sharpening"),
    ("black_level_offset", "vignetting"),
    ("color_shading", "chroma_subsampling"),
    ("hot_pixels", "row_noise"),
    ("column_noise", "motion_blur"),
    ("correlated_noise", "veiling_glare"),
    ("heavy_tailed_noise", "resampling"),
)

LOST_HEADER = ("jpeg_quantization", 2)
"""What a picture has when its JPEG was opened and saved in a format that states no quantisation tables."""


def shows_in(name: str, kind: str) -> bool:
    """Whether an effect (or the lack of one) is part of this kind of data."""
    effect = EVERYTHING[name]
    return bool(effect.acts.get(kind)) or name == "nothing"


def without_header(active: dict[str, int]) -> bool:
    """Whether the picture must be filed in a format that states no quantisation tables."""
    return "jpeg_quantization" in active or "lossless" in active


__all__ = ["ABSORBABLE", "DEVELOP", "DISTRIBUTIONS", "EVERYTHING", "KINDS", "LEVELS"]
__all__ += [
    "LOST_HEADER",
    "NULLS",
    "OUTSIDE",
    "PAIRED",
    "PAIRS",
    "SEALED",
    "VOCABULARY",
    "shows_in",
    "without_header",
]
