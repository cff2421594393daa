"""The effects a camera may have and its simulator may lack: each a stage, switched off until it is tried.

An `Effect` says which stage makes it, where in the pipeline that stage goes, and in which directions
its parameters may move. Users add their own with `register_effect`.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from jaxisp.errors import InputError, meant
from jaxisp.pipeline import Node, Stage, stage
from jaxisp.stages.choice import DEMOSAICKERS
from jaxisp.stages.look import SECTORS
from jaxisp.stages.smoothing import CHROMA_FILTERS, LUMA_FILTERS

RAW_JPEG, CLEAN_NOISY = "raw+jpeg", "clean+noisy"
BOTH = (RAW_JPEG, CLEAN_NOISY)
JPEG_JPEG = "jpeg+jpeg"
"""Two pictures of a scene: they show what RAW+JPEG pairs do, but for effects of the mosaic."""

AXES = (
    "radius", "row", "column", "intensity", "hue", "saturation", "channel", "frequency", "orientation",
    "edge", "cfa_phase", "block_phase", "neighbourhood", "lag", "tail", "fixed_pattern", "frame",
)  # fmt: skip

SITES = ("scene", "mosaic", "demosaic", "camera", "linear", "encoded", "output")
"""Where an effect can go: the scene's light, the mosaic as recorded, its demosaicking (which the effect
replaces), demosaicked camera RGB, linear sRGB after the colour matrix, the encoded
picture, and what the file holds."""


@dataclass(frozen=True)
class Move:
    """One parameter, or one entry of it, that the effect may change.

    Attributes:
        field: of the stage's parameters.
        step: the probe: how far it is moved to see what it does; large enough to be seen.
        low, high: the range of the change, from `off`.
        index: which entry of the field; () for a number.
        off: its value where the effect is absent, whatever the stage's default; the probe starts there.
        grid: changes that are tried one by one, where the picture does not follow the parameter smoothly.
        fine: how closely it is searched for at last; 0: to a quarter of the grid's spacing.
        both_sides: it is probed to both: interpolation smooths either way, which one side alone would take
            for a part of it.
        far: changes from which a fit may start as well, one move after the other; the probe is one of them
            where that lowers the error. Where edges have moved by more than their width, a small probe sees
            nothing of a warp.
        usual, spread: mean and standard deviation of what is believed of the change beforehand.
    """

    field: str
    step: float
    low: float
    high: float
    index: tuple[int, ...] = ()
    off: float = 0.0
    grid: tuple[float, ...] = ()
    fine: float = 0.0
    both_sides: bool = False
    far: tuple[float, ...] = ()
    usual: float = 0.0
    spread: float = math.inf


@dataclass(frozen=True)
class Effect:
    """What a camera does that a simulator may not model.

    Attributes:
        name: of the effect and of its node in the pipeline.
        node: the stage that makes it; what no move names keeps the stage's default.
        site: where it goes; one of `SITES`. In RAW+JPEG pairs light is seen after demosaicking only, so
            that "scene" is then taken as "camera".
        moves: how it may act.
        axes: on which it shows.
        alternatives: effects that are easily taken for it.
        shows_in: the kinds of data that can show it.
        contains: effects that this one can imitate in full: they are preferred to it.
        random: it adds noise, and is seen in statistics only.
        strong: for an effect that smooths noise, points (the changes of its moves, in order) from which a
            fit may start as well, with more noise than the base has: the base imitates it by less.
        exact: these forms are what cameras do: what lies between two must be clearly better to be believed.
    """

    name: str
    node: Node
    site: str
    moves: tuple[Move, ...]
    axes: tuple[str, ...]
    alternatives: tuple[str, ...] = ()
    shows_in: tuple[str, ...] = BOTH
    contains: tuple[str, ...] = ()
    random: bool = False
    strong: tuple[tuple[float, ...], ...] = ()
    exact: bool = False

    def as_dict(self) -> dict[str, Any]:
        """As `jaxisp effects --json` lists it."""
        return {
            "name": self.name,
            "site": self.site,
            "shows_in": list(self.shows_in),
            "axes": list(self.axes),
            "alternatives": list(self.alternatives),
            "stage": next(self.node.stages()).fn.__name__,
        }


EFFECTS: dict[str, Effect] = {}
"""Effects that `diagnose` tries, by name; `register_effect` adds to it."""


def register_effect(effect: Effect) -> Effect:
    """Add an effect to those that `diagnose` tries.

    Raises:
        ValueError: the name is taken, or the node's is another; a site, axis, kind of data, other effect or
            parameter that it names is unknown; or a strong form is not of all moves.
    """
    if effect.name in EFFECTS:
        raise ValueError(f"an effect named {effect.name!r} is registered already")
    check_effect(effect)
    EFFECTS[effect.name] = effect
    return effect


def check_effect(effect: Effect) -> None:
    """Raises ValueError where an effect names what there is not: a diagnosis would find out late."""
    whose = f"effect {effect.name}"
    for field, known in (
        ("site", SITES), ("axes", AXES), ("shows_in", BOTH), ("alternatives", EFFECTS), ("contains", EFFECTS)
    ):  # fmt: skip
        given = getattr(effect, field)
        for name in (given,) if field == "site" else given:
            if name not in known:
                among = meant(name, known) or f"; there are {', '.join(known)}"
                raise ValueError(f"{whose}: unknown {field} {name!r}{among}")
    own = effect.node.init().get(effect.name)
    if own is None:
        raise ValueError(
            f"{whose}: its node must be a stage with parameters and of the same name, as "
            f"stage(..., name={effect.name!r}); this one is {effect.node.name!r}"
        )
    there = [f.name for f in fields(own)]
    for move in effect.moves:
        if move.field not in there:
            among = meant(move.field, there) or f"; there are {', '.join(there)}"
            raise ValueError(f"{whose}: its stage has no parameter {move.field!r}{among}")
        shape = np.shape(getattr(own, move.field))
        if len(move.index) != len(shape) or not all(0 <= i < n for i, n in zip(move.index, shape)):
            raise ValueError(f"{whose}: {move.field}, of shape {shape}, has no entry {move.index}")
    if any(len(form) != len(effect.moves) for form in effect.strong):
        raise ValueError(f"{whose}: a strong form has a change for each of its moves")


_STEPS = tuple(0.006 * 1.18**k for k in range(16))
_QUALITIES = (20.0, 35.0, 50.0, 60.0, 70.0, 75.0, 80.0, 85.0, 90.0, 94.0)


def _entries(field: str, count: int, step: float, low: float, high: float) -> tuple[Move, ...]:
    return tuple(Move(field, step, low, high, (i,)) for i in range(count))


def _each(count: int) -> tuple[tuple[float, ...], ...]:
    """One form at a time, in full."""
    return tuple(tuple(float(i == k) for i in range(count)) for k in range(count))


def _add(
    name: str, node: Stage, site: str, moves: Iterable[Move], axes: str, alternatives: str = "", **more: Any
) -> None:
    """One of the library's own, which may name those that come after it."""
    node = Stage(node.fn, name, node.static)
    EFFECTS[name] = Effect(
        name, node, site, tuple(moves), tuple(axes.split()), tuple(alternatives.split()), **more
    )


_add(
    "vignetting", stage("vignetting"), "scene",
    [Move("a2", -0.2, -3, 3), Move("a4", -0.2, -3, 3)],
    "radius", "color_shading veiling_glare",
)  # fmt: skip
_add(
    "color_shading", stage("color_shading"), "scene",
    [Move("red_a2", 0.1, -1.5, 1.5), Move("blue_a2", 0.1, -1.5, 1.5),
     Move("red_a4", 0.1, -1.5, 1.5), Move("blue_a4", 0.1, -1.5, 1.5)],
    "radius channel", "vignetting white_balance",
)  # fmt: skip
_add(
    "lateral_chromatic_aberration", stage("color_magnification"), "scene",
    [*(Move(f"{color}_scale", 0.002, -0.03, 0.03, off=1, both_sides=True, far=(-0.02, -0.008, 0.008, 0.02))
       for color in ("red", "blue")),
     Move("sharpness", 0.5, -1, 1, off=1)],
    "radius channel edge", "demosaicking geometric_distortion",
)  # fmt: skip
_add(
    "optical_blur", stage("optical_blur", radius=6), "scene",
    [Move("sigma", 0.6, 0, 2)],
    "frequency edge", "resampling sharpening luma_denoising motion_blur",
)  # fmt: skip
_add(
    "motion_blur", stage("directional_blur"), "scene",
    _entries("lengths", 4, 2.0, 0, 12),
    "orientation frequency edge", "optical_blur", shows_in=(CLEAN_NOISY,),
)  # fmt: skip
_add(
    "geometric_distortion", stage("radial_warp"), "scene",
    [Move("k1", 0.004, -0.1, 0.1, both_sides=True, far=(-0.055, -0.02, 0.02, 0.055)),
     Move("k0", 0.004, -0.1, 0.1, both_sides=True, far=(-0.02, -0.008, 0.008, 0.02)),
     Move("k2", 0.004, -0.07, 0.07, both_sides=True),
     Move("sharpness", 0.5, -1, 1, off=1)],
    "radius edge", "lateral_chromatic_aberration",
)  # fmt: skip
_add(
    "veiling_glare", stage("veiling_glare"), "scene",
    [Move("share", 0.03, 0, 0.4)],
    "intensity", "black_level_offset tone_curve local_tone_mapping",
)  # fmt: skip
_add(
    "black_level_offset", stage("black_level"), "mosaic",
    [Move("offset", 0.005, -0.1, 0.1)],
    "intensity channel", "veiling_glare tone_curve",
)  # fmt: skip
_add(
    "green_imbalance", stage("green_imbalance"), "mosaic",
    [Move("difference", 0.03, -0.2, 0.2)],
    "cfa_phase", "demosaicking crosstalk",
)  # fmt: skip
_add(
    "crosstalk", stage("crosstalk"), "mosaic",
    [Move("horizontal", 0.03, -0.1, 0.3), Move("vertical", 0.03, -0.1, 0.3),
     Move("diagonal", 0.03, -0.1, 0.3)],
    "cfa_phase edge saturation", "optical_blur color_matrix",
)  # fmt: skip
_add(
    "highlight_clipping", stage("clip", low=-1.0), "mosaic",
    [Move("white", -0.15, -0.6, 0, off=1, grid=(-0.05, -0.1, -0.15, -0.2, -0.3, -0.4, -0.5))],
    "intensity", "tone_curve",
)  # fmt: skip
_add(
    "white_balance", stage("white_balance"), "camera",
    [Move("gains", 0.05, -0.5, 1, (0,), 1), Move("gains", 0.05, -0.5, 1, (2,), 1)],
    "channel hue", "color_matrix",
)  # fmt: skip
_add(
    "color_matrix", stage("color_matrix"), "linear",
    [Move("matrix", 0.05, -1, 1, (i, j), float(i == j)) for i in range(3) for j in range(3)],
    "hue saturation channel", "saturation color_lut white_balance",
    contains=("white_balance",),
)  # fmt: skip
_add(
    "color_lut", stage("selective_color"), "encoded",
    [*_entries("hue", SECTORS, 0.2, -1.2, 1.2), *_entries("saturation", SECTORS, 0.3, -1, 2),
     *_entries("lightness", SECTORS, 0.2, -1.5, 1.5)],
    "hue saturation", "color_matrix saturation",
    contains=("saturation",),
)  # fmt: skip
_add(
    "tone_curve", stage("spline_curve"), "encoded",
    _entries("offsets", 12, 0.04, -0.6, 0.6),
    "intensity", "black_level_offset veiling_glare local_tone_mapping",
)  # fmt: skip
_add(
    "local_tone_mapping", stage("local_tone_mapping"), "linear",
    [Move("compression", 0.1, -0.7, 0.7), Move("detail", 0.15, -0.8, 2),
     Move("contrast", 0.15, -0.8, 2), Move("equalization", 0.2, 0, 1), Move("clip", 1, -2, 12, off=3),
     Move("sigma", 6, -10, 26, off=14), Move("edges", 0.5, 0, 1)],
    "neighbourhood", "veiling_glare tone_curve sharpening",
)  # fmt: skip
_add(
    "saturation", stage("saturation"), "encoded",
    [Move("amount", 0.15, -1, 3, off=1)],
    "saturation", "color_matrix color_lut",
)  # fmt: skip
_add(
    "luma_denoising", stage("luma_denoising"), "encoded",
    _entries("shares", len(LUMA_FILTERS), 0.5, 0, 1.2),  # below 0 it would sharpen
    "frequency lag edge", "optical_blur resampling sharpening demosaicking", strong=_each(len(LUMA_FILTERS)),
)  # fmt: skip
_add(
    "chroma_denoising", stage("chroma_denoising"), "encoded",
    _entries("shares", len(CHROMA_FILTERS), 0.5, 0, 1.2),
    "frequency channel lag", "chroma_subsampling jpeg_quantization demosaicking",
    strong=_each(len(CHROMA_FILTERS)),
)  # fmt: skip
_add(
    "sharpening", stage("sharpening"), "encoded",
    [*_entries("amounts", 3, 0.3, 0, 4), *_entries("deconvolution", 2, 0.3, 0, 3),
     Move("sigma", 0.1, -0.3, 0.8, off=0.7), Move("threshold", 0.01, 0, 0.1), Move("limit", 15, 0, 100)],
    "frequency edge", "local_tone_mapping optical_blur demosaicking",
)  # fmt: skip
_add(
    "demosaicking", stage("demosaicking"), "demosaic",
    _entries("shares", len(DEMOSAICKERS), 1.0, 0, 1),
    "edge cfa_phase frequency", "crosstalk green_imbalance chroma_denoising lateral_chromatic_aberration",
)  # fmt: skip
_add(
    "resampling", stage("rescaling"), "encoded",
    [Move("factor", 0.4, 0, 2, off=1, grid=(0.08, 0.15, 0.3, 0.5, 0.75, 1, 1.5), fine=0.003),
     *_entries("shares", 3, 0.5, -0.2, 1.2)],
    "frequency edge", "optical_blur luma_denoising",
)  # fmt: skip
_add(
    "chroma_subsampling", stage("chroma_subsampling"), "output",
    [Move(share, 1.0, 0, 1, far=(1.0,)) for share in ("horizontal", "vertical", "sampled", "repeated")],
    "channel frequency edge", "chroma_denoising jpeg_quantization",
    strong=((1, 0, 0, 0), (1, 1, 0, 0), (1, 1, 0, 1), (1, 1, 1, 1)), exact=True,
)  # fmt: skip
_add(
    "double_compression", stage("earlier_compression"), "output",
    [Move("quality", 70.0, 5, 99, grid=_QUALITIES)],
    "block_phase", "jpeg_quantization",
)  # fmt: skip
_add(
    "jpeg_quantization", stage("jpeg", subsampling="4:4:4"), "output",
    [Move("quality", 70.0, 5, 99, grid=_QUALITIES)],
    "block_phase frequency", "double_compression chroma_subsampling",
)  # fmt: skip
_add(
    "noise_level", stage("gaussian_noise"), "mosaic",
    [Move("std", 0.004, 0, 0.1)],
    "intensity", "film_grain", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "row_noise", stage("row_noise"), "mosaic",
    [Move("std", 0.003, 0, 0.1)],
    "row lag", "column_noise", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "column_noise", stage("column_noise", sensor=1), "mosaic",
    [Move("std", 0.003, 0, 0.1)],
    "column fixed_pattern", "prnu row_noise", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "prnu", stage("prnu", sensor=1), "mosaic",
    [Move("std", 0.02, 0, 0.1)],
    "fixed_pattern intensity", "column_noise hot_pixels", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "correlated_noise", stage("correlated_noise"), "mosaic",
    [Move("std", 0.005, 0, 0.1), Move("horizontal", 0.1, -0.4, 0.25, off=0.4),
     Move("vertical", 0.1, -0.4, 0.25, off=0.4)],
    "lag frequency", "luma_denoising film_grain", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "heavy_tailed_noise", stage("heavy_tailed_noise"), "mosaic",
    [Move("std", 0.005, 0, 0.1), Move("tail", 0.1, -0.1, 0.2, off=0.15)],
    "tail", "hot_pixels", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "hot_pixels", stage("hot_pixels", sensor=1), "mosaic",
    [Move("density", 0.002, 0, 0.05), Move("level", -0.3, -0.8, 0.5, off=1),
     Move("spread", 0.5, 0, 1), Move("dead", 0.3, 0, 0.7)],
    "tail fixed_pattern", "heavy_tailed_noise prnu", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "adc_quantization", stage("level_steps"), "mosaic",
    [Move("step", 0.02, 0, 0.12, grid=_STEPS)],
    "intensity tail", "noise_level", shows_in=(CLEAN_NOISY,), random=True,
)  # fmt: skip
_add(
    "film_grain", stage("film_grain"), "encoded",
    [Move("std", 0.02, 0, 0.2), Move("sigma", 0.15, -0.4, 0.8, off=0.8)],
    "intensity frequency lag", "noise_level correlated_noise", random=True,
)  # fmt: skip


def candidates(kind: str, exclude: Sequence[str] = ()) -> list[Effect]:
    """The effects that this kind of data can show, less those excluded."""
    for name in exclude:
        if name not in EFFECTS:
            among = meant(name, EFFECTS) or f"; there are {', '.join(EFFECTS)}"
            raise InputError(f"no effect named {name!r}{among}")
    tried = [e for e in EFFECTS.values() if kind in e.shows_in and e.name not in exclude]
    # beside a RAW, noise that is added later cannot be predicted pixel by pixel
    return [e for e in tried if not (e.random and kind == RAW_JPEG)]
