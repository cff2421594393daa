"""A picture of each stage for the reference: a drawn scene before it and after it."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from jaxisp import stage
from jaxisp.catalogue import group_of
from jaxisp.data.procedural import drawn
from jaxisp.domains import CAMERA, ENCODED, LINEAR, MOSAIC, Domain
from jaxisp.explore import for_screen, in_domain
from jaxisp.pipeline import Stage, run

SIDE, GAP = 96, 4  # of a picture, and between two [px]
SEEDS = {"leaves": 12, "text": 10, "stripes": 8, "gradients": 1}  # of the scene's quarters
NOISE = 0.06  # standard deviation before stages that take noise away
TINT = 0.9, 0.75, 0.45  # of the scene before stages that balance or stretch it
BALANCING = "auto_level", "gray_world", "white_patch"
SETTINGS: dict[str, dict[str, Any]] = {
    "adc_quantization": {"bits": 4.0},
    "affine_exposure": {"gain": 1.6, "offset": -0.05},
    "balanced_noise": {"read": 0.05},
    "black_level": {"offset": 0.08},
    "chroma_denoising": {"shares": (0, 0, 0, 0, 0, 0, 1.0)},
    "clip": {"white": 0.5},
    "color_magnification": {"red_scale": 1.03, "blue_scale": 0.97},
    "color_matrix": {"matrix": ((1.6, -0.5, -0.1), (-0.3, 1.6, -0.3), (0.0, -0.6, 1.6))},
    "color_shading": {"red_a2": -0.8, "blue_a2": 0.8},
    "column_noise": {"std": 0.04},
    "correlated_noise": {"std": 0.06},
    "crosstalk": {"horizontal": 0.15, "vertical": 0.15},
    "dead_pixels": {"density": 0.02},
    "defocus": {"disc_radius": 3.0},
    "directional_blur": {"lengths": (0, 9.0, 0, 0)},
    "exposure": {"exposure_ev": 1.0},
    "geometric_distortion": {"k1": -0.2},
    "gray18_gamma": {"gamma": 0.6},
    "green_imbalance": {"difference": 0.2},
    "heavy_tailed_noise": {"std": 0.05},
    "hot_pixels": {"density": 0.02},
    "hue_rotation": {"angle": 90.0},
    "jpeg": {"quality": 15.0},
    "lateral_chromatic_aberration": {"red_scale": 1.01, "blue_scale": 0.99},
    "level_steps": {"step": 0.1},
    "linearization": {"black": (0.1,) * 4, "white": 0.8},
    "local_tone_mapping": {"compression": 0.7, "detail": 0.5},
    "luma_denoising": {"shares": (0, 0, 0, 0, 0, 0, 0, 1.0)},
    "mosaic_white_balance": {"gains": (1.6, 1.0, 0.7)},
    "motion_blur": {"lengths": (5.0, 4.0, 5.0), "directions": (20.0, -40.0, 70.0)},
    "prnu": {"std": 0.1},
    "radial_warp": {"k1": 0.2},
    "rectilinear_warp": {"radial": ((0.0, 0.15, 0, 0),) * 3},
    "rounding": {"bits": 3},
    "row_noise": {"std": 0.04},
    "saturation": {"amount": 2.0},
    "selective_color": {"hue": (0.8,) * 12, "saturation": (0.5,) * 12},
    "sharpening": {"amounts": (1.5, 0.5, 0.5)},
    "shot_read_noise": {"shot": 0.005, "read": 0.02},
    "spline_curve": {"offsets": (0.2, 0.25, 0.3, 0.3, 0.25, 0.2, 0.15, 0.1, 0.1, 0.05, 0.05, 0.0)},
    "veiling_glare": {"share": 0.3},
    "vignetting": {"a2": -0.8},
    "white_balance": {"gains": (1.6, 1.0, 0.7)},
    "white_balance_temperature": {"temperature": 4000.0},
    "zone_curve": {"offsets": (0.2, 0.1, -0.1)},
}
"""Parameters and options of stages whose defaults change nothing, or less than is seen."""


def scene() -> np.ndarray:
    """(SIDE, SIDE, 3) encoded sRGB: a quarter each of shapes, text, stripes and soft light."""
    parts = [drawn(kind, seed, SIDE // 2) for kind, seed in SEEDS.items()]
    return np.concatenate([np.concatenate(parts[:2], 1), np.concatenate(parts[2:], 1)])


def setting(name: str) -> tuple[Stage, dict[str, Any], str]:
    """A stage with options and parameters that show what it does, and the values that are not defaults."""
    given = SETTINGS.get(name, {})
    params = stage(name).init()
    fields = vars(params[name]) if params else {}
    own = {field: np.asarray(value, np.float32) for field, value in given.items() if field in fields}
    node = stage(name, **{option: value for option, value in given.items() if option not in fields})
    if own:
        params = {name: type(params[name])(**{**fields, **own})}
    return node, params, ", ".join(f"{field} {_short(value)}" for field, value in given.items())


def before_and_after(name: str) -> tuple[np.ndarray, np.ndarray, str]:
    """What a stage is given and what it makes of it, (H, W, 3) in [0, 1], and the caption."""
    node, params, text = setting(name)
    cfa = str(node.options.get("cfa", "RGGB"))
    taken = node.domain_in
    image = in_domain(scene(), taken, cfa)
    notes = [text] if text else []
    if group_of(name) == "denoise":
        image = image + NOISE * jax.random.normal(jax.random.key(1), image.shape)
        notes.append("the scene has noise")
    if name in BALANCING:
        image = image * np.float32(TINT)
        notes.append("the scene has a tint")
    if name == "defect_correction":
        defects, values, _ = setting("hot_pixels")
        image = run(defects, values, image, jax.random.key(1))
        notes.append("the scene has hot pixels")
    result = run(node, params, image, jax.random.key(0))
    if taken.keeps:
        taken = {"any image": LINEAR, "any three channels": ENCODED}[taken.name]
    given = taken if node.domain_out.keeps else node.domain_out
    if given != taken and MOSAIC not in (given, taken) and not {given, taken} <= {CAMERA, LINEAR}:
        notes.append("the numbers as they are")
        return _as_they_are(image), _as_they_are(result), "; ".join(notes)
    return _shown(image, taken, cfa), _shown(result, given, cfa), "; ".join(notes)


def _shown(image: Any, domain: Domain, cfa: str) -> np.ndarray:
    return np.asarray(for_screen(image, domain, cfa))


def _as_they_are(image: Any) -> np.ndarray:
    return np.clip(np.asarray(image), 0, 1)


def _short(value: Any) -> str:
    numbers = np.unique(np.asarray(value))
    if len(numbers) == 1:
        return f"{numbers[0]:g}"
    return f"[{' '.join(f'{v:g}' for v in np.ravel(value))}]"


def write(name: str, path: Path) -> str:
    """Write the picture of a stage, before beside after; return the caption.

    Raises:
        ValueError: nothing is seen of the stage.
    """
    first, then, caption = before_and_after(name)
    if first.shape == then.shape and np.abs(first - then).max() < 2 / 255:
        raise ValueError(f"{name} changes nothing that is seen: give it other parameters in SETTINGS")
    picture = np.full((SIDE, 2 * SIDE + GAP, 3), 255, np.uint8)
    for image, left in ((first, 0), (then, SIDE + GAP)):
        height, width = image.shape[:2]
        picture[:height, left : left + width] = np.round(255 * image)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path, optimize=True)
    return caption


@contextlib.contextmanager
def compiled_quickly() -> Iterator[None]:
    """Each stage runs once, on a small picture: compiling takes a third of the time like this."""
    before = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)
