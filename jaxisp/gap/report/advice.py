"""Suggestions for the next measurement: to separate an effect from look-alikes, or to isolate the rest."""

from collections.abc import Iterable, Sequence

from jaxisp.gap.simulator.effects import EFFECTS

_EDGE = "a slanted edge at several contrasts, with the noise spectrum of a flat patch beside it"
_TEXTURE = "low-contrast texture (dead leaves) at a low and at a high ISO"
_SIZE = (
    "a sheet of lines finer than two pixels: a picture that was resized has lost them, its noise is uneven"
)
_CHROMA = "saturated fine texture (coloured lines of one pixel), at a low ISO"
_FLAT = "a flat field (a white wall, out of focus) under one light"
_GLARE = "a black patch in the dark, and once more with a lamp at the border of the frame"
_WEDGE = "a grey wedge from black to white, taken at two exposures"
_CHART = "a colour chart of saturated patches at two exposures"
_SURROUND = "grey patches on a dark and on a bright surround"
_DARK = "repeated dark frames (lens cap on)"
_FRAMES = "repeated frames of one still, evenly lit scene"
_PHASE = "an out-of-focus, evenly coloured field: without detail only what repeats every two pixels is left"
_FILE = "the file as the camera wrote it, with its headers, at two qualities"

_BETWEEN: dict[frozenset[str], str] = {
    frozenset(pair): what
    for what, pairs in {
        _FLAT: (("vignetting", "color_shading"), ("color_shading", "white_balance")),
        _GLARE: (
            ("vignetting", "veiling_glare"), ("veiling_glare", "black_level_offset"),
            ("veiling_glare", "tone_curve"),
        ),
        _SURROUND: (("veiling_glare", "local_tone_mapping"), ("local_tone_mapping", "tone_curve")),
        _WEDGE: (("black_level_offset", "tone_curve"), ("highlight_clipping", "tone_curve")),
        _EDGE: (
            ("optical_blur", "sharpening"), ("local_tone_mapping", "sharpening"),
            ("optical_blur", "crosstalk"),
            ("lateral_chromatic_aberration", "demosaicking"), ("motion_blur", "optical_blur"),
            ("lateral_chromatic_aberration", "geometric_distortion"), ("sharpening", "demosaicking"),
        ),
        _TEXTURE: (
            ("optical_blur", "luma_denoising"), ("luma_denoising", "sharpening"),
            ("luma_denoising", "demosaicking"), ("luma_denoising", "correlated_noise"),
        ),
        _SIZE: (("optical_blur", "resampling"), ("luma_denoising", "resampling")),
        _CHROMA: (
            ("chroma_denoising", "chroma_subsampling"), ("chroma_denoising", "demosaicking"),
        ),
        _PHASE: (("green_imbalance", "demosaicking"), ("green_imbalance", "crosstalk"),
                 ("crosstalk", "demosaicking")),
        _CHART: (
            ("crosstalk", "color_matrix"), ("white_balance", "color_matrix"), ("color_matrix", "saturation"),
            ("color_matrix", "color_lut"), ("color_lut", "saturation"),
        ),
        _FILE: (
            ("chroma_denoising", "jpeg_quantization"), ("chroma_subsampling", "jpeg_quantization"),
            ("double_compression", "jpeg_quantization"),
        ),
        _FRAMES: (
            ("row_noise", "column_noise"), ("column_noise", "prnu"), ("noise_level", "film_grain"),
            ("correlated_noise", "film_grain"),
        ),
        _DARK: (
            ("prnu", "hot_pixels"), ("heavy_tailed_noise", "hot_pixels"), ("adc_quantization", "noise_level"),
        ),
    }.items()
    for pair in pairs
}  # fmt: skip
"""A measurement that separates two effects, for each two that `Effect.alternatives` lists."""

_ON = {
    "radius": _FLAT, "row": _FRAMES, "column": _FRAMES, "intensity": _WEDGE, "hue": _CHART,
    "saturation": _CHART, "channel": _CHART, "frequency": _TEXTURE, "orientation": _EDGE, "edge": _EDGE,
    "cfa_phase": _PHASE, "block_phase": _FILE, "neighbourhood": _SURROUND, "lag": _FRAMES, "tail": _DARK,
    "fixed_pattern": _FRAMES, "frame": _FRAMES,
}  # fmt: skip
"""A measurement that isolates the gap on an axis, by axis."""

_MORE = "more pairs, of scenes that differ"


def between(effect: str, alternatives: Sequence[str]) -> str | None:
    """Measurements that separate an effect from its alternatives; None if it has none."""
    if not alternatives:
        return None
    found = [_BETWEEN.get(frozenset((effect, other)), _MORE) for other in alternatives]
    return "; ".join(dict.fromkeys(found))


def told_apart(one: str, other: str) -> str:
    """A measurement that separates two candidates, or shows the axes on which only one of them acts."""
    known = _BETWEEN.get(frozenset((one, other)))
    axes = [axis for axis in _ON if (axis in EFFECTS[one].axes) != (axis in EFFECTS[other].axes)]
    return known or about(axes[:1])


SETTINGS = frozenset(
    name for name, effect in EFFECTS.items() if effect.site in ("encoded", "output", "linear", "camera")
)
"""Effects of the camera's processing, which a setting or another program may switch off."""


_BASE = frozenset({"cfa_phase", "edge", "channel", "hue", "saturation", "intensity"})
"""Axes of what a base is made of: demosaicker, matrix and tone curve."""
_MOST = 0.5
"""Share of what is left that a model must close to say what falls short."""


def short_of(axes: Sequence[str], together: float | None, network: float | None) -> str:
    """Whether base or library falls short, in words.

    Args:
        axes: on which the rest of the gap lies, largest first.
        together: share of the rest that all effects at once close; None if it was not measured.
        network: share of the rest that a small network closes; None likewise.
    """
    if together is not None and together >= _MOST:
        return (
            f"effects of the library close {100 * together:.0f} % of this together, "
            "and these pairs do not tell which of them"
        )
    if network is not None and network >= _MOST:
        return (
            f"the library falls short: a small network on the simulator's picture closes "
            f"{100 * network:.0f} % of this, and no effect does"
        )
    of_base = [axis for axis in axes if axis in _BASE]
    if axes and axes[0] in _BASE and 2 * len(of_base) > len(axes):
        return "the base falls short: its demosaicking, matrix or tone curve shows on these axes"
    return "neither the base's own parameters nor an effect of the library accounts for this"


def about(axes: Iterable[str]) -> str:
    """Measurements that isolate the remaining gap on these axes, in their order."""
    return "; ".join(dict.fromkeys(_ON[axis] for axis in axes)) or _MORE
