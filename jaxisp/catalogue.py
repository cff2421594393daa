"""What there is, as plain tables: stages and recipes for listings and documentation."""

import re
from typing import Any

import numpy as np

from jaxisp.params import specs
from jaxisp.pipeline import sections, signature
from jaxisp.priors import is_distribution
from jaxisp.recipes import RECIPES
from jaxisp.serialize import encode_params
from jaxisp.stages import STAGES


def describe_stages() -> list[dict[str, Any]]:
    """Every registered stage: name, summary, parameters, static options, gradient, source, domains."""
    return [_describe(name) for name in sorted(STAGES)]


def _describe(name: str) -> dict[str, Any]:
    declared, text = signature(STAGES[name]), sections(STAGES[name])
    parameters = specs(declared.params).items() if declared.params else ()
    return {
        "name": name,
        "summary": text["Summary"],
        "params": [
            {
                "name": field,
                "default": np.asarray(spec.default).tolist(),
                "bounds": list(spec.bounds),
                "unit": spec.unit,
                "scale": spec.scale,
                "doc": spec.doc,
            }
            for field, spec in parameters
        ],
        "static": [{"name": option, "default": default} for option, default in declared.static],
        "stochastic": declared.stochastic,
        "takes": declared.domain_in.name,
        "gives": declared.domain_out.name,
        "gradient": text.get("Gradient", ""),
        "source": text.get("Source", ""),
    }


GROUPS = {
    "optics": "lens and light",
    "noise": "light, readout and film",
    "sensor": "sensor and mosaic",
    "demosaic": "demosaicking",
    "denoise": "denoising",
    "detail": "sharpening, scaling and blocks",
    "color": "colour and white balance",
    "tone": "tone and transfer curves",
    "file": "compression and rounding",
    "own": "registered by others",
}
"""Groups of stages, in the order of a camera, and what they are."""
_GROUP_OF_MODULE = {
    "optics": "optics", "blur": "optics",
    "noise": "noise", "balanced_noise": "noise", "draws": "noise",
    "sensor": "sensor", "defects": "sensor", "choice": "demosaic", "demosaic": "demosaic",
    "denoise": "denoise", "smoothing": "denoise",
    "detail": "detail", "resampling": "detail",
    "balance": "color", "spaces": "color", "look": "color",
    "power": "tone", "tone": "tone", "transfer": "tone", "auto": "tone",
    "jpeg": "file", "jpeg_file": "file", "rounding": "file",
}  # fmt: skip

_GROUP_OF_STAGE = {
    "chroma_subsampling": "file", "earlier_compression": "file", "directional_blur": "optics",
    "sharpening": "detail", "local_tone_mapping": "tone", "spline_curve": "tone",
}  # fmt: skip
"""Of stages that stand in a module for how they are computed, not for what they do."""


def group_of(name: str) -> str:
    """The group of a registered stage."""
    package, _, module = STAGES[name].__module__.partition("jaxisp.stages.")
    if package:
        return "own"
    return _GROUP_OF_STAGE.get(name) or _GROUP_OF_MODULE[module.partition(".")[0]]


def first_sentence(text: str) -> str:
    """What a summary begins with, without the full stop."""
    return re.split(r"\.\s+(?=[A-Z])", text)[0].rstrip(".")


def describe_recipes() -> list[dict[str, Any]]:
    """Every built-in recipe: name, description, stages in order, what is drawn and what is fixed."""
    return [_describe_recipe(name) for name in RECIPES]


def _describe_recipe(name: str) -> dict[str, Any]:
    recipe = RECIPES[name]()
    encoded = encode_params(recipe.prior)
    drawn = {
        f"{stage}.{field}": " ".join(f"{kind} {numbers}" for kind, numbers in value.items())
        for stage, fields in encoded.items()
        for field, value in fields.items()
        if is_distribution(getattr(recipe.prior[stage], field))
    }
    return {
        "name": name,
        "description": recipe.description,
        "stages": [s.name for s in recipe.chain.stages()],
        "draws": drawn,
        "params": encoded,
    }
